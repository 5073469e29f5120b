"""Experiments: the paper's figures and claims, sweeps and reports."""
