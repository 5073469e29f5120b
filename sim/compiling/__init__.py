"""Compilation, records, lane sums and threads for compiled functions."""
