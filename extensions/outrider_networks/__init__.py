"""Fit links to recordings, and compute bounds that links satisfy."""
