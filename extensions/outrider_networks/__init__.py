"""Fit link settings to a recorded link."""
