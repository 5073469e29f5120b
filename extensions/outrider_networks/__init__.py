"""Fit links to recordings, and find the bounds that links keep."""
