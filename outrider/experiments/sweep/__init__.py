"""Sweeps: runs of laws, degradations and seeds on all cores, with a table row for each run."""
