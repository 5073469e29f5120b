"""Vertical motion, the radius of sight by altitude, and the lemma that buildings hide no UGV within it."""

import csv
import math
from pathlib import Path

import numpy as np
import pytest

from agents.control.altitude import climb_to
from agents.safety.levels import levels_of, lowest_certified
from agents.safety.safety_filter import SafetyFilter
from bus.messages.decision import NotCertified
from bus.messages.telemetry import EscortTruth, Status
from bus.messages.vehicle import Detection, Teleoperation, UavObservation
from flights import altered
from outrider.cli.console import OUT
from outrider.cli.summary_table import print_summary
from outrider.running.assumptions import assumption_warnings, certified_from, how_certifiable
from outrider.running.flying import InProcess, fly, make_pilots
from outrider.running.summary import summarize
from processes import flown_both_ways
from sim.engine.briefing import uav_briefing
from sim.models.altitude import (
    VerticalLimits,
    level_off,
    levelling_height,
    lowest_ahead,
    step_altitude,
)
from sim.models.buildings import building_distance, building_table, line_of_sight
from sim.models.safety import visible_radius
from sim.models.vehicles import step_vehicle
from sim.scenario.loading import load_scenario
from sim.server.flight import Flight
from sim.world import World

DT, U, RATE = 0.05, 0.8, 1.5
LIMITS = VerticalLimits(0.5, 100.0, RATE, U)


@pytest.mark.parametrize("rate", [-1.5, -0.73, -1e-3, 0.0, 1e-9, 0.04, 1.2])
def test_levelling_height_is_what_the_vehicle_flies(rate: float) -> None:
    z, v, lowest = 50.0, rate, 50.0
    for _ in range(200):
        z, v, _ = step_altitude(z, v, level_off(v, U, DT), LIMITS, DT)
        lowest = min(lowest, z)
    assert v == 0.0
    assert z == pytest.approx(50.0 + levelling_height(rate, U, DT), abs=1e-9)
    assert lowest == pytest.approx(lowest_ahead(50.0, rate, U, DT), abs=1e-9)


def test_climb_keeps_its_bounds() -> None:
    rng = np.random.default_rng(3)
    z, v = 10.0, 0.0
    for command in rng.normal(0.0, 3.0, 5000):
        before = v
        z, v, u = step_altitude(z, v, float(command), VerticalLimits(2.0, 20.0, RATE, U), DT)
        assert 2.0 <= z <= 20.0
        assert abs(v) <= RATE
        assert abs(u) <= U
        assert abs(v - before) <= U * DT + 1e-12 or z in (2.0, 20.0)


@pytest.mark.parametrize("goal", [12.0, 30.0, 4.3])
def test_a_climb_ends_at_its_goal_within_a_centimetre(goal: float) -> None:
    z, v, altitudes = 12.0, 0.0, []
    for _ in range(1200):
        z, v, _ = step_altitude(z, v, climb_to(z, v, goal, RATE, U, DT), LIMITS, DT)
        altitudes.append(z)
    assert z == pytest.approx(goal, abs=1e-6)
    assert min(altitudes) >= min(goal, 12.0) - 0.01
    assert max(altitudes) <= max(goal, 12.0) + 0.01


def _town(rng: np.random.Generator) -> list[tuple[list[tuple[float, float]], float]]:
    """Return random buildings, convex and not, in an area of 30 m."""
    found = []
    for _ in range(int(rng.integers(1, 12))):
        x, y = rng.uniform(0.0, 30.0, 2)
        angles = np.sort(rng.uniform(0.0, 2.0 * math.pi, int(rng.integers(3, 8))))
        radii = rng.uniform(0.5, 4.0, len(angles))
        corners = [
            (x + r * math.cos(a), y + r * math.sin(a)) for r, a in zip(radii, angles, strict=True)
        ]
        found.append((corners, float(rng.uniform(0.5, 8.0))))
    return found


def test_no_building_hides_a_ugv_within_the_radius() -> None:
    """Lemma 7 over 40,000 random places in random towns; half of the distances are just within the radius."""
    rng, tried, near = np.random.default_rng(5), 0, 0
    while tried < 40_000:
        rows, corners = building_table(_town(rng))
        tallest, marker = float(rows["height"].max()), float(rng.uniform(0.0, 0.4))
        for _ in range(400):
            x, y = rng.uniform(0.0, 30.0, 2)
            clearance = building_distance(rows, corners, x, y, 0.0)
            if clearance == 0.0:
                continue
            z = tallest * (1.0 + rng.exponential(0.5)) + 1e-6
            radius = visible_radius(z, 1e3, 1e3, marker, tallest, clearance)
            share = 1.0 - 1e-9 if rng.random() < 0.5 else rng.random()
            angle, far = rng.uniform(0.0, 2.0 * math.pi), share * radius
            p = x + far * math.cos(angle), y + far * math.sin(angle)
            assert line_of_sight(rows, corners, *p, z, x, y, marker)
            beyond = x + 1.2 * radius * math.cos(angle), y + 1.2 * radius * math.sin(angle)
            near += not line_of_sight(rows, corners, *beyond, z, x, y, marker)
            tried += 1
    assert near > 100  # the radius is nearly the largest possible


