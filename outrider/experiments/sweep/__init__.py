"""Experiments over a degraded network.

Laws, degradations and seeds, flown on all cores, each run one row of a table.
"""

EXTRA = ".[sweep]"
"""The packages that have to be installed."""
DASK_EXTRA = ".[dask]"
"""The same, for a cluster."""
