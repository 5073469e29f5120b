"""The table's columns, and how a run's summary becomes a row of it."""

from typing import Any

from bus.messages import LinkKind
from outrider.running.summary import Summary

FIRST = {
    "run": "int64",
    "block": "string",
    "law": "string",
    "seed": "int64",
    "scenario": "string",
    "version": "string",
}
"""Columns that come before the varied fields, with their Parquet types."""

_LINKS = (LinkKind.DETECTIONS, LinkKind.COMMANDS)
"""Links whose state has columns."""

RESULTS = {
    "ticks": "int64",
    "visibility_radius": "double",  # r_v [m]
    "max_distance": "double",  # [m]
    "margin": "double",  # r_v - max_distance [m]; the promise is broken where it is not positive
    "visibility_violations": "int64",  # ticks
    "violated": "bool",
    "mean_distance": "double",  # [m]
    "initial_error": "double",  # e(0) [m²]
    "mean_error": "double",  # [m²]
    "final_error": "double",  # [m²]
    "estimate_rmse": "double",  # [m]
    **{
        f"{kind}_{what}": "double"
        for kind in _LINKS
        for what in ("mean_age", "max_age", "delivery_ratio")
    },  # [s], [s], share
    "certified_share": "double",  # of the ticks; none for a law without a safety filter
    "intervened_share": "double",
    "certified_while_lost": "int64",  # ticks, certified with the UGV out of sight; 0, or the certificate is wrong
    # ticks, not certified although the one before was and all assumptions held; likewise
    "certificate_broken": "int64",
    # how the UGVs got through; none where there are no hazards
    "arrived": "bool",
    "mission_time": "double",  # [s]
    "hazards_hit": "int64",
    "near_misses": "int64",
    "hazards_on_way": "int64",
    "warned": "int64",
    "warned_before": "double",  # [s]
    "seen_ahead": "double",  # share of the way
    "entered_unknown_tile": "int64",  # ticks
    "ground_certificate_broken": "int64",  # ticks; 0, or the guarantee of cautious UGVs is wrong
    "still_time": "double",  # [s]
    "finds": "int64",
    "found": "int64",
    "trajectory_sha256": "string",
    "seconds": "double",  # wall time of the run
    "error": "string",  # why the run failed; none for one that did not
}
"""Columns that a run fills, with their Parquet types; SI units."""


def link_columns(summary: Summary, kind: LinkKind) -> dict[str, float | None]:
    """Age of information [s] and delivery ratio of all links of one kind.

    The mean, the largest, and what arrived of all sent.
    """
    links = [status for name, status in summary.links.items() if name.endswith(f"/{kind}")]
    means = [status.mean_age for status in links if status.mean_age is not None]
    largest = [status.max_age for status in links if status.max_age is not None]
    ratios = [status.delivery_ratio for status in links if status.delivery_ratio is not None]
    return {
        f"{kind}_mean_age": sum(means) / len(means) if means else None,
        f"{kind}_max_age": max(largest, default=None),
        f"{kind}_delivery_ratio": sum(ratios) / len(ratios) if ratios else None,
    }


def row_of(summary: Summary, seconds: float) -> dict[str, Any]:
    """The results of a run that was flown.

    Args:
        summary: Of the run.
        seconds: Its wall time [s].
    """
    row: dict[str, Any] = {name: getattr(summary, name, None) for name in RESULTS}
    for kind in _LINKS:
        row |= link_columns(summary, kind)
    return row | {
        "margin": None
        if summary.max_distance is None
        else summary.visibility_radius - summary.max_distance,
        "violated": summary.visibility_violations > 0,
        "seconds": seconds,
    }


def failed_row(error: Exception, seconds: float) -> dict[str, Any]:
    """The row of a run that raised."""
    reason = " ".join(f"{type(error).__name__}: {error}".split())
    return {**dict.fromkeys(RESULTS), "seconds": seconds, "error": reason}
