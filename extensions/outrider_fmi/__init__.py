"""Exchange vehicles with FMI 3.0 tools.

Export vehicles as FMI 3.0 co-simulation units, and run units as UGV drivers.
"""
