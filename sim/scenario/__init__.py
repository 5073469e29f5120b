"""Scenarios: their types, how they are read, and what is checked."""
