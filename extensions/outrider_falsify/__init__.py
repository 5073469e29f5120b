"""Search for a run in which the UAV loses sight of its UGV.

The search for what breaks the promise.

A UGV's motion, start states, noise and network events within declared limits.
"""
