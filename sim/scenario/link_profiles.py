"""Profiles of links: by name, or in the user's own TOML file.

A file has a table `[profile.NAME]` of link settings for each profile:

    [profile.radio]
    delay = 0.02
    loss = 0.01
"""

from pathlib import Path
from typing import Any

from bus.errors import ScenarioError
from bus.messages.links import LinkSettings
from bus.profiles import NAME_RULE, PROFILES, is_profile_name
from sim.channel.description import link_faults
from sim.input.faults import Fault, near, one_line, shown
from sim.input.reading import parse_toml, type_fault, typed
from sim.scenario.named_files import read_named

FILE_FORM = "FILE.toml or FILE.toml:NAME"
_MOST_BYTES = 1 << 20
_FILE_RULE = f"a TOML file of {_MOST_BYTES >> 20} MiB at most, with tables [profile.NAME]"


def find_profile(
    name: object, field: str, *, file: str = "", folder: Path | None = None
) -> LinkSettings:
    """Return the settings of a profile.

    Args:
        name: Name of a shipped profile or of an installed package's, or `FILE.toml` with one profile, or
            `FILE.toml:NAME`.
        field: Field or option that names it, for error messages.
        file: Scenario for error messages.
        folder: Folder in which the file must lie, see `read_named`.

    Raises:
        ScenarioError: If the profile is unknown or invalid.
    """
    if isinstance(name, str) and name in PROFILES:
        return PROFILES[name]
    path, own = split_name(name) if isinstance(name, str) else ("", "")
    if not path:
        known = tuple(PROFILES)
        wrong = f"unknown profile{near(str(name), known)}"
        raise _error(Fault(field, name, wrong, f"{', '.join(known)}, {FILE_FORM}"), file)
    where = f"{file}: {field} = {shown(name)}" if file else f"{field} {one_line(str(name))}"
    found = read_profiles(read_named(path, where, folder, most=_MOST_BYTES, rule=_FILE_RULE), path)
    if own in found:
        return found[own]
    if not own and len(found) == 1:
        return next(iter(found.values()))
    wrong = (
        f"no such profile in the file{near(own, tuple(found))}"
        if own
        else "a file of several profiles"
    )
    raise _error(Fault(field, name, wrong, ", ".join(f"{path}:{one}" for one in found)), file)


def _error(fault: Fault, file: str) -> ScenarioError:
    """Return the error of a scenario's field, or of an option."""
    if file:
        return fault.error(file)
    return ScenarioError(
        one_line(f"{fault.field} {fault.value}: {fault.wrong}; allowed: {fault.allowed}")
    )


def split_name(name: str) -> tuple[str, str]:
    """Return the file and the name in `FILE.toml` or `FILE.toml:NAME`; empty texts for any other form."""
    path, separator, own = name.rpartition(":")
    if separator and path.lower().endswith(".toml"):
        return path, own
    return (name, "") if name.lower().endswith(".toml") else ("", "")


def is_file_of_profiles(source: str) -> bool:
    """Return true for `FILE.toml:NAME`, and for a TOML file with profiles instead of a scenario."""
    path, own = split_name(source)
    if not path or own:
        return bool(own)
    try:
        text = read_named(path, path, None, most=_MOST_BYTES, rule=_FILE_RULE).decode("utf-8-sig")
        return "profile" in parse_toml(text, file=path)
    except ValueError:
        return False  # the reader of scenarios reports it


def read_profiles(data: bytes, file: str) -> dict[str, LinkSettings]:
    """Return the profiles of a file by name; there is at least one.

    Args:
        data: Content of the file.
        file: Name of the file for error messages.

    Raises:
        ScenarioError: If the file or one of its profiles is invalid.
    """
    file = one_line(file)
    try:
        raw = parse_toml(data.decode("utf-8-sig"), file=file)
    except UnicodeDecodeError as error:
        raise ScenarioError(
            f"{file}: byte {error.start}: not UTF-8, {error.reason}; allowed: text in UTF-8"
        ) from error
    tables = raw.get("profile")
    if not isinstance(tables, dict) or not tables:
        wrong = "missing" if tables is None else "no table of profiles"
        raise Fault("profile", tables, wrong, "tables [profile.NAME]").error(file)
    for key, value in raw.items():
        if key != "profile":
            raise Fault(key, value, "unknown field", "tables [profile.NAME]").error(file)
    return {name: _settings(name, table, file) for name, table in tables.items()}


def _settings(name: str, table: Any, file: str) -> LinkSettings:  # noqa: ANN401 - any value
    """Return the settings of one profile of a file."""
    path = f"profile.{name}"
    if not is_profile_name(name):
        raise Fault(path, None, "not a name", NAME_RULE).error(file)
    if not isinstance(table, dict):
        raise Fault(path, table, "not a table", f"[{path}] with settings of a link").error(file)
    fault = type_fault(table, LinkSettings)
    if fault is not None:
        raise fault._replace(field=f"{path}.{fault.field}").error(file)
    settings = typed(table, LinkSettings, file=file)
    if settings.trace:
        wrong = "a profile cannot name a trace"
        raise Fault(f"{path}.trace", settings.trace, wrong, "trace in the scenario").error(file)
    for fault in link_faults(settings, f"{path}."):
        raise fault.error(file)
    return settings
