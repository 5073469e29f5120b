"""Teams with altitudes: bands that keep UAVs apart, flights above roofs without the filter, and the leash."""

import itertools
import json
import math
import os
import random
import signal
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus.errors import ScenarioError
from bus.messages.team import Role
from outrider.envs.worlds import Worlds
from outrider.running.flying import fly
from outrider.running.summary import summarize
from processes import await_status, child_of, flying, observing
from properties import PROPERTY
from sim.engine.briefing import uav_briefing
from sim.engine.team_monitor import are_too_near
from sim.models.altitude import VerticalLimits, step_altitude
from sim.scenario.loading import load_scenario
from sim.scenario.team import lowest_sight
from sim.scenario.types import Scenario, altitude_limits
from sim.server.flight import Flight
from sim.world import World
from test_teams import assert_guaranteed, assert_taken_over, mortal, status_of

ROOF = 3.0
LOW = {
    "min_altitude": 2.0,
    "max_altitude": 12.0,
    "initial_altitude": 9.0,
    "vertical_clearance": 5.0,
}
MIDDLE = {"min_altitude": 14.0, "max_altitude": 16.0, "initial_altitude": 15.0}
TOP = {"min_altitude": 18.0, "max_altitude": 20.0, "initial_altitude": 19.0}
"""Bands of three UAVs, 2 m apart; roofs reach into the lowest one."""
SCOUTING_LOW = (TOP, MIDDLE, LOW)
"""The same, so that the lowest UAV scouts: of those that accept in one tick, the first UAV guards."""
DIVING = {"law.name": "policy", "custom.uav_policy": f"{__name__}:dive"}
"""Every UAV flies off and dives; its role and its filter decide what comes of it."""


def town(
    duration: float, *, bands: tuple[dict[str, float], ...] = (LOW, MIDDLE, TOP), **changes: Any
) -> Scenario:
    given = {
        "uav": [{"position": [3.0 + 0.5 * k, 4.0]} | band for k, band in enumerate(bands)],
        "team": {},
        "building_field.0.height": [2.0, ROOF],
        "area.cell": 0.5,
        "duration": duration,
    }
    return load_scenario(
        "town", overrides=given | {key.replace("__", "."): one for key, one in changes.items()}
    )


def dive(rows: np.ndarray) -> np.ndarray:
    """Return the acceleration of a policy that flies off and dives, for rows that begin with time and position."""
    time, x, _ = rows[0, :3].tolist()
    rng = random.Random(f"{int(time)} {int(x)}")
    u_z = rng.choice((-1e3, -1.0, -0.3, 0.5, 1e3))
    return np.array([[rng.uniform(-1.0, 1.0), rng.uniform(-1.0, 1.0), u_z]])


def altitudes(flight: Flight) -> np.ndarray:
    found: np.ndarray = flight.recorder.heights[:, :, 0]
    return found


def assert_apart_and_above(flight: Flight) -> None:
    """Check that the UAVs have kept their bands, each other's distance, and the roofs."""
    assert status_of(flight).separation_violations == 0
    separation = summarize(flight, seconds=1.0).min_separation
    assert separation is not None
    assert separation >= 2.0 - 1e-6
    assert flight.world.vertical["contacts"].sum() == 0
    for column, uav in zip(altitudes(flight).T, flight.scenario.uav, strict=True):
        limits = altitude_limits(flight.scenario, uav)
        assert limits is not None
        assert column.min() >= max(limits.min_altitude, ROOF + limits.vertical_clearance)
        assert column.max() <= limits.max_altitude


# Flights


