"""Radio links in simulated time."""
