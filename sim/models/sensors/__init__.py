"""Sensors of the ground: one file for each, and a row of `bus.registry.SENSORS` that names it."""
