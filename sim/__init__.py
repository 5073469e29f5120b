"""Simulation: vehicles, ground, detections, radio links and the clock."""
