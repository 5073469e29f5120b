"""The search for a UGV out of sight: its bound, its path, and what it leaves alone."""

import math
from typing import NamedTuple

import numpy as np
import pytest

from agents.safety.area import step_in_area
from agents.safety.memory import FilterMemory, filter_memory
from agents.safety.search import DRIFT, search_control, search_time
from agents.safety.trajectories import servo
from bus.messages.scenario import SafetyParameters
from outrider.closed_loop.closed_loop import ClosedLoop
from outrider.running.flying import fly
from outrider.running.reacquisition import reacquisition
from sim.compiling.compile import FloatArray, compiled
from sim.models.safety import SafetyBounds, safety_bounds
from sim.models.vehicles import State, norm
from sim.scenario.loading import load_scenario
from worlds import raw

VEHICLES = {
    "paper": {"v_a": 0.6, "u_a": 0.3, "v_g": 0.2, "visibility_radius": 4.75, "dt": 0.05},
    "village": {"v_a": 10.0, "u_a": 4.0, "v_g": 3.0, "visibility_radius": 20.0, "dt": 0.05},
    "sluggish": {"v_a": 5.0, "u_a": 0.5, "v_g": 1.0, "visibility_radius": 10.0, "dt": 0.05},
    "slow ticks": {"v_a": 3.0, "u_a": 1.0, "v_g": 1.0, "visibility_radius": 4.0, "dt": 0.2},
}
STRAIGHT, BACK_AND_FORTH, AWAY = 0, 1, 2
"""Motions of a UGV within its bound: straight away from the measurement, across the bound and back, and away from the
UAV."""


def bounds_for(kind: str, size: float = math.inf) -> SafetyBounds:
    safety = SafetyParameters(max_measurement_error=0.3, max_measurement_age=1.0, search=True)
    return safety_bounds(safety, width=size, height=size, **VEHICLES[kind])


def lost(bounds: SafetyBounds, x: float, y: float) -> tuple[FilterMemory, int]:
    """Return a filter whose only measurement is old, and the tick at which the UGV may be out of its sight."""
    memory = filter_memory(0, 8)
    memory.discs["x"][0], memory.discs["y"][0] = x, y
    memory.discs["radius"][0], memory.discs["tick"][0] = bounds.placed_error, 0
    return memory, math.ceil(4.0 * bounds.radius / (bounds.v_g * bounds.dt))


