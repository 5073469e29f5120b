"""Control laws of a UAV: one file per law, named by its row of `bus.registry.LAWS`."""
