"""Links of a scenario in TOML: profiles by name, and changes to them."""

from typing import Any

import msgspec

from bus.messages.links import LinkKind
from bus.profiles import PROFILES
from sim.input.faults import Fault, near

_KINDS = tuple(str(kind) for kind in LinkKind)


def _profile(table: dict[str, Any], path: str, file: str) -> dict[str, Any]:
    """Remove the profile from a table and return its settings; empty if it names none.

    Raises:
        ScenarioError: If the profile is unknown.
    """
    if "profile" not in table:
        return {}
    name = table.pop("profile")
    if not isinstance(name, str) or name not in PROFILES:
        wrong = f"unknown profile{near(str(name), tuple(PROFILES))}"
        raise Fault(f"{path}.profile", name, wrong, ", ".join(PROFILES)).error(file)
    settings: dict[str, Any] = msgspec.to_builtins(PROFILES[name])
    return settings


def _fill(
    table: dict[str, Any], base: dict[str, dict[str, Any]], path: str, file: str
) -> dict[str, dict[str, Any]]:
    """Fill in the settings of every kind of link in a table, in place.

    They start from `base`, or from a profile, and are overwritten by the table.
    """
    common = _profile(table, path, file)
    filled: dict[str, dict[str, Any]] = {}
    for kind in _KINDS:
        own = table.get(kind, {})
        if not isinstance(own, dict):
            continue  # type validation reports the error
        own = dict(own)
        start = _profile(own, f"{path}.{kind}", file) or common or base.get(kind, {})
        filled[kind] = table[kind] = {**start, **own}
    return filled


def with_profiles(raw: dict[str, Any], *, file: str) -> None:
    """Replace the profiles in a raw scenario by their settings.

    Args:
        raw: Scenario as read from TOML; `links` is changed.
        file: Name of the file for error messages.

    Raises:
        ScenarioError: If it names an unknown profile.
    """
    links = raw.get("links")
    if not isinstance(links, dict):
        return
    raw["links"] = links = dict(links)
    common = _fill(links, {}, "links", file)
    only = links.get("only")
    if isinstance(only, list):
        links["only"] = only = [dict(row) if isinstance(row, dict) else row for row in only]
        for k, row in enumerate(only):
            if isinstance(row, dict):
                _fill(row, common, f"links.only.{k}", file)
