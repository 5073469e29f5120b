"""All messages, as frozen structs: the information contract in types.

Messages are JSON, encoded by msgspec. Unknown fields are rejected and numbers are bounded. SI units; positions are in
the world frame, relative positions are p_delta = p_a - p_g, from the UGV to the UAV. No message to a UAV has a field
for the UGV's velocity, input or goal, and no message to a UGV has one for the UAV's.
"""
