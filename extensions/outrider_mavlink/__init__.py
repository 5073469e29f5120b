"""Connect a run to MAVLink ground stations.

A UAV is controlled by offboard setpoints, or a real autopilot tracks its reference state.
"""
