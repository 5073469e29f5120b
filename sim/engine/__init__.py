"""Simulation engine: one tick of a world, over arrays of worlds."""
