"""Definition of a sweep, read from TOML and the command line and checked."""

import re
from collections.abc import Mapping, Sequence
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from bus.errors import ScenarioError
from bus.messages.base import MAX_SEED, Line, Seed, Text
from sim.input.faults import Fault, one_line
from sim.input.overrides import parse_override
from sim.input.reading import parse_toml, typed
from sim.scenario.loading import read_toml, scenario_names

_VARY_EXAMPLE = "field=value,value, such as links.detections.delay=0,0.5,1"
_OWN_LAW = re.compile(r"uav\.(\d+|\*)\.law(\.name)?")
"""Fields of a UAV's own law."""
_OWN = {"seed": "--seeds, in a file seeds", "law.name": "--law, in a file laws"}
"""Fields that a sweep varies by other options."""


class Block(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Experiment of a sweep: all combinations of the values of its varied fields."""

    name: Line = ""
    """Name in tables and pictures; empty: the varied fields."""
    vary: dict[str, Any] = {}
    """Varied fields of the scenario, each with a list of values."""
    set: dict[str, Any] = {}
    """Fields changed in all runs of the block."""


class Sweep(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Sweep: each law, in each block, at each combination of values, with each seed."""

    title: Line = ""
    scenario: Text = "escort"
    """Name of a shipped scenario, or a file; a relative path may start at the sweep's file."""
    laws: Annotated[tuple[Text, ...], Meta(min_length=1)] | None = None
    """Laws to fly; None: the scenario's law."""
    seeds: Annotated[int, Meta(ge=1, le=1_000_000)] = 20
    """Number of seeds, from `first_seed` on."""
    first_seed: Seed = 0
    set: dict[str, Any] = {}
    """Fields changed in all runs."""
    vary: dict[str, Any] = {}
    """Varied fields of a sweep without blocks."""
    block: tuple[Block, ...] = ()


def shipped_sweeps() -> dict[str, Traversable]:
    """Return the shipped sweeps by name."""
    entries = (files("outrider.experiments.sweep") / "shipped").iterdir()
    return {
        entry.name.removesuffix(".toml"): entry
        for entry in sorted(entries, key=lambda e: e.name)
        if ".toml" in entry.name
    }


def _flat(table: Mapping[str, Any], path: str = "") -> dict[str, Any]:
    """Flatten nested tables to dotted fields, as TOML reads `links.detections.delay = ...` as nested tables."""
    found: dict[str, Any] = {}
    for key, value in table.items():
        if isinstance(value, dict) and value:
            found |= _flat(value, f"{path}{key}.")
        else:
            found[f"{path}{key}"] = value
    return found


def _varied(table: Mapping[str, Any], path: str, file: str) -> dict[str, Any]:
    """Check the varied fields and return them with their values.

    Raises:
        ScenarioError: If a field has no list, an empty list or a repeated value, or is varied by another option.
    """
    varied = _flat(table)
    for field, values in varied.items():
        if field in _OWN:
            wrong = "cannot be varied here"
            raise Fault(f"{path}{field}", values, wrong, _OWN[field]).error(file)
        if not isinstance(values, list) or not values:
            wrong = "empty" if isinstance(values, list) else "not a list"
            raise Fault(f"{path}{field}", values, wrong, "a list of one value or more").error(file)
        if any(value in values[:k] for k, value in enumerate(values)):
            raise Fault(f"{path}{field}", values, "a repeated value", "each value once").error(file)
    return varied


def checked(sweep: Sweep, *, file: str) -> Sweep:
    """Check a sweep; return it with dotted fields, everything in blocks, and a name for each block.

    Args:
        sweep: Sweep as given.
        file: File for error messages.

    Raises:
        ScenarioError: If the sweep is invalid; the message is one line.
    """
    if sweep.vary and sweep.block:
        raise Fault(
            "vary", sweep.vary, "used together with [[block]]", "either [vary] or [[block]]"
        ).error(file)
    last = sweep.first_seed + sweep.seeds - 1
    if last > MAX_SEED:
        allowed = f"at most {MAX_SEED - sweep.seeds + 1}, as the last seed is at most 2**53 - 1"
        raise Fault("first_seed", sweep.first_seed, "too large for the seeds", allowed).error(file)
    laws = sweep.laws or ()
    if len(set(laws)) < len(laws):
        raise Fault("laws", list(laws), "a repeated law", "each law once").error(file)
    blocks: list[Block] = []
    for k, block in enumerate(sweep.block or (Block(vary=sweep.vary),)):
        varied = _varied(block.vary, f"block.{k}.vary." if sweep.block else "vary.", file)
        name = block.name or ", ".join(varied) or "unvaried"
        if name in [other.name for other in blocks]:
            raise Fault(f"block.{k}.name", name, "name of another block", "a unique name").error(
                file
            )
        twice = next((field for field in varied if laws and _OWN_LAW.fullmatch(field)), None)
        if twice is not None:
            wrong = f"used together with laws, which would replace {twice}"
            raise Fault("laws", list(laws), wrong, f"either laws or {twice}").error(file)
        blocks.append(Block(name=name, vary=varied, set=_flat(block.set)))
    return msgspec.structs.replace(sweep, set=_flat(sweep.set), vary={}, block=tuple(blocks))


def parse_vary(text: str, *, file: str) -> tuple[str, list[Any]]:
    """Parse `field=value,value` of --vary; values are TOML, or else plain text.

    Raises:
        ScenarioError: If the text has another form.
    """
    field, separator, values = text.partition("=")
    field = field.strip()
    parts = [part.strip() for part in values.split(",")]
    if not separator or not all(field.split(".")):
        raise Fault("--vary", text, "wrong form", _VARY_EXAMPLE).error(file)
    if not values.strip():
        raise Fault("--vary", text, "no values", _VARY_EXAMPLE).error(file)
    try:
        listed = parse_toml(f"values = [{values}]", file=file)["values"]
    except ScenarioError:
        listed = [parse_override(f"{field}={part}", file=file)[1] for part in parts]
    if not listed or "" in listed:
        raise Fault("--vary", text, "a value is empty", _VARY_EXAMPLE).error(file)
    return field, listed


def _read(source: str) -> tuple[Sweep, str]:
    """Read a sweep and its text; a scenario becomes a sweep without varied fields and without text."""
    if source in scenario_names():
        return Sweep(scenario=source), ""
    shipped = shipped_sweeps()
    if source in shipped:
        text = shipped[source].read_text("utf-8")
    else:
        known = (*shipped, *scenario_names())
        allowed = f"a TOML file, {', '.join(known)}"
        what = "sweep, scenario or file"
        text = read_toml(source, one_line(source) or ".", what, known, allowed)
    file = one_line(source)
    raw = parse_toml(text, file=file)
    if "uav" in raw:  # a scenario's file
        return Sweep(scenario=source), ""
    sweep = typed(raw, Sweep, file=file)
    if source not in shipped and sweep.scenario not in scenario_names():
        beside = Path(source).parent / sweep.scenario
        if beside.is_file():
            sweep = msgspec.structs.replace(sweep, scenario=str(beside))
    return sweep, text


def describe_sweep(
    source: str,
    *,
    laws: str = "",
    vary: Sequence[str] = (),
    changes: Sequence[str] = (),
    seeds: int | None = None,
    first_seed: int | None = None,
) -> tuple[Sweep, str]:
    """Return the sweep defined by a file and the options of a command.

    Args:
        source: Shipped sweep, shipped scenario, or TOML file of either; a file with `[[uav]]` is a scenario.
        laws: Comma-separated laws; replaces the file's.
        vary: Varied fields with values, `field=value,value`; only for a file without varied fields.
        changes: Fields changed in all runs, `field=value`.
        seeds: Number of seeds; replaces the file's.
        first_seed: First seed; replaces the file's.

    Returns:
        The checked sweep, and the text of its file, empty for a scenario.

    Raises:
        ScenarioError: If the sweep cannot be read or is invalid; the message is one line.
    """
    file = one_line(source) or "."
    sweep, text = _read(source)
    if vary and (sweep.vary or sweep.block):
        raise Fault(
            "--vary",
            vary[0],
            "this sweep file defines its varied fields",
            "a scenario, or another sweep file",
        ).error(file)
    varied: dict[str, Any] = dict(sweep.vary)
    for one in vary:
        field, values = parse_vary(one, file=file)
        if field in varied:
            raise Fault("--vary", one, "field varied already", "each field once").error(file)
        varied[field] = values
    fixed = {**_flat(sweep.set), **dict(parse_override(change, file=file) for change in changes)}
    names = tuple(name.strip() for name in laws.split(",")) if laws else sweep.laws
    sweep = msgspec.structs.replace(
        sweep,
        laws=names,
        vary=varied,
        set=fixed,
        seeds=sweep.seeds if seeds is None else seeds,
        first_seed=sweep.first_seed if first_seed is None else first_seed,
    )
    return checked(sweep, file=file), text
