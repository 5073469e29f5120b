"""The law `lookahead`: its expectation matches the field's own kernels, and it uses no forbidden information."""

import math
from typing import Any

import msgspec
import numpy as np
import pytest

from agents.laws.candidates import worth
from agents.laws.hidden_ground import empty_views
from agents.laws.horizon import Ahead, look_ahead
from agents.uav import UavPilot
from agents.uav_parameters import Target
from bus.messages.scenario import Law
from bus.messages.vehicle import UavObservation
from flights import DESIRED, briefing_of, escort, flown_law, uav_sees
from outrider.running.flying import fly
from sim.models.buildings import building_table
from sim.models.field import accumulate, coverage_error, empty_coverage
from sim.models.shadows import Occlusion, all_known
from sim.models.vehicles import State, step_vehicle
from sim.scenario.loading import load_scenario
from sim.scenario.types import Area
from sim.server.flight import Flight
from worlds import SCENARIOS

HERE = State(17.0, 16.0, 0.2, -0.3)
UGV = Target(True, 15.0, 15.0, 0.12, 0.08, 0.0, 0.0)  # and nothing is uncertain
FOREVER = 1e7
TICKS = 1000


def _uav(cell: float, max_distance: float = 100.0) -> Any:
    area = Area(width=36.0, height=36.0, cell=cell)
    scenario = escort(Law(name="lookahead", parameters={"horizon": 6.0}), area=area)
    return flown_law(scenario, max_distance=max_distance).uav


def _ahead(uav: Any, coverage: Any, tick: int, target: Target, persistence: float) -> Ahead:
    """Return a horizon of 6 s without a margin at the border: nothing is penalized."""
    found = look_ahead(uav, 6.0, uav["max_speed"], coverage, tick, target, persistence)
    return found._replace(margin=-100.0)


