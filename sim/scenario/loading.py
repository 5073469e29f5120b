"""From a shipped name or a TOML file to a scenario that can be flown."""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path

import msgspec

from bus.errors import ScenarioError
from bus.files import read_regular
from bus.policies import policy_kinds
from bus.registry import DRIVERS
from sim.input.faults import Fault, near, one_line
from sim.input.overrides import apply_override, parse_override
from sim.input.reading import as_raw, parse_toml, typed
from sim.scenario.checks import check_scenario
from sim.scenario.link_tables import with_profiles
from sim.scenario.recordings import traces_in, with_recordings
from sim.scenario.tracks import with_tracks
from sim.scenario.types import DEFAULT_AREA, Scenario

DEFAULT_SCENARIO = "escort"
MOST_BYTES = 1 << 20
"""Of a scenario's or a sweep's file: room for some thousand vehicles."""
Overrides = Mapping[str, object] | Sequence[str | tuple[str, object]]
FILE_RULE = f"a TOML file of {MOST_BYTES >> 20} MiB at most"


def _shipped() -> dict[str, Traversable]:
    """The shipped scenarios by name."""
    entries = (files("sim.scenario") / "shipped").iterdir()
    return {
        entry.name.removesuffix(".toml"): entry for entry in entries if entry.name.endswith(".toml")
    }


def scenario_names() -> tuple[str, ...]:
    """Names of the shipped scenarios, the default first."""
    return tuple(sorted(_shipped(), key=lambda name: (name != DEFAULT_SCENARIO, name)))


def schema_text() -> str:
    """Return the JSON Schema of a scenario's file, which docs/generators/scenario_schema.py makes."""
    return (files("sim.scenario") / "scenario.schema.json").read_text("utf-8")


def shipped_text(name: str) -> str:
    """The TOML text of a shipped scenario.

    Raises:
        ScenarioError: If none has this name.
    """
    shipped = _shipped().get(name)
    if shipped is None:
        known = scenario_names()
        raise ScenarioError(
            f"{one_line(name)}: no such scenario{near(name, known)}; allowed: {', '.join(known)}"
        )
    return shipped.read_text("utf-8")


def _read(source: str | Path, file: str) -> str:
    """The TOML text of a shipped scenario or of a file."""
    shipped = _shipped().get(str(source))
    if shipped is not None:
        return shipped.read_text("utf-8")
    known = scenario_names()
    other = f"a TOML file, or {', '.join(known)}"
    return read_toml(source, file, "file or scenario", known, other)


def read_toml(source: str | Path, file: str, what: str, known: Sequence[str], allowed: str) -> str:
    """The text of a TOML file.

    Args:
        source: Its path.
        file: Its name for messages.
        what: What could have been meant beside a file, for messages.
        known: Names that could have been meant.
        allowed: What is allowed, for messages.

    Raises:
        ScenarioError: If it cannot be read.
    """
    try:
        return read_regular(Path(source), MOST_BYTES).decode("utf-8-sig")
    except FileNotFoundError as error:
        wrong = f"no such {what}{near(Path(source).stem, known)}"
        raise ScenarioError(f"{file}: {wrong}; allowed: {allowed}") from error
    except UnicodeDecodeError as error:
        raise ScenarioError(
            f"{file}: byte {error.start}: not UTF-8, {error.reason}; allowed: text in UTF-8"
        ) from error
    except (OSError, ValueError) as error:  # a ValueError: a NUL in the path
        reason = one_line(str(getattr(error, "strerror", None) or error))
        raise ScenarioError(f"{file}: cannot be read: {reason}; allowed: {FILE_RULE}") from error


def _changes(overrides: Overrides, file: str) -> Iterator[tuple[str, object]]:
    if isinstance(overrides, Mapping):
        overrides = [*overrides.items()]
    for change in [overrides] if isinstance(overrides, str) else overrides:
        if isinstance(change, str):
            yield parse_override(change, file=file)
        else:
            yield str(change[0]), as_raw(change[1], file=file)


