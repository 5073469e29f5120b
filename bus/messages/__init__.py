"""Every message, as a frozen struct: the information contract in types.

JSON by msgspec. Unknown fields are refused, numbers carry bounds. SI units; positions are in the world frame,
relative positions are p_delta = p_a - p_g, from the UGV to the UAV. No message to a UAV has a field for the UGV's
velocity, input or goal, and none to a UGV for the UAV's.
"""
