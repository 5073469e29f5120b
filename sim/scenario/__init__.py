"""Scenarios: types, loading and checks."""
