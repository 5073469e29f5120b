"""Simulator process: the world behind the bus."""
