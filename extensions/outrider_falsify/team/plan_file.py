"""File of an attack on a team: a scenario, and the events in its table `[attack]`."""

import tomllib
from collections.abc import Iterable
from pathlib import Path

import msgspec

from outrider_falsify.team.events import Event, Events
from sim.input.faults import one_line
from sim.input.reading import typed
from sim.scenario.checks import check_scenario
from sim.scenario.resolved import as_toml
from sim.scenario.types import Scenario

_TABLE = "attack"


class _Attack(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Content of the table."""

    event: tuple[Event, ...] = ()


def attack_toml(scenario: Scenario, events: Events, comments: Iterable[str]) -> str:
    """Return the text of a file; without events it is a scenario."""
    text = as_toml(scenario, comments)
    for event in events:
        shown = ((key, value) for key, value in msgspec.to_builtins(event).items() if value != "")
        fields = "\n".join(f"{key} = {msgspec.json.encode(value).decode()}" for key, value in shown)
        text += f"\n[[{_TABLE}.event]]\n{fields}\n"
    return text


def read_attack(source: str) -> tuple[Scenario, Events] | None:
    """Return scenario and events of a file; None: it is no file of an attack.

    Raises:
        ScenarioError: If the file is damaged.
    """
    path = Path(source)
    if not path.is_file():
        return None
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None  # the loading of the scenario says what is wrong
    if _TABLE not in raw:
        return None
    file = one_line(source)
    attack = typed(raw.pop(_TABLE), _Attack, file=file)
    return check_scenario(typed(raw, Scenario, file=file), source=file), attack.event
