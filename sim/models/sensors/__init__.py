"""Ground sensors: one file each, named by a row of `bus.registry.SENSORS`."""
