"""MAVLink over UDP: a run for ground stations, a UAV flown by offboard setpoints, an autopilot that flies along."""