@compiled
def drive(
    g: tuple[float, float], home: tuple[float, float], own: State, kind: int, k: int, far: float
) -> tuple[float, float]:
    """Return the next place of a UGV that stays within `far` of its home, at one step of `far` / 50."""
    step = far / 50.0
    if kind == STRAIGHT:
        x, y = home[0], home[1]
    elif kind == BACK_AND_FORTH:
        side = 1.0 if (k // 100) % 2 == 0 else -1.0
        x, y = side * home[1], -side * home[0]
    else:
        x, y = g[0] - own.p_x, g[1] - own.p_y
    length = norm(x, y)
    n_x, n_y = g[0] + step * x / (length + 1e-12), g[1] + step * y / (length + 1e-12)
    away = norm(n_x - home[0], n_y - home[1])
    if away > far:
        n_x, n_y = home[0] + (n_x - home[0]) * far / away, home[1] + (n_y - home[1]) * far / away
    return n_x, n_y


@compiled
def first_sight(
    bounds: SafetyBounds,
    memory: FilterMemory,
    start: int,
    own: State,
    home: tuple[float, float],
    motion: tuple[int, float],
    most: int,
) -> int:
    """Search until the UGV is in sight; return the ticks since the start, `most` if it never is."""
    kind, far = motion
    z, g = memory.discs[0], home
    for k in range(most):
        if norm(own.p_x - g[0], own.p_y - g[1]) < bounds.radius:
            return k
        u_x, u_y = servo(own, z.x, z.y, bounds.v_a, bounds.u_a, bounds.dt)
        u_x, u_y = search_control(bounds, memory, start + k, own, u_x, u_y)
        own, _ = step_in_area(bounds, own, u_x, u_y)
        g = drive(g, home, own, kind, k, far)
    return most


class Searched(NamedTuple):
    """Longest search from the newest measurement [s], its bound [s], and the number of UGVs never seen within it."""

    longest: float
    bound: float
    missed: int


def searched(kind: str, *, wider: float = 1.0, count: int = 150) -> Searched:
    """Search for random UGVs that stay within their bound, in the open plane.

    Args:
        kind: Key of `VEHICLES`.
        wider: Factor of the radius of sight that the search assumes.
        count: Number of UGVs for each motion.
    """
    bounds, rng = bounds_for(kind), np.random.default_rng(5)
    assumed = bounds._replace(search_radius=wider * bounds.search_radius)
    radius = bounds.radius
    farthest, far = 4.0 * radius, DRIFT * radius
    most, longest, missed = search_time(bounds, farthest), 0.0, 0
    for motion in (STRAIGHT, BACK_AND_FORTH, AWAY):
        for _ in range(count):
            angle, distance = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(radius, farthest)
            home = distance * math.cos(angle), distance * math.sin(angle)
            memory, start = lost(bounds, 0.0, 0.0)
            ticks = math.ceil(most / bounds.dt)
            own = State(0.0, 0.0, 0.0, 0.0)
            found = first_sight(assumed, memory, start, own, home, (motion, far), ticks)
            missed += found == ticks
            longest = max(longest, found * bounds.dt)
    return Searched(longest, most, missed)


@pytest.mark.parametrize("kind", VEHICLES)
def test_ugv_that_stays_within_its_bound_is_seen_in_time(kind: str) -> None:
    found = searched(kind)
    assert found.missed == 0
    assert 0.5 * found.bound < found.longest < found.bound


def test_a_spiral_with_too_wide_a_pitch_misses_ugvs() -> None:
    assert searched("paper", wider=1.5).missed > 10


@compiled
def fly_search(
    bounds: SafetyBounds, memory: FilterMemory, start: int, own: State, places: FloatArray
) -> None:
    """Search without ever seeing the UGV; write the UAV's position at each tick into `places`."""
    z = memory.discs[0]
    for k in range(places.shape[0]):
        places[k, 0], places[k, 1] = own.p_x, own.p_y
        u_x, u_y = servo(own, z.x, z.y, bounds.v_a, bounds.u_a, bounds.dt)
        u_x, u_y = search_control(bounds, memory, start + k, own, u_x, u_y)
        own, _ = step_in_area(bounds, own, u_x, u_y)


@pytest.mark.parametrize(("kind", "size"), [("paper", 40.0), ("village", 200.0)])
def test_all_ground_of_an_area_is_in_sight_in_time(kind: str, size: float) -> None:
    bounds, rng = bounds_for(kind, size), np.random.default_rng(7)
    sides = np.linspace(0.0, size, 41)
    ground = np.stack(np.meshgrid(sides, sides), axis=-1).reshape(-1, 2)
    for x, y in [(0.0, 0.0), (size, 0.5 * size), *rng.uniform(0.0, size, (4, 2)).tolist()]:
        far = math.hypot(max(x, size - x), max(y, size - y))
        memory, start = lost(bounds, x, y)
        within = search_time(bounds, far, start=(x, y))
        places = np.zeros((math.ceil(within / bounds.dt), 2))
        fly_search(bounds, memory, start, State(x, y, 0.0, 0.0), places)
        nearest = np.full(len(ground), np.inf)
        for place in places[::10]:
            nearest = np.minimum(nearest, np.hypot(*(ground - place).T))
        assert nearest.max() < (1.0 - DRIFT) * bounds.radius
        assert (places >= 0.0).all()
        assert (places <= size).all()


def random_bounds(rng: np.random.Generator) -> SafetyBounds:
    """Return a random vehicle in a random area, of half to ten radii of sight along each side."""
    radius, v_a = 10.0 ** rng.uniform(0.3, 1.6), 10.0 ** rng.uniform(-1.5, 0.3)
    width, height = radius * 10.0 ** rng.uniform(-0.3, 1.0, 2)
    return safety_bounds(
        SafetyParameters(max_measurement_error=0.01, max_measurement_age=1.0, search=True),
        width=width,
        height=height,
        v_a=radius * v_a,
        u_a=radius * v_a * 10.0 ** rng.uniform(-1.2, 1.0),
        v_g=radius * v_a / 4.0,
        visibility_radius=radius,
        dt=0.1,
    )


def time_until_seen(bounds: SafetyBounds, x: float, y: float, within: float) -> float:
    """Return the time of a search from (x, y) until all ground has been in sight [s]; inf: not up to `within`."""
    far = math.hypot(max(x, bounds.width - x), max(y, bounds.height - y))
    memory, start = lost(bounds, x, y)
    start = max(start, math.ceil(1.01 * far / (bounds.v_g * bounds.dt)))  # it can be anywhere
    places = np.zeros((math.ceil(within / bounds.dt), 2))
    fly_search(bounds, memory, start, State(x, y, 0.0, 0.0), places)
    sides = np.linspace(0.0, bounds.width, 31), np.linspace(0.0, bounds.height, 31)
    ground = np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)
    seen = np.full(len(ground), np.inf)
    step = max(1, int(0.05 * bounds.radius / (bounds.v_a * bounds.dt)))
    for k in range(0, len(places), step):
        is_near = np.hypot(*(ground - places[k]).T) < (1.0 - DRIFT) * bounds.radius
        seen[is_near & np.isinf(seen)] = k * bounds.dt
    return float(seen.max())


