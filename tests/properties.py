"""The settings of all property tests."""

from hypothesis import settings

PROPERTY = settings(derandomize=True, deadline=None, max_examples=100)
"""The same examples in every run, without a time limit."""
