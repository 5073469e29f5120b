"""The content of a unit's file besides its code: a vehicle's briefing, or the scenario of a whole flight."""

from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from bus.errors import ScenarioError
from bus.messages.vehicle import UavBriefing, UgvBriefing
from outrider_fmi.vehicle_unit import VehicleUnit

if TYPE_CHECKING:
    from outrider_fmi.world_unit import WorldUnit

_VERSION = "version.txt"
_BRIEFINGS: dict[str, type[UavBriefing] | type[UgvBriefing]] = {
    "uav-briefing.json": UavBriefing,
    "ugv-briefing.json": UgvBriefing,
}
_FLIGHT = "flight.msgpack"


def files_of(content: UavBriefing | UgvBriefing | bytes) -> dict[str, bytes]:
    """The files that a unit carries, by name; of a flight, from `outrider_fmi.world_unit.packed`."""
    told = {_VERSION: version("outrider").encode()}
    if isinstance(content, bytes):
        return told | {_FLIGHT: content}
    (name,) = (name for name, kind in _BRIEFINGS.items() if isinstance(content, kind))
    return told | {name: msgspec.json.format(msgspec.json.encode(content), indent=2)}


def open_unit(folder: Path) -> "VehicleUnit | WorldUnit":
    """The unit of which the files lie in a folder; a vehicle's loads nothing of the world.

    Raises:
        ScenarioError: If another version of Outrider has made them.
    """
    made, here = (folder / _VERSION).read_text("ascii"), version("outrider")
    if made != here:
        raise ScenarioError(f"a unit of outrider {made}; allowed with this one: {here}")
    if (folder / _FLIGHT).exists():
        from outrider_fmi.world_unit import unpacked  # noqa: PLC0415 - a vehicle's process flies units too

        return unpacked((folder / _FLIGHT).read_bytes())
    for name, kind in _BRIEFINGS.items():
        if (folder / name).exists():
            return VehicleUnit(msgspec.json.decode((folder / name).read_bytes(), type=kind))
    raise ScenarioError(f"a unit that carries neither {_FLIGHT} nor {' nor '.join(_BRIEFINGS)}")