def test_bounds_of_the_filter_grow_with_the_floor() -> None:
    scenario = load_scenario("town", overrides=["uav.0.min_altitude=1.0"])
    levels = levels_of(uav_briefing(scenario, "uav_0", 0))
    assert len(levels) > 5
    assert levels["valid"].all()
    for name in ("floor", "radius", "handover_radius", "handover_bound"):
        assert (np.diff(levels[name]) >= 0.0).all()
    assert levels["radius"][-1] <= scenario.visibility.radius


def test_a_descent_starts_with_the_ugv_within_the_lower_radius() -> None:
    """The UAV flies to its UGV, a millimetre above the highest floor, and always tries to descend."""
    agile = ["detections.noise=0", "uav.0.max_speed=2.0", "uav.0.max_acceleration=2.0"]
    brief = uav_briefing(load_scenario("town", overrides=agile), "uav_0", 0)
    low, high = levels_of(brief)[-2:]
    (v_a, u_a), dt = brief.limits.numbers, brief.dt
    descents = 0
    for start in np.linspace(low["handover_radius"], high["handover_radius"] + 0.02, 40):
        safety_filter, x, v, k, z = SafetyFilter(brief), -float(start), 0.6, 0, high["floor"] + 1e-3
        while True:
            seen = UavObservation(
                tick=k,
                time=k * dt,
                position=(20.0 + x, 20.0),
                velocity=(v, 0.0),
                altitude=float(z),
                detections=(Detection(time=k * dt, relative_position=(x, 0.0)),),
            )
            safety_filter.see(seen)
            decision = safety_filter.filter(seen, (u_a, 0.0), -1.0)
            if decision.vertical_acceleration < 0.0:
                break
            x, _, v, *_ = step_vehicle(x, 0.0, v, 0.0, *decision.acceleration, v_a, u_a, dt)
            k += 1
        if k > 0 and decision.certified:
            descents += 1
            assert decision.certified_distance <= low["radius"]
    assert descents > 20


def test_check_names_the_lowest_certified_altitude_and_why() -> None:
    scenario = load_scenario("town", overrides=["uav.0.min_altitude=1.0"])
    brief = uav_briefing(scenario, "uav_0", 0)
    lowest = lowest_certified(brief)
    assert lowest is not None
    assert f"at {math.ceil(100.0 * lowest) / 100.0:.2f} m or higher" in certified_from(brief)
    assert how_certifiable(scenario) == "always"
    low = load_scenario("town", overrides=["uav.0.min_altitude=1", "uav.0.initial_altitude=6.01"])
    assert how_certifiable(low) == "not always"  # the safety filter climbs
    assert any("too low" in line for line in assumption_warnings(low))


@pytest.mark.parametrize(
    ("change", "phrase"),
    [
        ("ugv.0.driver=waypoints", "guarantees no distance from buildings"),
        ("ugv.0.caution=bold", "guarantees no distance from buildings"),
        ("buildings.known=false ground.miss=0.01", "guarantees no distance from buildings"),
        ("ugv.0.building_clearance=0", "guarantees no distance from buildings"),
    ],
)
def test_without_a_guaranteed_clearance_nothing_is_certified(change: str, phrase: str) -> None:
    scenario = load_scenario("town", overrides=["building_field.0.street=6", *change.split()])
    assert how_certifiable(scenario) == "never"
    assert any(phrase in line for line in assumption_warnings(scenario))


def test_receiver_levels_off_as_soon_as_commands_are_lost() -> None:
    """Without a filter, the horizontal acceleration stays in effect for the command timeout."""
    world = World(load_scenario("town", overrides=["law.name=tracking"]), 1)
    uav, ticks = world.vertical[0], 40
    for k in range(ticks):
        if k < 10:
            world.send(0, world.tick, (0.1, 0.0), vertical=-0.5)
        world.advance()
        assert uav["rate"] == pytest.approx(
            max(-0.025 * (k + 1), -0.25) if k < 10 else min(0.0, -0.25 + 0.05 * (k - 9))
        )
        assert (world.commands[0, 0] == 0.1) == (k < 20)


def test_town_flies_one_trajectory_over_three_processes() -> None:
    there, here = flown_both_ways("town", "duration=8.0", "altitude.law=best")
    assert there["certified_while_lost"] == here.certified_while_lost == 0
    assert here.certified_share is not None
    assert here.certified_share > 0.9


def test_a_change_of_driver_that_ends_the_clearance_is_reported() -> None:
    notices: list[str] = []
    flight = Flight(load_scenario("town"), 7, on_notice=notices.append)
    flight.assign_driver("ugv_0", "navigate")
    assert notices == []
    flight.assign_driver("ugv_0", "wander")
    (line,) = notices
    assert "ugv_0: the driver wander keeps no distance from buildings" in line


