"""Show a run to MAVLink ground stations, or fly a UAV by it.

MAVLink over UDP: a run for ground stations, a UAV flown by offboard setpoints, an autopilot that flies along.
"""
