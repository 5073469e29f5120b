"""Estimation of the UGV's position from noisy and delayed detections."""
