"""Drivers of the UGVs."""
