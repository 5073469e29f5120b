"""Control laws of a UAV: one file for each, and a row of `bus.registry.LAWS` that names it."""
