"""Scenarios and helpers for the tests of many worlds."""

import math
from typing import Any

import msgspec
import numpy as np
import pytest

from bus.messages.scenario import Estimator, Law, ScriptStep
from bus.profiles import PROFILES
from flights import escort
from sim.engine.batch import Batch
from sim.env.rewards import RewardWeights
from sim.scenario.types import Area, Certificate, Detections, LinkTable, Scenario, Wind
from sim.scenario.vehicle_types import Uav, Ugv
from tabular import words

LATE = msgspec.structs.replace(
    PROFILES["wifi-poor"], delay=0.4, jitter=0.3, duplicates=0.2, reorder=0.2, reorder_delay=0.3
)

LOSSY = msgspec.structs.replace(
    PROFILES["perfect"],
    delay=0.1,
    jitter=0.1,
    loss=0.3,
    duplicates=0.2,
    blackout_interval=5.0,
    blackout_length=1.0,
)
"""Commands arrive late, twice, out of order, or never."""

SMALL = Area(width=16.0, height=12.0, cell=0.5)

NOISY = Detections(noise=0.2, dropout=0.2)


def small(law: str, driver: str = "waypoints", **fields: Any) -> Scenario:
    script = (ScriptStep(time=1.0, velocity=(0.2, 0.0)), ScriptStep(time=4.0, velocity=(-0.1, 0.3)))
    goals = ((12.0, 6.0), (12.0, 9.0), (4.0, 3.0))
    ugv = Ugv(position=(8.0, 6.0), driver=driver, goals=goals, goal_tolerance=0.3, script=script)
    given = {"area": SMALL, "detections": NOISY, "duration": 20.0} | fields
    return escort(law, **{"uav": Uav(position=(8.0, 7.0)), "ugv": ugv} | given)


SEVERAL = Scenario(
    area=SMALL,
    detections=NOISY,
    duration=15.0,
    law=Law(name="certified"),
    uav=(
        Uav(name="uav_1", position=(4.0, 4.0), escorts="ugv_0"),
        Uav(name="uav_0", position=(9.0, 4.0), escorts="ugv_1"),
        Uav(name="uav_2", position=(9.0, 6.0), escorts="ugv_1", max_speed=0.8),
    ),
    ugv=(
        Ugv(name="ugv_0", position=(4.0, 5.0), goals=((6.0, 6.0),), driver="wander"),
        Ugv(name="ugv_1", position=(9.0, 5.0), goals=((3.0, 3.0), (5.0, 3.0)), driver="evade"),
    ),
)

POOR = LinkTable(detections=LATE, commands=LATE, radio=LATE)

ONE = Scenario(
    name="one",
    duration=60.0,
    detections=Detections(noise=0.1, dropout=0.2, rate=10.0),
    uav=(Uav(position=(12.0, 10.0)),),
    ugv=(Ugv(position=(10.0, 10.0), goals=((14.0, 10.0), (14.0, 16.0))),),
)
"""One UAV and one UGV, for the tests of returned values."""

FREE = Scenario(
    name="free",
    duration=60.0,
    detections=Detections(noise=0.1, truncation=math.inf),
    law=Law(parameters={"reference_speed": 1.0}),
    uav=(Uav(position=(12.0, 10.0), max_speed=math.inf, max_acceleration=math.inf),),
    ugv=(Ugv(position=(10.0, 10.0), max_acceleration=10.0),),
)
"""The same without limits of the UAV."""

