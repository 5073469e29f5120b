"""The content of a unit's file besides its code: a vehicle's briefing, or the scenario of a whole flight."""

from importlib.metadata import version
from pathlib import Path

import msgspec

from bus.errors import ScenarioError
from bus.messages import UavBriefing, UgvBriefing
from outrider.bridges.fmi.vehicle_unit import VehicleUnit
from outrider.bridges.fmi.world_unit import WorldUnit
from sim.scenario.types import Scenario

_VERSION = "version.txt"
_BRIEFINGS: dict[str, type[UavBriefing] | type[UgvBriefing]] = {
    "uav-briefing.json": UavBriefing,
    "ugv-briefing.json": UgvBriefing,
}
_FLIGHT = "flight.msgpack"


class FlightCarried(msgspec.Struct, frozen=True):
    """A flight, in MessagePack: JSON has no infinite bounds."""

    scenario: Scenario
    seed: int


def files_of(content: UavBriefing | UgvBriefing | FlightCarried) -> dict[str, bytes]:
    """The files that a unit carries, by name."""
    told = {_VERSION: version("outrider").encode()}
    if isinstance(content, FlightCarried):
        return told | {_FLIGHT: msgspec.msgpack.encode(content)}
    (name,) = (name for name, kind in _BRIEFINGS.items() if isinstance(content, kind))
    return told | {name: msgspec.json.format(msgspec.json.encode(content), indent=2)}


def open_unit(folder: Path) -> VehicleUnit | WorldUnit:
    """The unit of which the files lie in a folder.

    Raises:
        ScenarioError: If another version of Outrider has made them.
    """
    made, here = (folder / _VERSION).read_text("ascii"), version("outrider")
    if made != here:
        raise ScenarioError(f"a unit of outrider {made}; allowed with this one: {here}")
    if (folder / _FLIGHT).exists():
        flight = msgspec.msgpack.decode((folder / _FLIGHT).read_bytes(), type=FlightCarried)
        return WorldUnit(flight.scenario, flight.seed)
    for name, kind in _BRIEFINGS.items():
        if (folder / name).exists():
            return VehicleUnit(msgspec.json.decode((folder / name).read_bytes(), type=kind))
    raise ScenarioError(f"a unit that carries neither {_FLIGHT} nor {' nor '.join(_BRIEFINGS)}")
