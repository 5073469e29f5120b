"""Links of a scenario in TOML: profiles by name, and changes to them."""

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from bus.messages.links import LinkKind
from sim.scenario.link_profiles import find_profile

_KINDS = tuple(str(kind) for kind in LinkKind)


class _Origin(NamedTuple):
    """Scenario's file, and the profiles that it names itself."""

    file: str
    folder: Path
    inside: Collection[str]


def tables_in(raw: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield all tables of link settings in a raw scenario, whatever they contain."""
    links = raw.get("links")
    if not isinstance(links, dict):
        return
    only = links.get("only")
    for table in (links, *(only if isinstance(only, list) else ())):
        if isinstance(table, dict):
            yield table
            yield from (own for kind in _KINDS if isinstance(own := table.get(kind), dict))


def profiles_in(raw: dict[str, Any]) -> frozenset[str]:
    """Return the profiles that a raw scenario names; other errors in it are ignored."""
    names = [table.get("profile") for table in tables_in(raw)]
    return frozenset(name for name in names if isinstance(name, str))


def _profile(table: dict[str, Any], path: str, origin: _Origin) -> dict[str, Any]:
    """Remove the profile from a table and return its settings; empty if it names none.

    Raises:
        ScenarioError: If the profile is unknown.
    """
    if "profile" not in table:
        return {}
    name = table.pop("profile")
    folder = origin.folder if isinstance(name, str) and name in origin.inside else None
    found = find_profile(name, f"{path}.profile", file=origin.file, folder=folder)
    settings: dict[str, Any] = msgspec.to_builtins(found)
    return settings


def _fill(
    table: dict[str, Any], base: dict[str, dict[str, Any]], path: str, origin: _Origin
) -> dict[str, dict[str, Any]]:
    """Fill in the settings of every kind of link in a table, in place.

    They start from `base`, or from a profile, and are overwritten by the table.
    """
    common = _profile(table, path, origin)
    filled: dict[str, dict[str, Any]] = {}
    for kind in _KINDS:
        own = table.get(kind, {})
        if not isinstance(own, dict):
            continue  # type validation reports the error
        own = dict(own)
        start = _profile(own, f"{path}.{kind}", origin) or common or base.get(kind, {})
        filled[kind] = table[kind] = {**start, **own}
    return filled


def with_profiles(
    raw: dict[str, Any], *, file: str, folder: Path, inside: Collection[str] = ()
) -> None:
    """Replace the profiles in a raw scenario by their settings.

    Args:
        raw: Scenario as read from TOML; `links` is changed.
        file: Name of the file for error messages.
        folder: Folder of that file.
        inside: Profiles named in that file: files of profiles must lie in its folder or below. Other names come from
            the user, and are relative to the current folder.

    Raises:
        ScenarioError: If it names an unknown profile.
    """
    links = raw.get("links")
    if not isinstance(links, dict):
        return
    origin = _Origin(file, folder, inside)
    raw["links"] = links = dict(links)
    common = _fill(links, {}, "links", origin)
    only = links.get("only")
    if isinstance(only, list):
        links["only"] = only = [dict(row) if isinstance(row, dict) else row for row in only]
        for k, row in enumerate(only):
            if isinstance(row, dict):
                _fill(row, common, f"links.only.{k}", origin)
