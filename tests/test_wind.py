"""Wind, tracking and position errors: the true state differs from the reference state by at most w."""

import csv
import math

import msgspec
import numpy as np
import pytest

from agents.safety.handover import check_assumptions
from agents.safety.safety_filter import SafetyFilter
from bus.errors import ScenarioError
from bus.messages.ground import Hazard
from bus.messages.vehicle import UavObservation
from flights import DECLARED_BOUNDS, briefing_of, certified, uav_sees
from outrider.running.assumptions import shortfalls
from outrider.running.flying import fly
from sim.compiling.records import record_type, records
from sim.engine.batch import Batch
from sim.models.inner_loop import (
    Disturbance,
    InnerLoop,
    needed_reserve,
    step_error,
    tracking_error,
)
from sim.scenario.checks import check_scenario
from sim.scenario.types import Certificate, LinkTable, Wind
from sim.scenario.vehicle_types import Uav
from sim.world import World
from worlds import LOSSY, SCENARIOS, small, step

WINDY = SCENARIOS["wind"]
DT = 0.05
LOOPS = [(1.0, 2.0), (1.0, 0.4), (4.0, 3.0), (0.2, 1.5)]
"""Gains without oscillation, with much, with some, and slow: k_p [1/s²], k_d [1/s]."""


def loop_of(k_p: float, k_d: float, reserve: float) -> InnerLoop:
    return InnerLoop(position_gain=k_p, velocity_gain=k_d, reserve=reserve)


def errors(loop: InnerLoop, wind: np.ndarray, own: np.ndarray, dt: float) -> np.ndarray:
    """Return the tracking error under winds and position errors at each tick: x, y [m] and the feedback [m/s²]."""
    (row,), found = np.zeros(1, record_type(Disturbance)), []
    (gains,) = records(InnerLoop, [loop])
    for row["wind"], row["position_error"] in zip(wind, own, strict=True):
        before = row["error_rate"].copy()
        step_error(gains, row, dt)
        asked = (row["error_rate"] - before) / dt - row["wind"]
        found.append((*row["error"], math.hypot(*asked)))
    return np.array(found)


# -- the bound


@pytest.mark.parametrize("gains", LOOPS)
@pytest.mark.parametrize(("wind", "own", "dt"), [(0.2, 0.0, DT), (0.1, 0.3, DT), (0.1, 0.3, 0.3)])
def test_the_worst_wind_comes_to_the_bound_and_no_other_beyond(gains, wind, own, dt) -> None:
    loop = loop_of(*gains, math.inf)
    bound, ticks = tracking_error(loop, wind, own, dt), 1500
    silent = np.zeros((ticks, 2))
    kick = silent.copy()
    kick[0, 0] = 1.0
    answer = errors(loop, kick, silent, dt)[:, 0]
    push = np.where(answer[::-1] >= 0.0, 1.0, -1.0)  # the last one is answered first
    direction = np.array([0.6, 0.8])
    worst = errors(loop, wind * push[:, None] * direction, -own * push[:, None] * direction, dt)
    reached = math.hypot(*worst[-1, :2])
    most = needed_reserve(loop, wind, own, dt)
    between = 0.125 * (most + wind) * dt * dt
    assert bound - between - 1e-4 < reached <= bound - between + 1e-9
    assert worst[:, 2].max() <= most + 1e-9
    rng = np.random.default_rng(1)
    for period in (1, 7, 30):
        angle = np.repeat(rng.uniform(0.0, 2.0 * math.pi, ticks), period)[:ticks]
        blown = np.column_stack([np.cos(angle), np.sin(angle)])
        found = errors(loop, wind * blown, -own * blown, dt)
        assert np.hypot(found[:, 0], found[:, 1]).max() <= bound
        assert found[:, 2].max() <= most + 1e-9


def test_bound_without_oscillation_is_wind_over_gain_plus_error() -> None:
    loop = loop_of(1.0, 2.0, 5.0)
    assert tracking_error(loop, 0.2, 0.3, 0.001) == pytest.approx(0.5, abs=1e-5)
    assert tracking_error(loop, 0.0, 0.0, DT) == 0.0