@pytest.mark.long
def test_time_over_a_random_area_is_near_its_estimate() -> None:
    """With `-s` it prints the numbers of docs/explanation/proof.md."""
    rng, ratios = np.random.default_rng(11), list[float]()
    while len(ratios) < 1000:
        bounds = random_bounds(rng)
        x, y = rng.uniform(0.0, bounds.width), rng.uniform(0.0, bounds.height)
        far = math.hypot(max(x, bounds.width - x), max(y, bounds.height - y))
        estimate = search_time(bounds, far, start=(x, y))
        if estimate < 6000.0:
            ratios.append(time_until_seen(bounds, x, y, 4.0 * estimate) / estimate)
    longer = sum(ratio > 1.0 for ratio in ratios)
    print(f"{longer} of {len(ratios)} areas took longer, at most {max(ratios):.2f} times as long")  # noqa: T201
    assert longer < 100
    assert max(ratios) < 1.5


def test_uav_without_search_waits_at_its_newest_measurement() -> None:
    bounds = bounds_for("paper")._replace(search=False)
    memory, start = lost(bounds, 3.0, 4.0)
    places = np.zeros((2000, 2))
    fly_search(bounds, memory, start, State(0.0, 0.0, 0.0, 0.0), places)
    np.testing.assert_allclose(places[-1], (3.0, 4.0), atol=1e-6)


BLIND = ["links.detections.blackouts=[[5.0, 40.0]]", "ugv.0.driver=evade", "law.name=certified"]
"""Blackout in which the UGV leaves the sight of a waiting UAV."""


def test_search_flies_the_same_bits_in_a_batch_as_in_a_run() -> None:
    """Without estimator, whose rounding differs, a whole run has the same bits."""
    scenario = raw(load_scenario("escort", overrides=[*BLIND, "duration=120"]))
    loop = ClosedLoop(scenario, 2, end_on_sight_lost=False)
    loop.begin([3, 4])
    loop.fly()
    for world, seed in enumerate((3, 4)):
        flight, _ = fly(scenario, seed)
        position = loop.state.batch.vehicles["position"][world]
        assert position.tobytes() == flight.world.vehicles["position"].tobytes()
    assert loop.pilots is not None
    assert (loop.pilots.state.uavs.filter.search["phase"] > 1.0).all()


def test_search_ends_losses_and_no_certificate_is_wrong() -> None:
    seeds, lost_ticks = list(range(12)), {}
    for search in ("true", "false"):
        changes = [*BLIND, "duration=300", f"uav.0.search={search}"]
        loop = ClosedLoop(
            load_scenario("escort", overrides=changes), len(seeds), end_on_sight_lost=False
        )
        loop.begin(seeds)
        loop.fly()
        metrics = loop.metrics("uav_0")
        assert metrics["certified_while_lost"].sum() == metrics["certificate_broken"].sum() == 0.0
        lost_ticks[search] = metrics["visibility_violations"].mean()
    assert 400.0 < lost_ticks["true"] < 0.7 * lost_ticks["false"]


def test_search_changes_no_flight_that_keeps_sight() -> None:
    hashes = set()
    for search in ("true", "false"):
        changes = ["ugv.0.driver=evade", "duration=40", f"uav.0.search={search}"]
        hashes.add(fly(load_scenario("escort", overrides=changes), 3)[1].trajectory_sha256)
    assert len(hashes) == 1


def test_check_states_times_for_uavs_that_search() -> None:
    scenario = load_scenario("escort")
    found = reacquisition(scenario, scenario.uav[0])
    assert found is not None
    assert 0.0 < found.near < found.area
    assert not found.hidden
    for change in ("law.name=tracking", "uav.0.search=false"):
        other = load_scenario("escort", overrides=[change])
        assert reacquisition(other, other.uav[0]) is None
    hiding = load_scenario("town", overrides=["ugv.0.driver=evade"])
    times = reacquisition(hiding, hiding.uav[0])
    assert times is not None
    assert times.hidden
