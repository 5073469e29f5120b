"""Figures, claims, sweeps, reports, searches for a violation, and the suite."""
