"""Compilation, records, lane sums and threads for the compiled functions."""