def test_the_reserve_that_is_needed_is_enough_and_less_is_not() -> None:
    needed = needed_reserve(loop_of(1.0, 2.0, math.inf), 0.2, 0.1, DT)
    assert math.isfinite(tracking_error(loop_of(1.0, 2.0, needed), 0.2, 0.1, DT))
    assert tracking_error(loop_of(1.0, 2.0, 0.999 * needed), 0.2, 0.1, DT) == math.inf


@pytest.mark.parametrize("gains", [(1.0, 41.0), (90.0, 2.0), (0.5, 0.0)])
def test_an_unstable_loop_has_no_bound(gains) -> None:
    assert tracking_error(loop_of(*gains, 1e6), 0.1, 0.0, DT) == math.inf


# -- the certificate


def test_tracking_error_reduces_the_radius_and_adds_to_the_error() -> None:
    numbers = DECLARED_BOUNDS | {"age": 5.0}
    with_w = certified(**numbers, eps=0.3, tracking=0.4)
    without = certified(**numbers | {"r_v": 4.35}, eps=0.7)
    assert with_w.handover_radius == pytest.approx(without.handover_radius, abs=1e-9)
    assert with_w.handover_bound == pytest.approx(without.handover_bound, abs=1e-9)
    for tracking in (math.inf, 2.5):
        wrong = certified(**numbers, eps=0.3, tracking=tracking)
        (fault,) = check_assumptions(wrong)
        assert f"max_tracking_error = {tracking} m" in fault


def test_certified_distance_counts_the_tracking_error_twice() -> None:
    briefed = briefing_of(WINDY)
    keeper, seen = SafetyFilter(briefed), uav_sees(0, (0.0, (1.5, -2.0)), position=(8.0, 7.0))
    keeper.see(seen)
    found = keeper.filter(seen, (0.0, 0.0)).certified_distance
    assert briefed.safety.max_tracking_error > 0.0
    bound = briefed.safety.max_measurement_error + 2.0 * briefed.safety.max_tracking_error
    assert found == pytest.approx(2.5 + bound, rel=1e-12)


# -- the world


def test_without_wind_the_true_state_is_the_reference_state() -> None:
    batch = Batch(SCENARIOS["certified"], 2)
    batch.begin([1, 2])
    for _ in range(50):
        step(batch, np.array([0.2, -0.1]))
    vehicles = batch.state.vehicles
    assert np.array_equal(vehicles["position"], vehicles["reference_position"])
    assert np.array_equal(vehicles["velocity"], vehicles["reference_velocity"])
    assert (vehicles["velocity"] != 0.0).any()


def test_wind_disturbs_the_uavs_true_state_alone(tmp_path) -> None:
    flight, summary = fly(WINDY, 1)
    off = flight.recorder.states[:, :, :4] - flight.recorder.reference
    errors_of_uav = np.hypot(off[:, 0, 0], off[:, 0, 1])
    declared = briefing_of(WINDY).safety.max_tracking_error
    assert 0.05 < errors_of_uav.max() == summary.largest_tracking_error
    assert summary.largest_tracking_error <= summary.max_tracking_error == declared
    assert not off[:, 1].any()
    assert summary.certified_share == 1.0
    assert summary.certified_while_lost == summary.certificate_broken == 0
    status, so_far = flight.answers.assurance.status(), errors_of_uav[:-1].max()
    assert (status.max_tracking_error, status.largest_tracking_error) == (declared, so_far)
    flight.recorder.write(tmp_path / "trajectory.csv")
    with (tmp_path / "trajectory.csv").open(newline="", encoding="utf-8") as file:
        header, *rows = csv.reader(file)
    assert header[-2:] == ["uav_0.reference_x [m]", "uav_0.reference_y [m]"]
    written = [[float(cell) for cell in row[-2:]] for row in rows]
    assert written == flight.recorder.reference[:, 0, :2].tolist()


