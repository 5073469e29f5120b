"""The links of a scenario as TOML gives them: profiles by name, and what is changed in them."""

from typing import Any

import msgspec

from bus.messages.links import LinkKind
from bus.profiles import PROFILES
from sim.input.faults import Fault, near

_KINDS = tuple(str(kind) for kind in LinkKind)


def _profile(table: dict[str, Any], path: str, file: str) -> dict[str, Any]:
    """The settings of the profile that a table names, taken out of it; none where it names none.

    Raises:
        ScenarioError: If there is no such profile.
    """
    if "profile" not in table:
        return {}
    name = table.pop("profile")
    if not isinstance(name, str) or name not in PROFILES:
        wrong = f"no such profile{near(str(name), tuple(PROFILES))}"
        raise Fault(f"{path}.profile", name, wrong, ", ".join(PROFILES)).error(file)
    settings: dict[str, Any] = msgspec.to_builtins(PROFILES[name])
    return settings


def _fill(
    table: dict[str, Any], base: dict[str, dict[str, Any]], path: str, file: str
) -> dict[str, dict[str, Any]]:
    """Give every kind of link in a table its settings, in place.

    Those of `base`, or of its profile, and then its own.
    """
    common = _profile(table, path, file)
    filled: dict[str, dict[str, Any]] = {}
    for kind in _KINDS:
        own = table.get(kind, {})
        if not isinstance(own, dict):
            continue  # the types say what is wrong
        own = dict(own)
        start = _profile(own, f"{path}.{kind}", file) or common or base.get(kind, {})
        filled[kind] = table[kind] = {**start, **own}
    return filled


def with_profiles(raw: dict[str, Any], *, file: str) -> None:
    """Put the numbers of the profiles that a raw scenario names in their place.

    Args:
        raw: As TOML gives it; `links` is changed.
        file: For the error.

    Raises:
        ScenarioError: If it names a profile that does not exist.
    """
    links = raw.get("links")
    if not isinstance(links, dict):
        return
    raw["links"] = links = dict(links)
    everybody = _fill(links, {}, "links", file)
    only = links.get("only")
    if isinstance(only, list):
        links["only"] = only = [dict(row) if isinstance(row, dict) else row for row in only]
        for k, row in enumerate(only):
            if isinstance(row, dict):
                _fill(row, everybody, f"links.only.{k}", file)
