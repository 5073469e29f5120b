"""Experiments over a degraded network.

Laws, degradations and seeds, flown on all cores, each run one row of a table.
"""