def _with_names(raw: dict[str, object]) -> None:
    """Give each vehicle without a name the next one: uav_0, uav_1, ..."""
    for kind in ("uav", "ugv"):
        given = raw.get(kind)
        tables = (
            [table for table in given if isinstance(table, dict)] if isinstance(given, list) else []
        )
        taken = {str(table["name"]) for table in tables if "name" in table}
        free = (name for k in itertools.count() if (name := f"{kind}_{k}") not in taken)
        for table in tables:
            if "name" not in table:
                table["name"] = next(free)


def given_scenario(scenario: str | Path | Scenario, duration: float | None = None) -> Scenario:
    """A scenario, or a shipped one by its name, or one from a file; checked.

    Args:
        scenario: The one, the name or the file.
        duration: Instead of its own [s].

    Raises:
        ScenarioError: If there is none, or it cannot be flown.
    """
    loaded = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
    return check_scenario(
        loaded if duration is None else msgspec.structs.replace(loaded, duration=duration)
    )


def _with_saved_drivers(raw: dict[str, object], *, file: str) -> None:
    """Take a driver such as `fmu:FILE.fmu` as the driver `policy`, with that as the policy.

    Raises:
        ScenarioError: If there is another policy already.
    """
    (own,) = (row for row in DRIVERS.values() if row.own)
    ugvs, custom = raw.get("ugv"), raw.get("custom", {})
    if not isinstance(ugvs, list) or not isinstance(custom, dict):
        return
    for k, ugv in enumerate(ugvs):
        named = ugv.get("driver") if isinstance(ugv, dict) else None
        library, separator, _ = named.partition(":") if isinstance(named, str) else ("", "", "")
        if not separator or library not in policy_kinds("ugv"):
            continue
        other = custom.setdefault(own.own, named)
        if other != named:
            wrong = f"custom.{own.own} = {one_line(str(other))!r} is another, and one can drive"
            raise Fault(f"ugv.{k}.driver", named, wrong, "one policy a run").error(file)
        ugv["driver"], raw["custom"] = own.name, custom


def _refuse_risk(raw: dict[str, object], *, file: str) -> None:
    """Name the command that replaces `certificate.risk`.

    Raises:
        ScenarioError: If the scenario has this field.
    """
    certificate = raw.get("certificate")
    if isinstance(certificate, dict) and "risk" in certificate:
        wrong = "no field of a scenario"
        allowed = "the bounds that `outrider network bounds SCENARIO --risk 1e-3` prints"
        raise Fault("certificate.risk", certificate["risk"], wrong, allowed).error(file)


def load_scenario(source: str | Path = DEFAULT_SCENARIO, *, overrides: Overrides = ()) -> Scenario:
    """Read and validate a scenario.

    Args:
        source: A shipped name, or a TOML file.
        overrides: Changes made before anything is validated, in order: fields and their values, or texts such as
            `uav.0.max_speed=0.5`, the value as TOML writes it or else plain text. `uav.*` is every UAV.

    Returns:
        The scenario; its name is the file's, without its ending, where none is given.

    Raises:
        ScenarioError: If it cannot be read or cannot be flown; one line with file, field, value, what is wrong and
            allowed.
        TypeError: If it is neither a name nor a file.
    """
    if not isinstance(source, (str, Path)):
        raise TypeError(
            f"scenario: is of type {type(source).__name__}; allowed: a shipped name, or a file"
        )
    file = one_line(str(source)) or "."
    raw = parse_toml(_read(source, file), file=file)
    named = traces_in(raw)
    for key, value in _changes(overrides, file):
        apply_override(raw, key, value, file=file)
    if isinstance(raw.get("area"), dict):
        raw["area"] = {**msgspec.to_builtins(DEFAULT_AREA), **raw["area"]}
    _refuse_risk(raw, file=file)
    _with_names(raw)
    _with_saved_drivers(raw, file=file)
    with_profiles(raw, file=file)
    scenario = typed(raw, Scenario, file=file)
    if not scenario.name:
        scenario = msgspec.structs.replace(scenario, name=one_line(Path(source).stem))
    scenario = with_recordings(
        with_tracks(scenario, file=file), file=file, folder=Path(source).parent, inside=named
    )
    return check_scenario(scenario, source=file)
