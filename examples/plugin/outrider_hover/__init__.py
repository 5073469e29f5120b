"""Fly a UAV that hovers over its UGV."""
