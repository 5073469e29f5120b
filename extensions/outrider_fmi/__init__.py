"""Exchange vehicles with FMI 3.0 tools.

Vehicles as FMI 3.0 co-simulation units, and units as drivers.
"""
