"""Reduction of the benchmarks to rows with limits: a JSON list and a table."""

from collections.abc import Mapping
from typing import Any

import msgspec
import pytest


class ResultRow(msgspec.Struct, frozen=True, kw_only=True):
    """Row of results: a throughput and its limit, or the duration of a start."""

    name: str
    value: float
    unit: str
    limit: float | None
    """Throughput in the same unit; None for a start, or without a measured limit."""
    ratio: float | None
    """Ratio value / limit."""


_ROWS = pytest.StashKey[list[ResultRow]]()


def _median(benchmark: Mapping[str, Any]) -> float:
    """Return the median in the row's unit: of the reported rates, else from the time per call."""
    facts, seconds = benchmark["extra_info"], benchmark["median"]
    if "rate" in facts:
        return float(facts["rate"])
    return float(facts["steps"] / seconds if "steps" in facts else seconds)


def _rows(benchmarks: list[Any]) -> list[ResultRow]:
    medians: dict[str, dict[str, float]] = {}
    units: dict[str, str] = {}
    for benchmark in benchmarks:
        if benchmark and not benchmark.has_error:
            name, _, side = benchmark["name"].removeprefix("test_").partition("[")
            medians.setdefault(name, {})[side.removesuffix("]") or "value"] = _median(benchmark)
            units[name] = benchmark["extra_info"]["unit"]
    return [
        ResultRow(
            name=name,
            value=sides["value"],
            unit=units[name],
            limit=sides.get("limit"),
            ratio=sides["value"] / sides["limit"] if "limit" in sides else None,
        )
        for name, sides in medians.items()
        if "value" in sides
    ]


def pytest_benchmark_generate_json(
    config: pytest.Config, benchmarks: list[Any]
) -> list[dict[str, Any]]:
    """Write the rows instead of pytest-benchmark's own report."""
    config.stash[_ROWS] = rows = _rows(benchmarks)
    return [msgspec.to_builtins(row) for row in rows]


def pytest_terminal_summary(
    terminalreporter: pytest.TerminalReporter, config: pytest.Config
) -> None:
    """Print the rows."""
    terminalreporter.section("benchmarks")
    terminalreporter.line(f"{'row':16}{'value':>10} {'unit':10}{'limit':>10}{'ratio':>7}")
    for row in config.stash.get(_ROWS, []):
        value = f"{row.value:10,.0f}" if row.limit else f"{row.value:10.2f}"
        limit = f"{row.limit:10,.0f}{row.ratio:7.2f}" if row.limit else ""
        terminalreporter.line(f"{row.name:16}{value} {row.unit:10}{limit}")
