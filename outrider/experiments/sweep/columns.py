"""Columns of a sweep's table, and the conversion of a run's summary to a row."""

from typing import Any

from outrider.running.metrics import LINK, LINK_COLUMNS, MISSION, TEAM, columns, total
from outrider.running.summary import Summary

FIRST = {
    "run": "int64",
    "block": "string",
    "law": "string",
    "seed": "int64",
    "scenario": "string",
    "version": "string",
}
"""Columns before the varied fields, with their Parquet types."""
RESULTS = columns()
"""Columns with a run's results, with their Parquet types; `outrider.running.metrics` explains them."""


_MOST_REASON = 10_000
"""Largest length of an error in a row."""


def _link_columns(summary: Summary) -> dict[str, float | None]:
    """Return the merged metrics of all links of each kind."""
    found: dict[str, float | None] = {}
    for kind in LINK_COLUMNS:
        links = [status for name, status in summary.links.items() if name.endswith(f"/{kind}")]
        for metric in LINK.values():
            if metric.column:
                values = (getattr(status, metric.name) for status in links)
                found[f"{kind}_{metric.name}"] = total(metric, values)
    return found


def row_of(summary: Summary, seconds: float) -> dict[str, Any]:
    """Return the results of a successful run.

    Args:
        summary: Summary of the run.
        seconds: Wall time of the run [s].
    """
    parts = dict.fromkeys(MISSION, summary.mission) | dict.fromkeys(TEAM, summary.team)
    row: dict[str, Any] = {name: getattr(parts.get(name, summary), name, None) for name in RESULTS}
    return row | {
        **_link_columns(summary),
        "margin": summary.min_margin,
        "violated": summary.visibility_violations > 0,
        "seconds": seconds,
    }


def failed_row(error: Exception, seconds: float) -> dict[str, Any]:
    """Return the row of a failed run."""
    reason = " ".join(f"{type(error).__name__}: {error}".split())[:_MOST_REASON]
    return {**dict.fromkeys(RESULTS), "seconds": seconds, "error": reason}
