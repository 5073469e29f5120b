"""Closed loop of all vehicles in many worlds at once, compiled: the base of every environment."""
