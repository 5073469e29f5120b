"""The pilots: the UGV's motion along its goals, and the UAV's commands from its own observations."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.drivers.compiled import CompiledDriver
from agents.drivers.dispatch import CODES
from agents.drivers.steering import Steering
from agents.uav import UavPilot
from agents.ugv import UgvPilot
from bus.errors import ScenarioError
from bus.messages.scenario import Limits, ScriptStep, Sensor
from bus.messages.vehicle import UavCommand, UgvObservation
from flights import (
    DT,
    HERE,
    R_V,
    U_A,
    U_G,
    V_G,
    briefing_of,
    escort,
    tracks,
    uav_sees,
    ugv_briefing,
)
from outrider.running.flying import InProcess, fly, make_pilots
from properties import PROPERTY
from sim.models.vehicles import goal_reached, norm, step_vehicle
from sim.scenario.types import Detections
from sim.scenario.vehicle_types import Uav, Ugv
from sim.server.flight import Flight

Point = tuple[float, float]
points = st.tuples(st.floats(0.0, 20.0), st.floats(0.0, 20.0))
speeds = st.sampled_from((0.05, V_G, 1.0, 5.0))
accelerations = st.sampled_from((0.05, U_G, 1.0, 10.0, math.inf))
ticks = st.sampled_from((0.02, DT, 0.2))


def _driver(goals, *, v_max=V_G, u_max=U_G, dt=DT, tolerance=0.05):
    limits = Limits(max_speed=v_max, max_acceleration=None if math.isinf(u_max) else u_max)
    briefed = ugv_briefing(dt=dt, limits=limits, goals=goals, goal_tolerance=tolerance)
    return CompiledDriver(briefed, "waypoints")


def _drive(driver, start, count, *, v_max=V_G, u_max=U_G, dt=DT):
    """Return p, v and the command before its bound at each tick, from rest."""
    state, rows = (*start, 0.0, 0.0), []
    for tick in range(count):
        own = {"position": tuple(state[:2]), "velocity": tuple(state[2:])}
        u = driver.drive(UgvObservation(tick=tick, time=tick * dt, **own))
        rows.append((*state, *u))
        *state, _, _ = step_vehicle(*state, *u, v_max, u_max, dt)
    return np.array(rows)


def _along(rows: np.ndarray, start: Point, goal: Point) -> tuple[np.ndarray, np.ndarray]:
    """Return the remaining distance along the line from start to goal, and the distance from that line [m]."""
    (a, b), g = np.subtract(goal, start) / max(math.dist(start, goal), 1e-300), rows[:, :2] - goal
    return -(g @ (a, b)), np.abs(g @ (-b, a))


@given(points, points, speeds, accelerations, ticks)
@settings(PROPERTY, max_examples=60)
def test_the_ugv_drives_straight_to_its_goal_and_stands_there(start, goal, v_max, u_max, dt):
    needed = (math.dist(start, goal) / v_max + 2.0 * v_max / u_max) / dt
    count = min(math.ceil(needed) + 400, 20000)
    bounds = {"v_max": v_max, "u_max": u_max, "dt": dt}
    rows = _drive(_driver((goal,), **bounds), start, count, **bounds)
    along, aside = _along(rows, start, goal)
    assert along.min() > -1e-9  # it never overshoots
    assert aside.max() < 1e-9
    if count < 20000:
        assert rows[-1, :2] == pytest.approx(goal, abs=1e-3)
        assert np.abs(rows[-1, 2:]).max() < 1e-2 * v_max
    assert np.hypot(rows[:, 4], rows[:, 5]).max() <= u_max * (1.0 + 1e-12)


@given(st.lists(points, min_size=2, max_size=4), st.sampled_from((0.05, 0.5)))
@settings(PROPERTY, max_examples=20)
def test_a_goal_stays_until_it_is_nearer_than_the_tolerance(goals, tolerance):
    bounds = {"v_max": 1.0, "u_max": 0.5}
    driver = _driver(tuple(goals), **bounds, tolerance=tolerance)
    rows = _drive(driver, (1.0, 1.0), 1500, **bounds)
    limits = Limits(max_speed=1.0, max_acceleration=0.5)
    at, steering = 0, Steering(ugv_briefing(dt=DT, limits=limits))
    for p_x, p_y, v_x, v_y, u_x, u_y in rows.tolist():
        while at < len(goals) - 1 and goal_reached(p_x, p_y, *goals[at], tolerance):
            at += 1
        here = UgvObservation(tick=0, time=0.0, position=(p_x, p_y), velocity=(v_x, v_y))
        assert (u_x, u_y) == steering.to_goal(here, goals[at])


@given(st.lists(points, min_size=2, max_size=3))
@settings(PROPERTY, max_examples=20)
def test_the_papers_ugv_keeps_to_the_lines_between_its_goals(goals: list[Point]) -> None:
    rows = _drive(_driver(tuple(goals)), (10.0, 10.0), 4000)
    legs = pairwise([(10.0, 10.0), *goals])
    lines = [_along(rows, *ends)[1] for ends in legs if math.dist(*ends) > 0.1]
    corners = [np.hypot(*(rows[:, :2] - goal).T) for goal in goals]
    assert np.min([*lines, *corners], axis=0).max() < 0.1


def test_a_ugv_without_goals_brakes_and_stays() -> None:
    rows = _drive(_driver(()), HERE, 5)
    assert (rows[:, 2:] == 0.0).all()
    moving = UgvObservation(tick=0, time=0.0, position=HERE, velocity=(0.2, 0.0))
    command = _driver(()).drive(moving)
    assert command == pytest.approx((-U_G, 0.0), abs=1e-15)


def test_ugv_drives_at_its_bounds_and_stops_at_its_goal() -> None:
    ugv = Ugv(position=HERE, goals=((22.0, 20.0), (20.0, 22.0), (24.0, 24.0)))
    _, track = tracks(fly(escort("tracking", ugv=ugv, duration=80.0), 0)[0])
    assert np.hypot(track[:-1, 4], track[:-1, 5]).max() == pytest.approx(U_G, rel=1e-12)
    fastest = np.hypot(track[:, 2], track[:, 3]).max()
    assert V_G * (1.0 - 1e-12) <= fastest <= V_G * (1.0 + 1e-15)
    assert track[-1, :2] == pytest.approx((24.0, 24.0), abs=1e-6)


def test_every_compiled_driver_drives_differently() -> None:
    """A row of the registry without its branch would drive like another one."""
    driven: dict[bytes, list[str]] = {}
    for name in CODES:
        script = (ScriptStep(time=0.0, velocity=(0.05, 0.1)),)
        ugv = Ugv(position=HERE, goals=((30.0, 22.0),), driver=name, script=script)
        _, track = tracks(fly(escort(ugv=ugv, uav=Uav(position=(21.0, 20.0)), duration=8.0), 3)[0])
        assert norm(*track[-1, 2:4]) > 0.0
        driven.setdefault(track[:, :2].tobytes(), []).append(name)
    alike = [set(names) for names in driven.values() if len(names) > 1]
    assert alike == [{"navigate", "waypoints"}]  # on free ground


def test_an_unknown_driver_law_or_sensor_is_named() -> None:
    with pytest.raises(ScenarioError, match=r"driver = 'nobody': unknown; allowed: .*waypoints"):
        UgvPilot(ugv_briefing(driver="nobody"))
    with pytest.raises(ScenarioError, match=r"law.name = 'best': unknown; allowed: .*logarithmic"):
        UavPilot(briefing_of(escort("best")))
    unknown = briefing_of(escort(sensor=Sensor(model="eye")))
    with pytest.raises(ScenarioError, match=r"sensor.model = 'eye': unknown; allowed: hill, pl"):
        UavPilot(unknown)


def test_before_the_first_detection_the_uav_brakes() -> None:
    command = UavPilot(briefing_of(escort())).act(uav_sees(0, velocity=(0.3, 0.4)))
    assert command.acceleration == pytest.approx((-0.6 * U_A, -0.8 * U_A), rel=1e-12)
    assert command.report is None


def test_the_uavs_command_is_within_its_bound() -> None:
    for law in ("tracking", "switching", "logarithmic", "circle"):
        command = UavPilot(briefing_of(escort(law))).act(uav_sees(0, (0.0, (R_V, 1.0))))
        assert norm(*command.acceleration) <= U_A * (1.0 + 1e-15)


def test_uav_reports_its_estimate_of_the_ugv() -> None:
    command = UavPilot(briefing_of(escort())).act(uav_sees(0, (0.0, (1.5, -2.0))))
    assert command.report is not None
    assert command.report.estimate == (18.5, 22.0)
    assert command.radio[0].relative_position == (1.5, -2.0)


def test_the_same_observations_get_the_same_commands() -> None:
    def answers(seed: int) -> list[UavCommand]:
        pilot = UavPilot(briefing_of(escort("logarithmic"), seed))
        return [pilot.act(uav_sees(tick, (tick * DT, (0.0, 0.0)))) for tick in range(50)]

    assert answers(3) == answers(3)
    assert answers(3) != answers(4)


@pytest.mark.parametrize("sensor", ["hill", "plateau"])
def test_the_uavs_own_map_is_the_worlds(sensor: str) -> None:
    ugv = Ugv(position=HERE, goals=((25.0, 23.0),))
    noisy = Detections(noise=0.1, dropout=0.2)
    changes = {"sensor": Sensor(model=sensor), "detections": noisy, "duration": 30.0}
    scenario = escort("logarithmic", ugv=ugv, **changes)
    flight, pilots = Flight(scenario, 1), make_pilots(scenario, 1)
    flight.fly(InProcess(pilots))
    pilot = pilots["uav_0"]
    assert isinstance(pilot, UavPilot)
    pilot.act(flight.observations()["uav_0"])  # it has not sensed from its last position yet
    assert pilot.coverage.tobytes() == flight.world.coverage.tobytes()
