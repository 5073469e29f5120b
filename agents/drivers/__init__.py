"""The drivers of the UGVs."""
