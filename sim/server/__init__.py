"""The world behind the bus."""
