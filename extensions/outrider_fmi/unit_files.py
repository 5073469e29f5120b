"""Files of a unit besides its code: a vehicle's briefing, or the scenario of a whole run."""

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
    """Return the files of a unit by name; bytes come from `outrider_fmi.world_unit.packed`."""
    files = {_VERSION: version("outrider").encode()}
    if isinstance(content, bytes):
        return files | {_FLIGHT: content}
    (name,) = (name for name, kind in _BRIEFINGS.items() if isinstance(content, kind))
    return files | {name: msgspec.json.format(msgspec.json.encode(content), indent=2)}


def open_unit(folder: Path) -> "VehicleUnit | WorldUnit":
    """Return the unit whose files are in a folder; a vehicle's unit imports nothing of the world.

    Raises:
        ScenarioError: If another version of Outrider exported the unit.
    """
    made, here = (folder / _VERSION).read_text("ascii"), version("outrider")
    if made != here:
        raise ScenarioError(f"a unit of outrider {made}; allowed: {here}, the installed version")
    if (folder / _FLIGHT).exists():
        from outrider_fmi.world_unit import unpacked  # noqa: PLC0415 - a vehicle's process needs no world

        return unpacked((folder / _FLIGHT).read_bytes())
    for name, kind in _BRIEFINGS.items():
        if (folder / name).exists():
            return VehicleUnit(msgspec.json.decode((folder / name).read_bytes(), type=kind))
    raise ScenarioError(f"a unit without content; allowed: {_FLIGHT}, {', '.join(_BRIEFINGS)}")
