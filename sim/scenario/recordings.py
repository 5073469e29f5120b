"""Traces of a scenario: their files are read once and stored in it."""

from collections.abc import Collection
from pathlib import Path
from typing import Any

import msgspec

from bus.messages.links import LinkKind
from sim.channel.recorded import MOST_BYTES, TRACE_RULE, RecordedLink, pack, read_recording
from sim.input.faults import one_line
from sim.scenario.link_tables import tables_in
from sim.scenario.named_files import read_named
from sim.scenario.types import LinkTable, Scenario


def traces_in(raw: dict[str, Any]) -> frozenset[str]:
    """Return the traces that a raw scenario names; other errors in it are ignored."""
    names = [table.get("trace") for table in tables_in(raw)]
    return frozenset(name for name in names if isinstance(name, str))


def _named(table: LinkTable) -> dict[str, str]:
    """Return the traces of a table, each with the first field that names it."""
    fields = {f"links.{kind}": getattr(table, kind) for kind in LinkKind}
    for k, own in enumerate(table.only):
        fields |= {f"links.only.{k}.{kind}": getattr(own, kind) for kind in LinkKind}
    found: dict[str, str] = {}
    for path, settings in fields.items():
        if settings.trace:
            found.setdefault(settings.trace, f"{path}.trace")
    return found


def with_recordings(
    scenario: Scenario, *, file: str, folder: Path, inside: Collection[str] = ()
) -> Scenario:
    """Return the scenario with the files of all traces that its links name.

    Args:
        scenario: Typed scenario.
        file: Name of the file for error messages.
        folder: Folder of the scenario's file.
        inside: Names given in that file: they must lie in its folder or below. Other names come from the user, and are
            relative to the current folder.

    Raises:
        ScenarioError: If a trace cannot be read, or is invalid.
    """
    kept = {one.name for one in scenario.links.traces}
    read = tuple(
        read_link(name, f"{file}: {field} = {one_line(name)!r}", folder if name in inside else None)
        for name, field in _named(scenario.links).items()
        if name not in kept
    )
    if not read:
        return scenario
    links = msgspec.structs.replace(scenario.links, traces=(*scenario.links.traces, *read))
    return msgspec.structs.replace(scenario, links=links)


def read_link(name: str, where: str, folder: Path | None = None) -> RecordedLink:
    """Read a trace, below `folder` if given; errors are a ScenarioError that begins with `where`."""
    data = read_named(name, where, folder, most=MOST_BYTES, rule=TRACE_RULE)
    read_recording(data, where=where)
    return pack(name, data)
