"""The safety filter: its parts, and its reaction to lost detections and commands."""

from typing import Any

import msgspec
import numpy as np
import pytest

from agents.safety.decision import decide
from agents.safety.levels import bounds_of
from agents.safety.memory import (
    FilterMemory,
    add_measurement,
    add_position,
    filter_memory,
    reset_memory,
)
from agents.safety.safety_filter import SafetyFilter, decision_of
from bus.messages.decision import NotCertified, Source
from bus.messages.links import LinkSettings
from bus.messages.scenario import Area, SafetyParameters
from bus.messages.vehicle import MOST_CARRIED, UavBriefing
from flights import DECLARED_BOUNDS, DT, U_A, briefing_of, certified, escort, uav_sees
from sim.engine.batch import arrays_of
from sim.models.vehicles import State
from sim.scenario.types import Certificate, LinkTable
from sim.scenario.vehicle_types import Uav
from sim.world import World


def declared(delay: float = 0.0) -> UavBriefing:
    """Return the briefing of the paper's UAV, with this command delay [s]."""
    return msgspec.structs.replace(
        briefing_of(escort("certified")),
        safety=SafetyParameters(
            max_measurement_error=0.3, max_measurement_age=1.0, max_command_delay=delay
        ),
    )


def observed(tick, *found):
    """Return an observation from (20 + tick / 100, 20) at rest, with detections as time [s] and p_a - p_g [m]."""
    detections = ((t, (x, y)) for t, x, y in found)
    return uav_sees(tick, *detections, position=(20.0 + 0.01 * tick, 20.0))


def at(x: float, y: float) -> State:
    """Return a UAV at rest."""
    return State(x, y, 0.0, 0.0)


def kept_detections(memory: FilterMemory) -> list[tuple[float, float, int]]:
    """Return the detections that a filter has kept: position [m] and tick."""
    return memory.discs[memory.discs["tick"] >= 0][["x", "y", "tick"]].tolist()


@pytest.mark.parametrize("delay", [0.0, 3 * DT])
def test_reset_memory_equals_a_new_one(delay: float) -> None:
    bounds = bounds_of(declared(delay))
    fresh, used = filter_memory(bounds.delay_ticks, 8), filter_memory(bounds.delay_ticks, 8)
    decide(bounds, used, 0, State(20.0, 20.0, 0.1, 0.0), 0.1, 0.0)
    decision = decision_of(used.decision[0])
    assert (decision.source, decision.reason) == (Source.BEST_EFFORT, NotCertified.NO_MEASUREMENT)
    assert decision.certified_distance is None
    parts = arrays_of(used)
    for part in parts:
        part[:] = np.array(-5).astype(part.dtype)
    reset_memory(used)
    assert [part.tobytes() for part in parts] == [part.tobytes() for part in arrays_of(fresh)]
    assert [part.dtype for part in parts] == [part.dtype for part in arrays_of(fresh)]


@pytest.mark.parametrize("taken", [-1, -8, 0, 3, 4, 10, 12, 19])
def test_detection_of_an_unrecorded_tick_is_ignored(taken: int) -> None:
    """Before the start, missing, later than now, or so long ago that a newer tick has replaced it in the track of 8."""
    bounds = bounds_of(declared())
    state = filter_memory(bounds.delay_ticks, 8)
    for tick in (0, 1, 2, 3, 5, 6, 7, 8, 11):  # 8 and 11 replace 0 and 3
        add_position(state, tick, 20.0 + tick, 20.0)
    before = [part.tobytes() for part in arrays_of(state)]
    add_measurement(bounds, state, taken, (0.5, 0.0), 11, at(31.0, 20.0))
    assert [part.tobytes() for part in arrays_of(state)] == before
    add_measurement(bounds, state, 7, (0.5, 0.0), 11, at(31.0, 20.0))
    assert kept_detections(state) == [(26.5, 20.0, 7)]


def test_detections_of_missed_or_invalid_times_are_not_used() -> None:
    """While the process was absent, it recorded no own positions."""
    watch = SafetyFilter(declared())
    for tick in (0, 1, 2, 5, 6):
        watch.see(observed(tick))
    invalid = (3 * DT, 4 * DT, 5.4 * DT, 8 * DT, 1e12)
    watch.see(observed(7, *((time, 0.0, 1.0) for time in invalid)))
    assert kept_detections(watch.memory) == []
    watch.see(observed(8, (sum([DT] * 6), 0.0, 1.0)))  # 0.3 s, 5.999999999999999 ticks
    assert kept_detections(watch.memory) == [(20.06, 19.0, 6)]


@pytest.mark.parametrize(
    ("walls", "place", "relative", "kept"),
    [(True, (0.2, 39.9), (0.3, -0.3), (0.0, 40.0)), (False, (-7.0, 3.0), (1.0, 5.0), (-8.0, -2.0))],
)
def test_detected_position_is_clipped_into_the_area(walls, place, relative, kept) -> None:
    bounds = bounds_of(declared()) if walls else certified(**DECLARED_BOUNDS, eps=0.3)
    state = filter_memory(bounds.delay_ticks, 8)
    add_position(state, 0, *place)
    add_measurement(bounds, state, 0, relative, 0, at(*place))
    assert kept_detections(state) == [(*kept, 0)]


