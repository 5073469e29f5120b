"""How all properties are tried."""

from hypothesis import settings

PROPERTY = settings(derandomize=True, deadline=None, max_examples=100)
"""How all properties are tried: the same examples in every run, no limit on the time of one."""
