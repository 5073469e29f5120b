"""The world as a PettingZoo environment; `sim.env.parallel` is its shell, the other files are its parts."""
