"""Fit links to recordings, and compute bounds."""
