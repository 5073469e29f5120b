"""All links of a run.

What crosses the ether between a vehicle and its sensor, its actuators, its operator and the other.

Every message crosses in simulated time, inside the simulator: the environment, three processes and containers meet
one network.
"""

from bus.errors import ScenarioError
from bus.messages import LinkKind, LinkSettings, LinkStatus
from sim.channel.description import Link, check_link
from sim.models.randomness import (
    COMMAND_LINK,
    DETECTION_LINK,
    OPERATOR_LINK,
    RADIO_LINK,
    Key,
    WordArray,
)
from sim.scenario.types import Scenario

_PURPOSES = {
    LinkKind.DETECTIONS: DETECTION_LINK,
    LinkKind.COMMANDS: COMMAND_LINK,
    LinkKind.OPERATOR: OPERATOR_LINK,
    LinkKind.RADIO: RADIO_LINK,
}
"""Of the links' keys."""
PER_TICK = {LinkKind.DETECTIONS: 1, LinkKind.COMMANDS: 1, LinkKind.OPERATOR: 64, LinkKind.RADIO: 16}
"""Messages that a link has room for in every tick; what is more is lost."""


def owners(scenario: Scenario, kind: LinkKind) -> tuple[str, ...]:
    """The vehicles that have a link of this kind, in name order."""
    uavs = {uav.name for uav in scenario.uav}
    if kind is LinkKind.COMMANDS:
        return tuple(vehicle.name for vehicle in scenario.vehicles)
    of_uavs = kind is not LinkKind.OPERATOR
    return tuple(vehicle.name for vehicle in scenario.vehicles if (vehicle.name in uavs) is of_uavs)


def _key(words: WordArray) -> Key:
    """Two words of an array as they are: a compiled function would give them back as Python's own numbers."""
    return words[0], words[1]


def hold_ticks(scenario: Scenario) -> int:
    """For how many ticks a vehicle goes on with its last command when none comes."""
    return round(scenario.hold / scenario.dt)


class Links:
    """The links of one run.

    Args:
        scenario: What is flown.
        keys: Of the run's random numbers. Shape (RUN_PURPOSES, vehicles, 2).
    """

    def __init__(self, scenario: Scenario, keys: WordArray) -> None:
        rows = {vehicle.name: k for k, vehicle in enumerate(scenario.vehicles)}
        self.table = scenario.links
        """What the links do now, as a scenario would write it."""
        self._of: dict[LinkKind, dict[str, Link]] = {
            kind: {
                name: Link(
                    scenario.links.of(name, kind),
                    dt=scenario.dt,
                    key=_key(keys[_PURPOSES[kind], rows[name]]),
                    label=f"{name}/{kind}",
                    per_tick=PER_TICK[kind],
                )
                for name in owners(scenario, kind)
            }
            for kind in LinkKind
        }

    def of(self, kind: LinkKind) -> dict[str, Link]:
        """The links of one kind by vehicle: a UAV's detections and radio, a UGV's operator, everybody's commands."""
        return self._of[kind]

    @property
    def degraded(self) -> bool:
        """Whether any of them does anything to a message."""
        return any(not link.perfect for links in self._of.values() for link in links.values())

    def change(self, kind: LinkKind, vehicle: str | None, settings: LinkSettings) -> None:
        """Give links other settings; what is under way arrives as it would have.

        Args:
            kind: Which.
            vehicle: Whose; None: everybody's.
            settings: The new ones.

        Raises:
            ScenarioError: If the settings are impossible, or this vehicle has no such link.
        """
        links = self._of[kind]
        if vehicle is not None and vehicle not in links:
            raise ScenarioError(
                f"vehicle = {vehicle!r}: has no link for its {kind}; allowed: {', '.join(links)}"
            )
        check_link(settings, str(kind))
        for name in links if vehicle is None else (vehicle,):
            links[name].change(settings)
        self.table = self.table.changed(kind, vehicle, settings)

    def status(self, vehicle: str | None = None) -> dict[str, LinkStatus]:
        """How each link has done so far, by `vehicle/kind`.

        Args:
            vehicle: Of this one alone; None: of all.
        """
        return {
            f"{name}/{kind}": link.counters()
            for kind, links in self._of.items()
            for name, link in links.items()
            if vehicle in (None, name)
        }
