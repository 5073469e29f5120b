"""Work of `outrider mavlink --vehicle` and `--autopilot`: a UAV of a run."""

import sys
import time
from typing import Any

from agents.process import MakePilot
from agents.warming import warm_up
from bus.keys import Role
from bus.messages.scenario import Origin
from outrider.cli.joining import Joining
from outrider_mavlink.autopilot import AutopilotPilot
from outrider_mavlink.autopilot_link import AutopilotLink
from outrider_mavlink.dialect import mavlink
from outrider_mavlink.identity import VehicleSystem
from outrider_mavlink.offboard import OffboardGateway, OffboardPilot, serving
from outrider_mavlink.udp import Network

_TURN = 0.02
"""Maximum time between two updates from the autopilot [s]."""


def _join(joining: Joining, make: MakePilot, gateway: OffboardGateway | AutopilotLink) -> None:
    """Fly a UAV until the end of the run, and serve MAVLink in parallel."""
    warm_up(Role.UAV, inner=lambda _observation: (0.0, 0.0))
    with serving(gateway):
        joining.fly(make)


def fly_by_setpoints(
    network: Network, joining: Joining, first: int, height: float
) -> dict[str, Any]:
    """Fly a UAV by setpoints until the end of the run; return the counts."""
    name = joining.party.name
    system = VehicleSystem(name, first, flies=True, origin=Origin(), height=height)
    system.capabilities |= mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    pilot = OffboardPilot()
    gateway = OffboardGateway(pilot, network, system)
    _join(joining, pilot.make, gateway)
    gateway.say(system, "the run is over")
    return {"vehicles": {system.name: system.number}, **gateway.counts()}


def fly_with_autopilot(network: Network, joining: Joining) -> dict[str, Any]:
    """Fly a UAV with a real autopilot until the end of the run; return the counts."""
    link = AutopilotLink(network)
    pilot = AutopilotPilot(link)
    began, announced = time.monotonic(), False
    while link.reported is None:  # the run must not start without telemetry
        link.turn(_TURN)
        link.refresh()
        if not announced and time.monotonic() - began > 1.0:
            announced = True
            sys.stderr.write("waiting for an autopilot's telemetry; cancel with Ctrl-C\n")
    _join(joining, pilot.make, link)
    vehicles = {joining.party.name: 0 if link.peer is None else link.peer.system}
    found = {"vehicles": vehicles, "sent": dict(network.sent), "received": link.reports}
    return found | pilot.counts()
