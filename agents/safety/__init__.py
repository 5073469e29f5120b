"""The safety filter of a UAV: what is known of the UGV, backup trajectories, and the decision at each tick."""
