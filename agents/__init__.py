"""On-board software of the vehicles: each pilot decides from its own observations only."""
