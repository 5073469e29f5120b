"""A world's tick over arrays of worlds."""