@pytest.mark.parametrize(
    "number", [*range(2), *(pytest.param(n, marks=pytest.mark.long) for n in range(2, 40))]
)
def test_diving_uavs_keep_every_guarantee_in_a_town(number: int) -> None:
    """Their processes die in the tick of a hand-over and at random, over a bad network."""
    rng = random.Random(number)
    lossy = number % 2 == 1
    changes = {
        "team.guards": rng.choice((1, 2)),
        "links.team.loss": rng.choice((0.3, 0.8)),
        "links.team.delay": rng.choice((0.0, 0.5)),
        "links.team.jitter": rng.choice((0.0, 0.5)),
        "links.commands.delay": 0.1 if number % 4 < 2 else 0.0,
        "links.commands.loss": 0.2 if lossy else 0.0,
        "links.detections.delay": rng.choice((0.0, 0.2)),
        "certificate.max_command_interval": 0.5,
        "altitude.law": rng.choice(("fixed", "best")),
    }
    bands = SCOUTING_LOW if number % 3 else (LOW, MIDDLE, TOP)
    flight = Flight(town(40.0, bands=bands, **DIVING, **changes), number)
    newest = [0]

    def dies(tick: int) -> list[str]:
        numbers = {name: flight.team.number(name) for name in flight.team.refused}
        largest = max(numbers.values())
        accepted, newest[0] = largest > newest[0], largest
        if tick == 400 or (tick > 100 and accepted):
            return [max(numbers, key=numbers.__getitem__)]
        return [rng.choice(sorted(numbers))] if tick > 200 and rng.random() < 0.003 else []

    exchange = mortal(flight, dies, absent=rng.choice((10, 60)))
    flight.fly(exchange)
    status = assert_guaranteed(flight)
    assert exchange.deaths > 0
    assert status.team_certified_share > 0.5
    assert_apart_and_above(flight)


def test_scouts_that_dive_stay_above_the_roofs_of_a_town() -> None:
    """No filter acts on them: the vertical rule alone stops their dive."""
    flight = Flight(town(60.0, bands=SCOUTING_LOW, **DIVING), 3)
    flight.fly(mortal(flight, lambda _: [], absent=1))
    status = assert_guaranteed(flight)
    assert status.team_certified_share > 0.99
    assert status.team_out_of_sight == 0
    assert flight.answers.roles() == {
        "uav_0": Role.GUARD,
        "uav_1": Role.SCOUT,
        "uav_2": Role.SCOUT,
    }
    assert_apart_and_above(flight)
    assert altitudes(flight)[:, 2].min() < ROOF + LOW["vertical_clearance"] + 0.01  # it did dive


def test_a_uav_of_a_town_flies_its_own_law() -> None:
    lone = load_scenario("town", overrides=["uav.0.law.name=lookahead", "duration=0.2"])
    named = load_scenario("town", overrides=["law.name=lookahead", "duration=0.2"])
    assert fly(lone, 3)[1].trajectory_sha256 == fly(named, 3)[1].trajectory_sha256


def test_a_scout_above_a_town_takes_over_from_a_dead_guard() -> None:
    flight = Flight(town(40.0, law__name="certified"), 3)
    assert_taken_over(flight)
    assert_apart_and_above(flight)


@pytest.mark.usefixtures("nothing_left_behind")
def test_a_team_in_a_town_flies_the_same_bits_in_processes(tmp_path: Path) -> None:
    text = """
        seed = 5
        duration = 15.0
        law.name = "certified"
        detections.noise = 0.1
        area.cell = 0.5
        team = {}
        links.team.loss = 0.3
        building_field = [{ block = [4.0, 7.0], street = 5.0, height = [2.0, 3.0] }]
        uav = [
            { position = [3.0, 4.0], initial_altitude = 9.0, min_altitude = 8.0, max_altitude = 10.0 },
            { position = [3.5, 4.0], initial_altitude = 13.0, min_altitude = 12.0, max_altitude = 14.0 },
        ]
        ugv = [{ driver = "navigate", position = [3.0, 3.0], goals = [[37.0, 36.0]], building_clearance = 1.5 }]
        """
    file = tmp_path / "team.toml"
    file.write_text(text)
    scenario = load_scenario(file)
    with flying(str(file), "--no-files", "--json", "--respawn") as run:
        with observing(run) as session:
            await_status(session, lambda status: status.tick > 0)
            os.kill(child_of(run, "uav"), signal.SIGKILL)
        out, err = run.communicate(timeout=200)
    assert run.returncode == 0, err
    summary = json.loads(out)
    assert summary["trajectory_sha256"] == fly(scenario, scenario.seed)[1].trajectory_sha256
    found = summary["team"]
    assert found["team_certified_while_lost"] == found["team_certificate_broken"] == 0
    assert found["separation_violations"] == 0
    assert found["team_certified_share"] > 0.99


# Bands