def _flown(
    uav: Any, ahead: Ahead, velocities: np.ndarray, samples: int, blocks: Occlusion | None = None
) -> float:
    """Return the result of `worth` by the step and kernels of the world, with several sensing times in each step."""
    seen = empty_coverage(uav["width"], uav["height"], uav["cell"])
    seen[:, 12:] = 0.7
    sensor = uav["sensor"], uav["cell"]
    unseen, saved, state = seen.copy(), 0.0, tuple(HERE)
    parts, tick = TICKS, ahead.step / TICKS
    tail = round(5.0 / ahead.step)
    for k in range(len(ahead.legs) + tail):
        if k < len(ahead.legs):
            w, began = velocities[ahead.legs[k]], state[:2]
            for part in range(parts):
                u = (w - np.array(state[2:])) / tick
                state = step_vehicle(*state, *u.tolist(), math.inf, uav["max_acceleration"], tick)[
                    :4
                ]
                if samples > 1 and part % (parts // samples) == parts // samples // 2:
                    position, time = state[:2], ahead.step / samples
                    accumulate(seen, *position, *sensor, time, blocks)
            if samples == 1:
                x, y = (0.5 * (a + b) for a, b in zip(began, state[:2], strict=True))
                accumulate(seen, x, y, *sensor, ahead.step, blocks)
        after = (k + 1) * ahead.step
        position = (UGV.p_x + after * UGV.v_x, UGV.p_y + after * UGV.v_y)
        errors = (
            coverage_error(
                one, *position, uav["density_radius"], uav["desired_coverage"], uav["cell"]
            )
            for one in (unseen, seen)
        )
        saved -= ahead.step * math.exp(-0.06 * after) * float(np.diff(list(errors))[0])
    return saved


@pytest.mark.parametrize(("cell", "samples", "within"), [(1.5, 1, 1e-3), (0.25, 20, 0.05)])
def test_value_of_a_candidate_matches_the_kernels_of_the_world(cell, samples, within) -> None:
    """Use the coarse cells themselves, and cells of the world with a sensing step at every tick."""
    c, rng = _uav(cell), np.random.default_rng(3)
    coverage = empty_coverage(36.0, 36.0, cell)
    coverage[:, 12:] = 0.7
    ahead = _ahead(c, coverage, 7, UGV, FOREVER)
    for _ in range(2):
        angle, speed = rng.uniform(0.0, 2.0 * math.pi, 9), rng.uniform(0.3, 0.6, 9)
        velocities = np.stack((speed * np.cos(angle), speed * np.sin(angle)), axis=-1)
        value = worth(c, ahead, HERE, velocities, np.empty_like(ahead.lack), np.empty(8))
        assert value > 100.0
        assert value == pytest.approx(_flown(c, ahead, velocities, samples), rel=within)


def test_candidate_is_worth_the_ground_that_it_will_see() -> None:
    """The law takes the camera to be over the center of its coarse cell, so the value is not exact."""
    c, rng = _uav(0.75), np.random.default_rng(3)
    coverage = empty_coverage(36.0, 36.0, 0.75)
    coverage[:, 12:] = 0.7
    wall = [(15.0, 16.0), (19.0, 16.5), (19.0, 18.0), (15.0, 18.0)]
    blocks = all_known(*building_table([(wall, 4.0)]), 6.0)
    ahead = _ahead(c, coverage, 7, UGV, FOREVER)
    for _ in range(5):
        angle, speed = rng.uniform(0.0, 2.0 * math.pi, 9), rng.uniform(0.3, 0.6, 9)
        velocities = np.stack((speed * np.cos(angle), speed * np.sin(angle)), axis=-1)
        work = np.empty_like(ahead.lack), np.empty(8)
        value = worth(c, ahead, HERE, velocities, *work, empty_views(blocks, ahead))
        assert value == pytest.approx(_flown(c, ahead, velocities, 20, blocks), rel=0.05)
        assert value < 0.8 * worth(c, ahead, HERE, velocities, *work)


def test_lookahead_penalizes_filtered_and_outside_candidates() -> None:
    still = np.zeros((9, 2))
    coverage = np.full_like(empty_coverage(36.0, 36.0, 0.25), DESIRED)
    ahead = _ahead(_uav(0.25), coverage, 0, UGV._replace(v_x=0.0, v_y=0.0), FOREVER)

    def costs(own: State, *, room: float = 100.0, margin: float = -100.0) -> float:
        lack, adapted = np.empty_like(ahead.lack), ahead._replace(margin=margin)
        return -worth(_uav(0.25, room), adapted, own, still, lack, np.empty(8))

    near, far = State(17.0, 15.0, 0.0, 0.0), State(19.5, 15.0, 0.0, 0.0)
    assert costs(near, room=4.4) == 0.0
    assert costs(far, room=4.4) > 1.0
    assert costs(near, margin=15.0) == 0.0
    assert costs(near, margin=18.0) > 10.0


def test_reversing_ugv_is_expected_nearer() -> None:
    c, coverage = _uav(1.5), empty_coverage(36.0, 36.0, 1.5)
    ends = [
        _ahead(c, coverage, 0, UGV._replace(v_variance=variance), persistence).track[-1, 0]
        for persistence, variance in ((FOREVER, 0.0), (5.0, 0.0), (5.0, 0.01))
    ]
    assert ends[0] == pytest.approx(UGV.p_x + 6.0 * UGV.v_x)
    assert UGV.p_x < ends[2] < ends[1] < ends[0]


def test_the_true_velocity_of_the_ugv_changes_no_command() -> None:
    """Detections and the map stay as they are: only the true velocity is changed, at a decision."""
    scenario = msgspec.structs.replace(SCENARIOS["lookahead"], duration=6.05)
    commands = []
    for factor in (1.0, -3.0):

        def change(flight: Flight, factor: float = factor) -> None:
            if flight.world.tick == 120:
                flight.world.velocity[1] *= factor

        flight, _ = fly(scenario, 5, on_tick=change)
        assert np.hypot(*flight.recorder.states[120, 1, 2:4]) > 0.01
        commands.append(flight.recorder.states[-2, 0, 4:6].copy())
    assert np.array_equal(commands[0], commands[1])
    assert np.abs(commands[0]).sum() > 0.01


def test_lookahead_horizon_beats_the_logarithmic_law() -> None:
    scenario = load_scenario("escort", overrides=["duration=80.0", "area.cell=0.5"])
    means = {}
    for name, law in {
        "logarithmic": Law(name="logarithmic"),
        "lookahead": Law(name="lookahead"),
        "one step": Law(name="lookahead", parameters={"horizon": 0.5}),
        "at random": Law(name="lookahead", parameters={"candidates": 1}),
    }.items():
        _, summary = fly(msgspec.structs.replace(scenario, law=law), 3)
        assert summary.visibility_violations == 0, name
        assert summary.certified_while_lost == 0, name
        means[name] = summary.mean_error
    assert means["lookahead"] < 0.8 * means["logarithmic"], means
    assert means["lookahead"] < 0.9 * means["one step"]
    assert means["lookahead"] < 0.9 * means["at random"]


def _observations(law: Law | None = None) -> list[UavObservation]:
    rng, start = np.random.default_rng(8), np.array([8.0, 7.0])
    found = []
    for tick in range(60):
        detection = tick * 0.05, tuple((rng.normal(0.0, 0.1, 2) + 0.01 * tick).tolist())
        states = {"position": tuple((start + 0.02 * tick).tolist()), "velocity": (0.4, 0.4)}
        found.append(uav_sees(tick, detection, **states, law=law if tick == 25 else None))
    return found


def test_rejoining_process_continues_the_same_trajectory() -> None:
    briefing = briefing_of(SCENARIOS["lookahead"])
    seen = _observations()
    one, other = UavPilot(briefing), UavPilot(briefing)
    commands = [one.act(observation) for observation in seen]
    for observation in seen[:33]:
        other.act(observation)  # its past
    assert [other.act(observation) for observation in seen[33:]] == commands[33:]


def test_it_takes_over_in_flight() -> None:
    pilot = UavPilot(briefing_of(SCENARIOS["certified"]))
    commands = [pilot.act(one).acceleration for one in _observations(Law(name="lookahead"))]
    plain = UavPilot(briefing_of(SCENARIOS["certified"]))
    before = [plain.act(one).acceleration for one in _observations()]
    assert commands[:25] == before[:25]
    assert commands[25] != before[25]