def test_wind_changes_no_other_draw_or_own_state() -> None:
    """Under the same commands, reference states and reported tiles are those of still air."""
    hazard = Hazard(kind="block", center=WINDY.ugv[0].position, radius=0.5)
    windy = msgspec.structs.replace(WINDY, hazard=(hazard,))
    uav = msgspec.structs.replace(WINDY.uav[0], position_error=0.0)
    still = msgspec.structs.replace(windy, wind=Wind(), uav=(uav,))
    one, other = World(windy, 3), World(still, 3)
    reported = 0
    for _ in range(100):
        for world in (one, other):
            world.step(np.array([[0.2, 0.1], [0.05, 0.0]]))
        assert one.seen_ground(0) == other.seen_ground(0)
        reported += len(one.seen_ground(0))
    assert reported > 100
    assert np.array_equal(one.reference_position, other.reference_position)
    assert np.array_equal(one.reference_velocity, other.reference_velocity)
    assert np.array_equal(other.reference_position, other.position)
    assert not np.array_equal(one.position, other.position)


def test_no_vehicle_receives_the_wind() -> None:
    declared = Certificate(max_tracking_error=0.5)
    stormy = small("certified", wind=Wind(mean=(0.1, 0.0), gust=0.05), certificate=declared)
    assert briefing_of(stormy) == briefing_of(small("certified", certificate=declared))


def test_wind_keeps_its_limit_mean_and_spread() -> None:
    scenario = small("certified", wind=Wind(mean=(0.1, 0.0), gust=0.1, gust_time=0.2, limit=0.4))
    batch, found = Batch(scenario, 40), []
    batch.begin(range(40))
    for _ in range(60):
        step(batch, np.zeros((40, 2, 2)))
        row = batch.state.vehicles["disturbance"][:, 0]
        found.append(row["wind"].copy())
    wind = np.array(found)
    assert np.hypot(wind[..., 0], wind[..., 1]).max() <= 0.4 * (1.0 + 1e-12)
    assert wind.mean(axis=(0, 1)) == pytest.approx([0.1, 0.0], abs=0.02)
    assert wind.std(axis=(0, 1)) == pytest.approx([0.1, 0.1], rel=0.1)
    kept = (wind[1:, :, 1] * wind[:-1, :, 1]).mean() / wind[..., 1].var()
    assert kept == pytest.approx(math.exp(-DT / 0.2), abs=0.05)


def test_wind_and_lost_commands_leave_every_tick_certified() -> None:
    scenario = msgspec.structs.replace(
        WINDY,
        links=LinkTable(commands=LOSSY),
        certificate=Certificate(max_command_delay=0.4, max_command_interval=2.0),
    )
    _, summary = fly(scenario, 2)
    assert summary.certified_share == 1.0
    assert summary.certified_while_lost == summary.certificate_broken == 0


def test_rejoining_process_receives_its_past_unchanged() -> None:
    seen: list[UavObservation] = []
    scenario = msgspec.structs.replace(WINDY, duration=3.0)
    flight, _ = fly(scenario, 1, on_tick=lambda run: seen.append(run.observations()["uav_0"]))
    past = [(one.position, one.velocity) for one in flight.past("uav_0", 1, 60, ())]
    assert past == [(one.position, one.velocity) for one in seen[:59]]


# -- warnings


def test_wind_beyond_w_warns_and_excuses_the_certificate() -> None:
    scenario = msgspec.structs.replace(WINDY, certificate=Certificate(max_tracking_error=0.001))
    (found,) = [one for one in shortfalls(scenario) if one.assumption == "A6'"]
    assert "certificate.max_tracking_error = 0.001 m" in found.line
    assert not [one for one in shortfalls(WINDY) if one.assumption == "A6'"]
    _, summary = fly(scenario, 1)
    assert summary.largest_tracking_error > summary.max_tracking_error == 0.001
    assert summary.certificate_broken == 0


def test_the_reserve_that_a_refusal_names_is_enough() -> None:
    with pytest.raises(ScenarioError) as refused:
        check_scenario(small("certified", wind=Wind(mean=(1.0, 0.0))))
    least = float(str(refused.value).split("allowed: ")[1].split()[0])
    uav = Uav(position=(8.0, 7.0), tracking=InnerLoop(reserve=least))
    assert check_scenario(small("certified", wind=Wind(mean=(1.0, 0.0)), uav=uav))