@given(
    st.lists(st.floats(allow_nan=False), min_size=1, max_size=40),
    st.floats(1.0, 100.0),
    st.floats(0.0, 10.0),
    st.floats(0.05, 20.0),
)
@PROPERTY
def test_an_altitude_stays_in_its_band_whatever_the_command(commands, lowest, height, u) -> None:
    limits = VerticalLimits(lowest, lowest + height, 1.0, u)
    altitude, rate = lowest + 0.5 * height, 0.0
    for command in commands:
        altitude, rate, _ = step_altitude(altitude, rate, command, limits, 0.05)
        assert lowest <= altitude <= lowest + height


def test_hostile_commands_bring_no_two_uavs_together() -> None:
    """Whatever arrives at the vehicles: the bands of the simulator hold, even above roofs."""
    world, rng = World(town(30.0), 3), random.Random(1)
    pushes = (math.nan, -1e300, 1e300, -math.inf, math.inf, -0.4, 0.4)
    held = [rng.choice(pushes) for _ in world.names]
    for tick in range(600):
        if tick % 40 == 0:
            held = [rng.choice(pushes) for _ in world.names]
        for k in range(len(world.names)):
            world.send(k, tick, (rng.uniform(-0.3, 0.3), rng.uniform(-0.3, 0.3)), (), held[k])
        world.advance()
        z = [world.vertical["altitude"][k] for k in world.escorts[:, 0]]
        for altitude, band in zip(z, (LOW, MIDDLE, TOP), strict=True):
            assert band["min_altitude"] <= altitude <= band["max_altitude"]
        assert min(b - a for a, b in itertools.pairwise(z)) >= 2.0


def test_uavs_that_are_too_near_are_counted() -> None:
    """Bands that overlap, which no check has accepted."""
    points = np.array([[0.0, 0.0, 10.0], [1.2, 0.0, 11.6], [9.0, 9.0, 10.0]])
    assert not are_too_near(points, 2.0)
    assert are_too_near(points, 2.01)
    assert not are_too_near(points, 0.0)
    scenario = town(5.0, law__name="certified")
    uavs = [
        msgspec.structs.replace(uav, position=(3.0 + k, 4.0), **MIDDLE)
        for k, uav in enumerate(scenario.uav)
    ]
    flight, summary = fly(msgspec.structs.replace(scenario, uav=tuple(uavs)), 3)
    rows = flight.world.escorts[:, 0]
    places = flight.recorder.states[:-1, rows, :2]  # the monitor counts ticks with commands
    pairs = [(0, 1), (0, 2), (1, 2)]
    apart = [np.linalg.norm(places[:, i] - places[:, k], axis=1) for i, k in pairs]
    near = int((np.min(apart, axis=0) < 2.0 - 1e-6).sum())
    assert near > 0
    assert summary.team is not None
    assert summary.team.separation_violations == near


def refused(**changes: Any) -> str:
    with pytest.raises(ScenarioError) as error:
        town(10.0, **changes)
    assert "\n" not in str(error.value)
    return str(error.value)


def test_the_smallest_change_of_a_band_that_would_do_is_named_and_does() -> None:
    cases: list[tuple[dict[str, Any], str, dict[str, Any]]] = [
        (
            {"uav.0.max_altitude": 12.5},
            "uav.1.min_altitude = 14.0: the bands of uav_0 [2, 12.5] m and uav_1 [14, 16] m are not 2 m apart "
            "(team.separation); allowed: from 14.5 m",
            {"uav.1.min_altitude": 14.5},
        ),
        (
            {"uav.0.max_altitude": 13.5, "uav.0.initial_altitude": 11.0},
            "uav.0.max_altitude = 13.5: the bands of uav_0 [2, 13.5] m and uav_1 [14, 16] m are not 2 m apart "
            "(team.separation); allowed: up to 12 m",
            {"uav.0.max_altitude": 12.0},
        ),
        (
            {"uav.1.min_altitude": 9.0, "uav.0.max_altitude": 16.0},
            "uav.1.min_altitude = 9.0: the bands of uav_0 [2, 16] m and uav_1 [9, 16] m are not 2 m apart "
            "(team.separation); allowed: 13 m, with uav.0.max_altitude = 11",
            {"uav.1.min_altitude": 13.0, "uav.0.max_altitude": 11.0},
        ),
        (
            {"uav.1.initial_altitude": 18.5, "uav.1.max_altitude": 19.0},
            "uav.2.initial_altitude = 19.0: the bands of uav_1 [14, 19] m and uav_2 [18, 20] m are not 2 m apart "
            "(team.separation); allowed: 20.5 m, with uav.1.max_altitude = 18.5 and uav.2.max_altitude = 20.5 and "
            "uav.2.min_altitude = 20.5",
            {
                "uav.1.max_altitude": 18.5,
                "uav.2.max_altitude": 20.5,
                "uav.2.min_altitude": 20.5,
                "uav.2.initial_altitude": 20.5,
            },
        ),
    ]
    for changes, said, cure in cases:
        assert refused(**changes) == f"town: {said}"
        town(10.0, **changes | cure)
    assert "not 4.5 m apart" in refused(team__separation=4.5)
    town(10.0, team__separation=0.0, uav__1__min_altitude=12.0)


