"""Whole runs over networks that break the certificate's assumptions: no tick is certified while sight is lost."""

import math

import pytest

from agents.uav import UavPilot
from bus.messages.links import LinkKind, LinkSettings
from bus.messages.scenario import Law
from bus.messages.vehicle import UavObservation
from outrider.running.flying import InProcess, make_pilots
from sim.engine.briefing import briefing
from sim.scenario.loading import load_scenario
from sim.server.flight import Flight

R_V = 4.75
BLACKOUTS = "links.detections.blackouts=[[30.0, 20.0], [80.0, 30.0]]"
CALM = ("ugv.0.driver=waypoints",)
LATE = ("links.commands.delay=0.5", "command_timeout=1.5", "certificate.max_measurement_age=5.0")
PERFECT = ("detections.noise=0.0", "detections.dropout=0.0")
NARROW, JAMMED = (f"links.commands={{profile = '{name}'}}" for name in ("narrowband", "jammed"))
SLOW = ("command_timeout=2.0", "certificate.max_measurement_age=6.0")
DECLARED = "certificate.max_command_delay=0.5"

BROKEN = {
    "regained with pending commands": ((*PERFECT, *LATE, BLACKOUTS), 7),
    "narrowband": ((NARROW, *SLOW), 8),
    "jammed": ((JAMMED, *SLOW), 9),
    "commands lost": ((*LATE, "links.commands.loss=0.05"), 7),
    "jitter as declared": ((*PERFECT, *LATE[:2], "links.commands.jitter=0.1", DECLARED), 11),
    "jammed without noise": ((*PERFECT, JAMMED, *SLOW), 11),
}
"""Networks that break the declared command delay or measurement age, and a seed.

With seed 11, a filter that checks only the state at which its command acts certifies a lost tick.
"""


def claims_of(changes, seed, on_tick=None):
    """Return whether each tick was certified; check that no certified tick was out of sight or counted as a fault."""
    base = ("law.name=certified", "ugv.0.driver=evade", "area.cell=0.5", "duration=160.0")
    scenario = load_scenario("escort", overrides=[*base, *changes])
    flight = Flight(scenario, seed)
    claims: list[bool | None] = []

    def append_claim() -> None:
        report = flight.answers.reports[0]
        decision = None if report is None else report.decision
        claims.append(None if decision is None else decision.certified)
        if on_tick is not None:
            on_tick(flight)

    flight.fly(InProcess(make_pilots(scenario, seed)), on_tick=append_claim)
    counted = flight.answers.assurance
    assert (counted.certified_while_lost, counted.certificate_broken) == (0, 0)
    distances = flight.recorder.escorts[:-1, 0, 0].tolist()
    assert not [far for far, claim in zip(distances, claims, strict=True) if claim and far >= R_V]
    return claims


@pytest.mark.parametrize("name", BROKEN)
def test_undeclared_command_delay_certifies_no_tick_beyond_r_v(name: str) -> None:
    assert set(claims_of(*BROKEN[name])) >= {True, False}


def test_changed_law_is_certified_from_its_own_commands_on():
    """The filter once ignored the pending commands."""

    def change(flight: Flight) -> None:
        if flight.world.tick % 400 == 200:
            flight.order(Law(name="coverage"))
        if flight.world.tick % 400 == 0:
            flight.order(Law(name="certified"))

    late = (
        "links.commands.delay=2.0",
        "command_timeout=3.0",
        "certificate.max_measurement_age=2.0",
    )
    claims = claims_of((*PERFECT, *CALM, *late), 7, change)
    for begin in range(400, 3200, 400):
        assert set(claims[begin : begin + 40]) == {False}
    assert claims[400:].count(True) > 200


def test_changed_links_are_not_certified_beyond_r_v() -> None:
    def change(flight: Flight) -> None:
        if flight.world.tick % 200 == 100:
            flight.degrade(LinkKind.COMMANDS, "uav_0", LinkSettings(delay=0.9, jitter=0.2))
        if flight.world.tick % 200 == 0:
            flight.degrade(LinkKind.COMMANDS, "uav_0", LinkSettings(delay=0.5))

    claims = claims_of((*PERFECT, *LATE), 8, change)
    assert False in claims[100:]
    assert any(claims[300:])


def test_residual_velocity_at_a_wall_keeps_the_certificate() -> None:
    """A wall removes the velocity that leads into it; the current plan must not add it again."""
    scenario = load_scenario(
        "escort",
        overrides=[
            "duration=60.0",
            "area.cell=1.0",
            *PERFECT,
            "uav.0.position=[10.0, 1e-7]",
            "ugv.0={position=[10.5, 0.0], max_speed=0.2, max_acceleration=0.1, driver='script'}",
            "ugv.0.script=[{time=0.0, velocity=[0.2, 0.0]}, {time=24.0, velocity=[0.2, 1e-7]}, "
            "{time=25.0, velocity=[0.2, 0.0]}]",
        ],
    )

    def creep(observation: UavObservation) -> tuple[float, float]:
        speed = math.hypot(*observation.velocity)
        if speed < 1e-10:
            return 0.0, -0.9e-9 / scenario.dt
        return 0.0, 2e-6 if speed > 2e-9 else 0.0

    flight, pilots = Flight(scenario, 1), make_pilots(scenario, 1)
    pilots["uav_0"] = UavPilot(briefing(scenario, "uav_0", 1), inner=creep)
    flight.fly(InProcess(pilots))
    counted = flight.answers.assurance
    assert counted.certified == scenario.ticks
    assert (counted.certified_while_lost, counted.certificate_broken) == (0, 0)
