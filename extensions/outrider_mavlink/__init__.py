"""MAVLink over UDP: show a run in ground stations, or control a UAV.

A UAV is controlled by offboard setpoints, or a real autopilot tracks its reference state.
"""