class Steered(InProcess):
    """An operator steers the UGV to the nearest building; then it navigates on, or another driver takes over."""

    def __init__(self, flight: Flight, then: str) -> None:
        super().__init__(make_pilots(flight.scenario, flight.seed))
        self._flight, self._then = flight, then

    def begin(self, tick: int) -> None:
        flight = self._flight
        if tick in (40, 600):
            flight.assign_driver("ugv_0", "teleop" if tick == 40 else self._then)
        if 40 <= tick < 600 and tick % 20 == 0:
            centers = [np.mean(one.polygon, axis=0) for one in flight.world.buildings]
            offsets = np.array(centers) - flight.world.position[1]
            offset = offsets[np.argmin(np.hypot(*offsets.T))]
            velocity = tuple(0.2 * offset / np.hypot(*offset))
            flight.teleoperate("ugv_0", Teleoperation(operator="anna", velocity=velocity))


def steered(seed: int, then: str = "navigate") -> tuple[Flight, list[EscortTruth], list[Status]]:
    """Return a flight over a town whose UGV is steered, with its truths and statuses, one per tick."""
    changes = ["altitude.law=best", "uav.0.max_altitude=20", "uav.0.min_altitude=7"]
    changes += ["uav.0.initial_altitude=8", "duration=36"]
    flight = Flight(load_scenario("town", overrides=changes), seed, on_notice=lambda line: None)
    truths, statuses = list[EscortTruth](), list[Status]()

    def follow() -> None:
        statuses.append(flight.status())
        truths.extend(flight.truth().escorts)

    flight.fly(Steered(flight, then), on_tick=follow)
    return flight, truths, statuses


def test_ticks_of_an_operator_near_buildings_are_not_certified(tmp_path: Path) -> None:
    """The UAV does not know the operator, who hides the UGV; the simulator does, and accuses no certificate."""
    flight, truths, statuses = steered(7)
    summary = summarize(flight, seconds=1.0)
    for tick, (truth, status) in enumerate(zip(truths, statuses, strict=True)):
        assert truth.report is not None
        assert truth.report.decision is not None
        claimed, valid = truth.report.decision.certified, truth.revoked is None
        assert valid == (tick < 40 or not claimed)
        assert status.certified == {"uav_0": claimed and valid}
        assert len(status.warnings) == (40 <= tick < 600)
        if claimed and not valid:
            assert status.uncertified == {"uav_0": NotCertified.NO_CLEARANCE}
    assert summary.certified_share == 40 / len(truths)
    assert summary.uncertified[NotCertified.NO_CLEARANCE] > 500
    assert summary.visibility_violations > 40
    assert (summary.certified_while_lost, summary.certificate_broken) == (0, 0)
    assert summary.lost_without_clearance is not None
    assert summary.lost_without_clearance > 10
    assert summary.mission is not None
    assert summary.mission.near_building == summary.mission.near_building_excused
    assert (summary.mission.near_building or 0) > 100
    flight.recorder.write(tmp_path / "trajectory.csv")
    with (tmp_path / "trajectory.csv").open(newline="", encoding="utf-8") as file:
        certified = [row["uav_0.certified"] for row in csv.DictReader(file)]
    assert certified == ["1"] * 40 + ["0"] * (len(truths) - 40) + [""]
    with OUT.capture() as captured:
        print_summary(summary, [])
    assert "explained by the driver" in captured.get()
    assert "contradicts" not in captured.get()


@pytest.mark.parametrize(("then", "again"), [("navigate", True), ("wander", False)])
def test_certificates_count_again_only_if_the_ugv_navigates(then: str, again: bool) -> None:
    """This operator does not come near a building."""
    _, truths, statuses = steered(2, then)
    assert all(
        status.certified["uav_0"] == (tick < 40) for tick, status in enumerate(statuses[:600])
    )
    assert {status.certified["uav_0"] for status in statuses[630:]} == {again}
    assert all(truth.report and truth.report.decision for truth in truths)


def test_ugv_program_that_reports_nothing_keeps_no_clearance() -> None:
    """The scenario names the driver navigate, but another program drives."""
    scenario = load_scenario("town", overrides=["duration=2"])
    flight = Flight(scenario, 7)
    flight.fly(altered(make_pilots(scenario, 7), "ugv_0", lambda seen: {"report": None}))
    assert flight.answers.assurance.certified == 0
    assert set(flight.answers.assurance.reasons) == {NotCertified.NO_CLEARANCE}


def test_the_hash_of_a_trajectory_covers_the_altitude() -> None:
    """Without noise, the law `tracking` flies the same way at both altitudes."""
    changes = ["law.name=tracking", "detections.noise=0", "duration=1"]
    flights = [
        fly(load_scenario("town", overrides=[*changes, f"uav.0.initial_altitude={z}"]), 7)[0]
        for z in (14.0, 15.0)
    ]
    low, high = (flight.recorder.states[:-1] for flight in flights)
    assert np.array_equal(low, high)
    assert flights[0].recorder.sha256() != flights[1].recorder.sha256()
