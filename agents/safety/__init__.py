"""Safety filter of a UAV: bounds on the UGV's position, backup trajectories, and the decision in each tick."""