def test_bands_of_different_teams_are_separated_too() -> None:
    others = {
        "ugv": [
            {"position": [3.0, 3.0], "driver": "navigate", "building_clearance": 1.5},
            {"position": [30.0, 30.0], "driver": "navigate", "building_clearance": 1.5},
        ],
        "uav.2.escorts": "ugv_1",
        "uav.2.position": [30.0, 31.0],
        "uav.0.min_altitude": 8.0,
    }
    assert "uav_1 [14, 16] m and uav_2 [15, 20] m" in refused(
        **others, **{"uav.2.min_altitude": 15.0}
    )
    flight = fly(town(20.0, law__name="certified", **others), 3)[0]
    assert assert_guaranteed(flight).team_certified_share > 0.9
    assert status_of(flight).separation_violations == 0


# Leash


def test_the_leash_uses_the_sight_at_the_lowest_altitude() -> None:
    scenario = town(10.0)
    uav = scenario.uav[0]
    brief = uav_briefing(scenario, uav.name, 0)
    c, h, h_m, z = 1.5, ROOF, 0.3, ROOF + LOW["vertical_clearance"]
    seen = min(4.75, (z - h_m) * math.tan(scenario.camera.half_angle), c * (z - h_m) / (h - h_m))
    assert lowest_sight(scenario, uav) == pytest.approx(seen)
    error = brief.safety.max_measurement_error
    assert error is not None
    assert brief.team is not None
    time = (seen - error) / 0.2 - 2.0 - 2.5 * 0.6 / 0.3 - 2.0 * 0.05
    assert brief.team.scout_range == pytest.approx(0.6 * time)


@pytest.mark.parametrize(
    ("changes", "said", "cure"),
    [
        (
            {"uav.0.vertical_clearance": 2.0},
            "uav.0.min_altitude = 2.0: from the lowest altitude uav_0 sees the UGV within 2.61 m only",
            "uav.0.min_altitude",
        ),
        (
            {"uav.2.max_altitude": 120.0},
            "uav.2.max_altitude = 120.0: the noise of uav_2's detections grows with altitude",
            "uav.2.max_altitude",
        ),
        (
            {"ugv.0.building_clearance": 0.0},
            "ugv.0.building_clearance = 0.0: buildings may hide",
            "",
        ),
        ({"team.scout_range": 9.0}, "team.scout_range = 9.0: beyond the leash", "team.scout_range"),
    ],
)
def test_a_leash_that_is_too_long_names_what_would_do(
    changes: dict[str, Any], said: str, cure: str
) -> None:
    line = refused(**changes)
    assert said in line
    if cure:
        allowed = float(line.rpartition(" m")[0].rpartition(" ")[2])
        town(10.0, **changes | {cure: allowed})


def test_a_batch_flies_a_team_in_a_town_as_a_run_does() -> None:
    """Its scouts obey the vertical rule too: with a policy that dives, all positions and altitudes are the run's."""
    scenario = town(10.0, bands=SCOUTING_LOW, **DIVING, **{"links.team.loss": 0.3})
    flight, _ = fly(scenario, 3)
    uavs = [uav.name for uav in scenario.uav]
    worlds = Worlds(scenario, 1, uavs, end_on_sight_lost=False)
    worlds.reset(3, None)
    for _ in range(scenario.ticks):
        rows = {uav: worlds.observe(uav) for uav in uavs}
        worlds.step({uav: dive(rows[uav]) for uav in uavs})
    state = worlds.loop.state.batch.vehicles[0]
    np.testing.assert_array_equal(state["position"], flight.world.position)
    np.testing.assert_array_equal(state["vertical"]["altitude"], flight.world.vertical["altitude"])
    assert flight.answers.roles()["uav_2"] is Role.SCOUT
