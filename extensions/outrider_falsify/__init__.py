"""Search for a run in which the UAV loses sight of its UGV.

The search varies the UGV's motion, start states, noise and network events within declared limits.
"""