def test_contradiction_is_remembered_until_the_filter_restarts() -> None:
    bounds = bounds_of(declared())
    state = filter_memory(bounds.delay_ticks, 8)
    for tick in range(2):
        add_position(state, tick, 20.0, 20.0)
        add_measurement(bounds, state, tick, (2.0 * tick, 0.0), tick, at(20.0, 20.0))
        assert state.flags["contradicted"] == tick
    add_measurement(bounds, state, 1, (2.0, 0.0), 1, at(20.0, 20.0))
    assert state.flags["contradicted"] == 1
    reset_memory(state)
    assert state.flags["contradicted"] == 0


class Vehicle:
    """A UAV and its UGV in the simulator, and the safety filter that flies the UAV.

    Args:
        delay: Declared delay of its commands [s]; they arrive at once and wait.
        interval: Longest time between two trajectories [s]; a tick by default.
        bare: True if its receiver supports accelerations only.
    """

    def __init__(self, delay=0.0, interval=None, *, bare=False, **fields: Any) -> None:
        declared = Certificate(
            max_command_delay=delay, max_command_interval=interval, max_measurement_error=0.0
        )
        scenario = escort("certified", certificate=declared, **fields)
        self.world, self._bare = World(scenario, 1), bare
        self.filter = SafetyFilter(briefing_of(scenario))

    def fly(self, wanted: tuple[float, float], *, lose: bool = False) -> NotCertified | None:
        """Fly one tick and return why it is not certified; its command may be lost."""
        world, tick = self.world, self.world.tick
        seen = uav_sees(
            tick,
            (tick * DT, tuple((world.position[0] - world.position[1]).tolist())),
            position=tuple(world.position[0].tolist()),
            velocity=tuple(world.velocity[0].tolist()),
            committed_trajectory=None if self._bare else world.flown(0),
        )
        self.filter.see(seen)
        decision = self.filter.filter(seen, wanted)
        trajectories = () if self._bare else self.filter.backup_trajectories(tick)
        if not lose:
            world.send(0, tick, decision.acceleration, trajectories)
        world.advance()
        return decision.reason


OUT, BACK = (U_A, 0.0), (-U_A, 0.0)


@pytest.mark.parametrize("delay", [0.0, 0.5])
def test_lost_command_pauses_certificate_until_a_trajectory(delay) -> None:
    uav, d = Vehicle(delay), round(delay / DT)
    for _ in range(20):
        assert uav.fly(OUT) is None
    lost = range(3, 3 + (MOST_CARRIED if d else 1))  # all commands that carry the first of them
    reasons = [uav.fly(BACK if k % 2 else OUT, lose=k in lost) for k in range(3 * d + 10)]
    ends = 3 + d + 1  # the tick after the one in which its trajectory should have started
    assert reasons[:ends] == [None] * ends
    assert reasons[ends : ends + d + 1] == [NotCertified.COMMAND_INTERVAL] * (d + 1)
    assert set(reasons[ends + d + 1 :]) == {None}


def test_command_losses_within_the_declared_interval_keep_it() -> None:
    uav = Vehicle(0.5, interval=1.5)
    assert {uav.fly(OUT, lose=tick % 25 > 20) for tick in range(200)} == {None}


def test_possibly_unsent_commands_are_not_relied_on() -> None:
    uav = Vehicle(0.3)
    for _ in range(10):
        assert uav.fly(OUT) is None
    uav.filter.invalidate_plans()
    reasons = [uav.fly(OUT) for _ in range(9)]
    assert reasons == [NotCertified.UNCHECKED_PLAN] * 7 + [None] * 2


@pytest.mark.parametrize("delay", [0.0, 0.5])
def test_moving_uav_is_certified_from_its_first_trajectory(delay: float) -> None:
    uav, d = Vehicle(delay, uav=Uav(position=(20.0, 20.0), velocity=(0.3, 0.0))), round(delay / DT)
    reasons = [uav.fly(OUT) for _ in range(d + 10)]
    assert set(reasons[:d]) <= {NotCertified.UNCHECKED_PLAN}
    assert set(reasons[d + 1 :]) == {None}


def test_bare_accelerations_are_certified_without_command_delay() -> None:
    uav = Vehicle(bare=True)
    reasons = [uav.fly(OUT if tick % 2 else BACK, lose=tick == 25) for tick in range(60)]
    assert reasons[26] is not None
    assert set(reasons[:26] + reasons[28:]) == {None}


@pytest.mark.parametrize(("delay", "interval"), [(0.1, None), (0.0, 1.0)])
def test_bare_accelerations_with_command_delay_are_not_certified(delay, interval) -> None:
    """Only the initial rest is certified."""
    uav = Vehicle(delay, interval, bare=True, links=LinkTable(commands=LinkSettings(delay=delay)))
    reasons = [uav.fly(OUT) for _ in range(60)]
    assert None not in reasons[3:]


def test_predicted_trajectory_stops_at_the_walls() -> None:
    """The vehicle stops at a wall, where a filter without walls would find it off its prediction."""
    uav = Vehicle(0.5, area=Area(width=21.0, height=21.0, cell=0.5))
    assert {uav.fly((U_A, 0.1)) for _ in range(300)} == {None}
    assert uav.world.position[0, 0] == 21.0
