"""Runs over towns whose UGVs change their driver, and whose UAVs dive: is a tick counted as certified out of sight?

Chosen by `walls.py --takeovers`. Every run has a town, a network and adversaries as there, with late commands of both
vehicles and of the operator. An operator steers the UGV into the shadow of buildings; other drivers relieve each
other every few seconds, at any speed. shapely judges each tick. A tick counts as certified if the simulator says so.
"""

import contextlib
import logging
from collections import Counter
from collections.abc import Iterator
from typing import Any

import msgspec
import numpy as np
import shapely
from walls import SIZE, Judge, Pilot, drawn_scenario, rings

from agents.uav import UavPilot
from bus.errors import ScenarioError
from bus.messages.links import LinkSettings
from bus.messages.scenario import Law
from bus.messages.vehicle import Teleoperation
from outrider.running.flying import InProcess, make_pilots
from sim.engine.briefing import uav_briefing
from sim.scenario.checks import check_scenario
from sim.scenario.types import Scenario, VehicleLinks
from sim.server.flight import Flight

_DRIVERS = ("navigate", "navigate", "teleop", "teleop", "wander", "waypoints", "evade")
"""Drivers that relieve each other; a name that occurs twice is assigned twice as often."""
_TURNS = 0.02
"""Probability of another driver in a tick."""
_DURATION = 10.0
"""Duration of a run [s]."""


def scenario_of(rng: np.random.Generator) -> tuple[Scenario, list[Any], list[float]]:
    """Return a scenario, its buildings and their heights."""
    one, shapes, heights, _ = drawn_scenario(rng)
    (ugv,), clearance = one.ugv, one.ugv[0].building_clearance
    routes = rings(shapes, clearance + 3.0 * one.ground.tile)
    goals = [
        route.interpolate(rng.uniform(), normalized=True).coords[0]
        for route in routes
        for _ in range(3)
    ]
    commands = LinkSettings(
        delay=float(rng.choice([0.0, 0.1, 0.25, 0.4])), loss=float(rng.choice([0.0, 0.0, 0.2]))
    )
    operator = LinkSettings(delay=float(rng.choice([0.0, 0.5, 1.9])))
    own = VehicleLinks(vehicle="ugv_0", commands=commands, operator=operator)
    links = msgspec.structs.replace(one.links, only=(*one.links.only, own))
    ugv = msgspec.structs.replace(ugv, goals=tuple(goals), keeps_clearance=False)
    return (
        check_scenario(
            msgspec.structs.replace(
                one, ugv=(ugv,), links=links, law=Law(name="certified"), duration=_DURATION
            )
        ),
        shapes,
        heights,
    )


def flyable(rng: np.random.Generator) -> tuple[Scenario, list[Any], list[float]]:
    """Return the first scenario of `scenario_of` in which the UGV has a route to its goals."""
    while True:
        with contextlib.suppress(ScenarioError):
            return scenario_of(rng)


class Takeovers(InProcess):
    """Pilots, whose UAV an adversary flies inside its safety filter, and operators who change the UGV's driver."""

    def __init__(self, flight: Flight, shapes: list[Any], rng: np.random.Generator) -> None:
        pilots: dict[str, Any] = dict(make_pilots(flight.scenario, flight.seed))
        brief = uav_briefing(flight.scenario, "uav_0", flight.seed)
        pilots["uav_0"] = UavPilot(brief, policy=self._nominal, policy_name="adversary")
        super().__init__(pilots)
        self._flight, self._rng, self._adversary = flight, rng, Pilot(shapes, rng, 1)
        self._all = shapely.union_all(shapes)
        self.changes = 0

    def _nominal(self, _rows: Any) -> Any:
        (uav, ugv), velocity = self._flight.world.position, self._flight.world.velocity[:1]
        return self._adversary.command(uav[None], ugv[None], velocity)

    def begin(self, tick: int) -> None:
        flight, rng = self._flight, self._rng
        if rng.random() < _TURNS:
            self.changes += 1
            flight.assign_driver("ugv_0", str(rng.choice(_DRIVERS)))
        if flight.drivers["ugv_0"] == "teleop" and tick % 10 == 0:
            uav, ugv = flight.world.position
            nearest = shapely.shortest_line(shapely.Point(ugv), self._all).coords
            away = rng.choice([-1.0, 1.0, 1.0]) * np.subtract(nearest[1], ugv) + 0.3 * (ugv - uav)
            velocity = away / max(float(np.hypot(*away)), 1e-9) * flight.scenario.ugv[0].max_speed
            x, y = velocity.tolist()
            flight.teleoperate("ugv_0", Teleoperation(operator="adversary", velocity=(x, y)))


def _claims(flight: Flight, exchange: InProcess) -> Iterator[tuple[bool, bool]]:
    """Yield for each tick whether the UAV certifies it, and whether the simulator counts it as certified."""
    while not flight.over and flight.fly_tick(exchange):
        (report,), (revoked,) = flight.answers.reports, flight.answers.revoked
        claimed = report is not None and report.decision is not None and report.decision.certified
        yield claimed, claimed and revoked is None


def attack(seed: int, filtered: bool = True) -> Counter[str]:
    """Fly one town, and return its counts. `filtered`: must be True."""
    if not filtered:
        raise ValueError("filtered = False: not possible with takeovers; allowed: True")
    logging.getLogger("outrider.policy").setLevel(logging.ERROR)  # it may be slow
    rng = np.random.default_rng((seed, 1))
    scenario, shapes, heights = flyable(rng)
    flight = Flight(scenario, seed, on_notice=lambda _: None)
    exchange, judge = Takeovers(flight, shapes, rng), Judge(scenario, shapes, heights)
    world, counts = flight.world, Counter(runs=1, towns=1)
    wrong = 0

    def seen() -> bool:
        position, z = world.position, world.vertical["altitude"][:1]
        return bool(judge.sees(position[:1], z, position[1:])[0])

    visible = seen()
    for claimed, certified in _claims(flight, exchange):
        wrong += certified and not visible
        counts["certified by the UAV alone, out of sight"] += (
            claimed and not certified and not visible
        )
        counts["certified ticks"] += certified
        counts["revoked ticks"] += claimed and not certified
        counts["ticks out of sight"] += not visible
        counts["ticks"] += 1
        visible = seen()
    counts["certified out of sight"] += wrong + flight.answers.assurance.certified_while_lost
    counts["certificate broken"] += flight.answers.assurance.certificate_broken
    counts["contacts"] += int(world.vertical["contacts"].sum())
    counts["changes of driver"] += exchange.changes
    mission = world.mission
    if mission is not None:
        near, excused = mission.near_building or 0, mission.near_building_excused or 0
        counts["ticks near a building, explained"] += excused
        counts["ticks near a building, unexplained"] += near - excused
    counts["runs outside the area"] += int((world.position > SIZE).any())
    return counts
