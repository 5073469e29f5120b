"""Bridges to the buses that robots and tools speak already; each with an extra of its own."""
