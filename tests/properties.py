"""The settings with which all properties are tried."""

from hypothesis import settings

PROPERTY = settings(derandomize=True, deadline=None, max_examples=100)
"""The settings of all properties: the same examples in every run, no limit on the time of one."""