BLURRED = msgspec.structs.replace(ONE, detections=Detections(noise=30.0, truncation=math.inf))
"""Detections with unbounded noise as large as the area."""
FAST = msgspec.structs.replace(
    FREE,
    detections=BLURRED.detections,
    ugv=(Ugv(position=(10.0, 10.0), max_speed=2000.0, max_acceleration=1e6),),
)
"""The UAV has no limits, and the UGV crosses the area in less than a tick."""
SCENARIOS: dict[str, Scenario] = {
    **{
        law: small(law)
        for law in words(
            "tracking coverage linear switching logarithmic circle certified lookahead"
        )
    },
    **{driver: small("certified", driver) for driver in ("wander", "script", "evade")},
    "raw detections": small("logarithmic", estimator=Estimator(enabled=False)),
    "network": small("certified", "evade", links=POOR, duration=30.0),
    "narrow network": small(
        "certified",
        "evade",
        links=LinkTable(detections=PROFILES["narrowband"], commands=PROFILES["narrowband"]),
        certificate=Certificate(
            max_measurement_age=6.0, max_command_delay=1.0, max_command_interval=5.0
        ),
        duration=30.0,
    ),
    "delayed commands": small(
        "certified",
        links=LinkTable(commands=msgspec.structs.replace(PROFILES["perfect"], delay=0.2)),
    ),
    "lost commands": small(
        "certified",
        "evade",
        links=LinkTable(commands=LOSSY),
        certificate=Certificate(max_command_delay=0.4, max_command_interval=2.0),
    ),
    "wind": small(
        "certified",
        "evade",
        wind=Wind(mean=(0.05, 0.02), gust=0.03),
        uav=Uav(position=(8.0, 7.0), position_error=0.1),
    ),
    "uncertifiable": small("certified", certificate=Certificate(max_measurement_error=0.01)),
    "several": SEVERAL,
}

FLOWN = [pytest.param(n, marks=pytest.mark.long) if n == "lookahead" else n for n in SCENARIOS]
"""Names of all scenarios; batches with `lookahead` take a minute to compile."""

SCENARIO = SCENARIOS["certified"]

SEEN = RewardWeights(uncovered=0.5, seen=2.0, effort=0.3)

LATE_DETECTIONS = msgspec.structs.replace(SCENARIO, links=LinkTable(detections=LATE))


def random_actions(worlds: int, ticks: int, *, size: float = 0.3) -> np.ndarray:
    return np.random.default_rng(1).uniform(-size, size, (ticks, worlds, 2))


def step(batch: Batch, commands: np.ndarray) -> None:
    """Advance all worlds of a batch by a tick in which these commands are sent over the links."""
    vehicles = batch.state.vehicles
    vehicles["outgoing_tick"] = batch.state.ticks[:, None]
    vehicles["outgoing"] = commands
    vehicles["outgoing_trajectory"], vehicles["outgoing_trajectories"] = -1, 0
    batch.advance()


def equal(one: Any, other: Any) -> bool:
    """Return whether two values have the same bits and types, at any nesting."""
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(equal(one[key], other[key]) for key in one)
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(equal, one, other))
    if isinstance(one, np.ndarray):
        alike = (one.dtype, one.shape) == (other.dtype, other.shape)
        return alike and one.tobytes() == other.tobytes()
    return type(one) is type(other) and bool(one == other)


def raw(scenario: Scenario) -> Scenario:
    """Return the scenario without estimator: then batches and pilots have the same bits."""
    return msgspec.structs.replace(scenario, estimator=Estimator(enabled=False))


CASES: dict[str, tuple[Scenario, str, dict[str, Any]]] = {
    "uav": (SCENARIO, "uav_0", {}),
    "ugv": (raw(SCENARIO), "ugv_0", {"end_on_goals_reached": True}),
    "weights": (SCENARIO, "uav_0", {"rewards": SEEN}),
    "patch": (SCENARIO, "uav_0", {"coverage_patch": (7, 0.6)}),
    "late": (LATE_DETECTIONS, "uav_0", {}),
    "random": (
        SCENARIO,
        "uav_0",
        {"randomize": {"uav.*.max_speed": [0.5, 0.9], "detections.noise": [0.05, 0.2]}},
    ),
    "evade": (raw(SCENARIOS["evade"]), "uav_0", {}),
    "evade over a network": (raw(SCENARIOS["network"]), "uav_0", {"duration": 10.0}),
    "no end": (SCENARIO, "uav_0", {"end_on_sight_lost": False, "duration": 3.0}),
}
