"""Radio links of a scenario, and the keys of their random numbers.

Every message crosses its link in simulated time, inside the simulator: environment, processes and containers have the
same network.
"""

from collections.abc import Sequence

from bus.messages.links import LinkKind
from sim.channel.links import Links
from sim.models.randomness import (
    COMMAND_LINK,
    DETECTION_LINK,
    OPERATOR_LINK,
    RADIO_LINK,
    TEAM_LINK,
)
from sim.scenario.team import mates_of
from sim.scenario.types import Scenario
from sim.scenario.vehicle_types import Uav, Ugv

ENGINE_LINKS = (LinkKind.DETECTIONS, LinkKind.COMMANDS)
"""Kinds of links that the engine's tick handles."""
_PURPOSES = {
    LinkKind.DETECTIONS: DETECTION_LINK,
    LinkKind.COMMANDS: COMMAND_LINK,
    LinkKind.OPERATOR: OPERATOR_LINK,
    LinkKind.RADIO: RADIO_LINK,
    LinkKind.TEAM: TEAM_LINK,
}
_VEHICLES = {
    LinkKind.DETECTIONS: Uav,
    LinkKind.COMMANDS: Uav | Ugv,
    LinkKind.OPERATOR: Ugv,
    LinkKind.RADIO: Uav,
    LinkKind.TEAM: Uav,
}


def vehicles_with(scenario: Scenario, kind: LinkKind) -> tuple[str, ...]:
    """Return the vehicles that have a link of this kind, in name order."""
    names = tuple(one.name for one in scenario.vehicles if isinstance(one, _VEHICLES[kind]))
    return tuple(name for name in names if kind is not LinkKind.TEAM or mates_of(scenario, name))


def links_of(scenario: Scenario, kinds: Sequence[LinkKind], worlds: int = 1) -> Links:
    """Return the links of these kinds: all of the first kind in name order, then all of the next.

    Args:
        scenario: The scenario.
        kinds: Kinds of links.
        worlds: Number of worlds.
    """
    names = [(kind, name) for kind in kinds for name in vehicles_with(scenario, kind)]
    settings = {(kind, name): scenario.links.of(name, kind) for kind, name in names}
    return Links(settings, dt=scenario.dt, worlds=worlds, traces=scenario.links.traces)


def key_rows(scenario: Scenario, links: Links) -> tuple[list[int], list[int]]:
    """Return the purpose and the vehicle's row of each link's key."""
    rows = {vehicle.name: k for k, vehicle in enumerate(scenario.vehicles)}
    return [_PURPOSES[kind] for kind, _ in links.names], [rows[name] for _, name in links.names]
