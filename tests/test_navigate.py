"""The driver `navigate`: its plan, its prediction, and the filter of a cautious UGV under attack."""

import itertools
import math
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from msgspec.structs import asdict
from scipy.ndimage import binary_dilation
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from agents.drivers.cautious import (
    braking_distance,
    is_safe,
    open_from,
    open_to,
    slowing_distance,
    triangle_is_open,
)
from agents.drivers.navigate import navigate_control
from agents.drivers.navigate_parameters import NavigateParameters
from agents.drivers.parameters import driver_parameters
from agents.drivers.pending_stops import PLAIN, state_ahead
from agents.drivers.planning import (
    adopt_plan,
    continue_search,
    has_path,
    next_tile,
    start_search,
)
from agents.drivers.tile_map import MAPPED, occupancy_grid, record_block, record_tiles
from bus.messages.ground import UgvGround
from bus.messages.scenario import Area, Limits
from flights import ugv_briefing
from sim.compiling.records import records
from sim.models.ground import CLEAR, UNSEEN
from sim.models.hazards import BLOCK, FOUND, ROUGH, TOUCH
from sim.models.kinematics import UgvState, step_ugv
from sim.models.vehicles import brake, norm, step_vehicle

ROUGH_PRICE = 2.5
_STEPS = [step for step in itertools.product((-1, 0, 1), repeat=2) if step != (0, 0)]


@pytest.fixture
def cautious(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(Path(__file__).resolve().parent.parent / "benchmarks"))
    pytest.importorskip("cautious_attacks", reason="a copy of the core alone has no benchmarks")
    import cautious_attacks  # noqa: PLC0415 - from the folder above

    return cautious_attacks


def _random_map(rng: np.random.Generator, rows: int, columns: int) -> Any:
    memory = occupancy_grid(rows, columns)
    memory.tiles[:] = rng.choice(5, size=(rows, columns), p=[0.25, 0.35, 0.1, 0.25, 0.05])
    return memory


def _plan(memory: Any, tile: float, goal: int, until: int = -1, most: int = 1 << 40) -> float:
    """Plan in steps of at most `most` tiles; return the cost up to which all tiles are settled."""
    start_search(memory, goal)
    while not continue_search(ROUGH_PRICE, tile, memory, until, most):
        assert memory.flags[0]["searching"]
    adopt_plan(memory)
    return float(memory.flags[0]["settled"])


def _costs(memory: Any) -> Any:
    return np.where(memory.heap_row == -1, np.inf, memory.cost)


def _steps(memory: Any, tile: float, goal: int) -> Any:
    """Return all steps from tile to tile with their costs, infinite ones included, by the rules of the map."""
    rows, columns = memory.tiles.shape
    blocked = memory.tiles == BLOCK
    price = np.where(memory.tiles == UNSEEN, 1.5, np.where(memory.tiles == ROUGH, 2.5, 1.0))
    price = price + 0.5 * binary_dilation(blocked, np.ones((3, 3)))
    price[blocked] = math.inf
    if blocked.flat[goal]:
        price.flat[goal] = 1.5
    for n, (r, c) in itertools.product(range(rows * columns), _STEPS):
        i, j = divmod(n, columns)
        if 0 <= i + r < rows and 0 <= j + c < columns:
            cuts = math.isinf(price[i + r, j]) or math.isinf(price[i, j + c])
            mean = 0.5 * (price[i, j] + price[i + r, j + c])
            cost = mean * (math.sqrt(2.0) * tile) if r and c else mean * tile
            yield n, (i + r) * columns + j + c, math.inf if r and c and cuts else float(cost)


def _by_library(memory: Any, tile: float, goal: int) -> Any:
    """Return the costs to the goal by SciPy."""
    steps = [step for step in _steps(memory, tile, goal) if math.isfinite(step[2])]
    start, end, cost = zip(*steps, strict=True) if steps else ((), (), ())
    size = memory.tiles.size
    graph = coo_matrix((cost, (start, end)), shape=(size, size))
    return dijkstra(graph.tocsr(), indices=goal)


# the plan


@pytest.mark.parametrize("seed", range(12))
def test_plan_matches_a_library_for_any_tiles_per_tick(seed: int) -> None:
    """Of several next tiles with equal costs, the plan has the first one."""
    rng = np.random.default_rng(seed)
    rows, columns = (int(n) for n in rng.integers(2, 25, 2))
    memory, tile = _random_map(rng, rows, columns), float(rng.uniform(0.1, 1.0))
    if seed % 3 == 0:
        memory.tiles[memory.tiles != BLOCK] = CLEAR
    goal = int(rng.integers(rows * columns))
    memory.tiles.flat[goal] = BLOCK if seed % 2 else CLEAR
    assert math.isinf(_plan(memory, tile, goal))
    costs, path = _costs(memory), memory.path.copy()
    np.testing.assert_allclose(costs, _by_library(memory, tile, goal), rtol=0.0, atol=1e-9)
    reached, onward = np.isfinite(costs), dict[int, list[tuple[float, int]]]()
    for n, m, cost in _steps(memory, tile, goal):
        onward.setdefault(n, []).append((float(costs[m]) + cost, m))
    for n, options in onward.items():
        assert has_path(path, n) == reached[n]
        following = min(options)[1] if reached[n] and n != goal else n
        assert next_tile(path, columns, n) == following
    _plan(memory, tile, goal, most=int(rng.integers(1, 9)))
    assert (_costs(memory).tobytes(), memory.path.tobytes()) == (costs.tobytes(), path.tobytes())


def test_a_search_settles_no_more_tiles_in_a_tick_than_it_may() -> None:
    memory = _random_map(np.random.default_rng(2), 30, 40)
    start_search(memory, 615)
    for tick in range(1, 20):
        assert not continue_search(ROUGH_PRICE, 0.5, memory, -1, 17)
        assert (memory.heap_row == -2).sum() == 17 * tick


def test_early_search_end_has_exact_costs_so_far() -> None:
    rng = np.random.default_rng(5)
    memory = _random_map(rng, 30, 40)
    _plan(memory, 0.5, 615)
    full, path = _costs(memory), memory.path.copy()
    for until in np.flatnonzero(np.isfinite(full))[::97]:
        settled = _plan(memory, 0.5, 615, int(until))
        known = _costs(memory) <= settled
        assert settled == full[until]
        assert (memory.cost[known] == full[known]).all()
        assert (memory.path[known] == path[known]).all()
        assert known.sum() >= (full <= settled).sum()


# the map


def test_bumper_precedes_radio_and_blocked_precedes_clear() -> None:
    memory = occupancy_grid(9, 10)
    words = np.full(64, UNSEEN, np.uint8)
    words[:3] = CLEAR, BLOCK, ROUGH
    record_block(memory, 0, 0, words)
    words[:3] = BLOCK, CLEAR, UNSEEN
    record_block(memory, 0, 0, words)
    assert memory.tiles[0, :3].tolist() == [BLOCK, BLOCK, ROUGH]
    known = np.array([[0, 0], [0, 1], [-1, 3], [4, 10]])
    record_tiles(memory, known[:, 0], known[:, 1], np.array([CLEAR, FOUND, CLEAR, CLEAR], np.uint8))
    record_block(memory, 0, 0, np.full(64, BLOCK, np.uint8))
    assert memory.tiles[0, :3].tolist() == [CLEAR, FOUND, BLOCK]
    record_block(memory, 1, 1, np.full(64, CLEAR, np.uint8))  # most of it is outside the map
    assert (memory.tiles[8, 8:] == CLEAR).all()
    assert (memory.tiles == UNSEEN).sum() == 90 - 64 - 2


# the geometry


def _apart(corners: Any, low: Any, high: Any) -> float:
    """Return the largest gap between a triangle and a box along their normals; negative if they overlap."""
    box = np.array(list(itertools.product(*zip(low, high, strict=True))))
    sides = corners - np.roll(corners, 1, axis=0)
    axes = np.array([(1.0, 0.0), (0.0, 1.0), *((-y, x) for x, y in sides if x or y)])
    spans = [(corners @ axis, box @ axis) for axis in axes / np.hypot(*axes.T)[:, None]]
    return max(max(a.min() - b.max(), b.min() - a.max()) for a, b in spans)


@pytest.mark.parametrize("degenerate", [False, True])
def test_a_triangle_is_open_if_all_tiles_that_it_touches_are(degenerate: bool) -> None:
    rng, tile, n, ground = np.random.default_rng(11), 0.3, 7, open_to(0)
    for _ in range(300):
        corners = rng.uniform(-0.2, n * tile + 0.2, (3, 2))
        on_edges = rng.random((3, 2)) < 0.3
        corners[on_edges] = np.round(corners[on_edges] / tile) * tile
        corners[2] = corners[1] if degenerate else corners[2]
        i, j = (int(k) for k in rng.integers(0, n, 2))
        tiles = np.full((n, n), CLEAR, np.uint8)
        tiles[i, j] = UNSEEN
        gap = _apart(corners, (j * tile, i * tile), ((j + 1) * tile, (i + 1) * tile))
        is_open = triangle_is_open(tiles, tile, ground, *(tuple(c.tolist()) for c in corners))
        if gap <= 0.5 * TOUCH:
            assert not is_open
        elif gap > 2.0 * TOUCH:
            assert is_open


def test_the_braking_distance_is_what_braking_takes() -> None:
    rng = np.random.default_rng(3)
    for _ in range(300):
        dt, u = rng.uniform(0.02, 0.2), rng.choice([rng.uniform(0.01, 50.0), math.inf])
        speed, slow = rng.uniform(0.0, 5.0, 2)
        x = y = distance = 0.0
        v_x, v_y = 0.6 * speed, 0.8 * speed
        slowed = 0.0 if speed <= slow else math.nan
        while norm(v_x, v_y) > 1e-12:
            command = brake(v_x, v_y, u, dt)
            x, y, v_x, v_y, _, _ = step_vehicle(x, y, v_x, v_y, *command, 5.0, u, dt)
            distance = norm(x, y)
            if math.isnan(slowed) and norm(v_x, v_y) <= slow:
                slowed = distance
        assert braking_distance(speed, u, dt) == pytest.approx(distance, abs=1e-11)
        assert slowing_distance(speed, slow, u, dt) == pytest.approx(slowed, abs=1e-11)


# the filter


def _on_tiles(**numbers: float) -> Any:
    plain = {"width": 8.0, "height": 8.0, "tile": 1.0, "dt": 0.1, "rough_share": 0.2}
    return _parameters(**plain | {"max_speed": 2.0, "max_acceleration": 1.0} | numbers)


def test_fastest_safe_speed_just_allows_a_stop() -> None:
    tiles = np.full((8, 8), CLEAR, np.uint8)
    tiles[:, 5:] = UNSEEN
    p, own = _on_tiles(max_speed=3.0), UgvState(2.5, 2.5, 1.0, 0.0, 0.0)
    fastest = 0.0
    for speed in np.linspace(0.0, 3.0, 3001):
        if is_safe(p, False, tiles, open_to(0), own._replace(v_x=float(speed)), 0.0, 0.0):
            fastest = float(speed)
    assert fastest * 0.1 + braking_distance(fastest, 1.0, 0.1) == pytest.approx(2.5, abs=3e-3)


def test_safe_commands_leave_braking_safe_on_rough_ground() -> None:
    rng = np.random.default_rng(8)
    p, used = _on_tiles(max_acceleration=4.0), 0
    for _ in range(4000):
        tiles = rng.choice(
            np.array([CLEAR, ROUGH, UNSEEN], np.uint8), size=(8, 8), p=[0.7, 0.2, 0.1]
        )
        angle, speed = rng.uniform(0.0, 6.3), rng.uniform(0.0, 2.0)
        v_x, v_y = speed * math.cos(angle), speed * math.sin(angle)
        own = UgvState(*rng.uniform(0.5, 7.5, 2), v_x, v_y, 0.0)
        u_x, u_y = rng.uniform(-4.0, 4.0, 2)
        if not is_safe(p, False, tiles, open_to(0), own, u_x, u_y):
            continue
        used += 1
        slowed = rng.uniform(0.05, 2.0)
        then = step_ugv(p.kinematics, own, u_x, u_y, (2.0, 4.0), slowed, 0.1)
        stop = brake(then.v_x, then.v_y, 4.0, 0.1)
        assert is_safe(p, False, tiles, open_to(0), then, *stop)
    assert used > 300


def test_late_commands_keep_it_slow_before_rough_ground() -> None:
    tiles = np.full((8, 8), CLEAR, np.uint8)
    tiles[:, 4] = ROUGH
    fast, near = UgvState(2.0, 2.5, 1.0, 0.0, 0.0), UgvState(3.8, 2.5, 1.0, 0.0, 0.0)
    for own, late, safe in ((fast, True, True), (near, False, True), (near, True, False)):
        assert is_safe(_on_tiles(), late, tiles, open_to(0), own, 0.0, 0.0) == safe
    slow = near._replace(v_x=0.4)
    assert is_safe(_on_tiles(), True, tiles, open_to(0), slow, 0.0, 0.0)


def test_ugv_leaves_its_blocked_tile_and_enters_none() -> None:
    tiles = np.full((8, 8), CLEAR, np.uint8)
    tiles[2, 2] = tiles[2, 3] = BLOCK
    own, memory = UgvState(2.5, 2.5, 0.0, 0.0, 0.0), occupancy_grid(8, 8)
    memory.tiles[:] = tiles
    ground = open_from(memory, 1.0, 0, own.p_x, own.p_y)
    fast = _on_tiles(max_speed=20.0, max_acceleration=50.0)
    assert is_safe(fast, False, tiles, ground, own, 0.0, 50.0)
    assert not is_safe(fast, False, tiles, ground, own._replace(v_x=4.9), 50.0, 0.0)
    assert open_from(memory, 1.0, 1, 0.5, 0.5) == open_to(1)


# under attack


def test_cautious_ugv_enters_no_unknown_tile_under_attack(cautious) -> None:
    """The long version with 10,000 runs: `python benchmarks/cautious_attacks.py attack`, and `lossy`."""
    flights = [
        cautious.fly(cautious.draw_trial(seed), seed, lossy=seed % 2 == 1) for seed in range(100)
    ]
    assert sum(one.entered for one in flights) == 0
    assert sum(one.driven > 0.0 for one in flights) > 40


def test_ugv_keeps_its_distance_from_unknown_ground(cautious) -> None:
    """The long version with 10,000 runs: `python benchmarks/cautious_attacks.py clearance`."""
    trials = [cautious.draw_distant_trial(seed) for seed in range(100)]
    flights = [cautious.fly(one, seed, lossy=True) for seed, one in enumerate(trials)]
    assert sum(one.entered + one.near + one.broken for one in flights) == 0
    assert sum(one.driven > 0.0 for one in flights) > 30
    kept = [max(0.0, one.clearance - one.parameters.tile) for one in trials]
    nearer = (cautious.fly(one, k, kept=kept[k]).near for k, one in enumerate(trials))
    assert any(nearer)


@pytest.mark.parametrize("name", ["too short", "some points", "straight", "before the command"])
def test_a_wrong_filter_is_caught(cautious: ModuleType, name: str) -> None:
    check = next(check for about, check in cautious.BROKEN.items() if name in about)
    caught = (cautious.fly(cautious.pushed_trial(k), k, check).entered for k in range(120))
    assert any(caught)


def test_an_unforeseen_delay_is_caught(cautious: ModuleType) -> None:
    late = (seed for seed in range(100) if cautious.pushed_trial(seed).delay)
    flights = (cautious.fly(cautious.pushed_trial(k), k, is_safe, believed=0) for k in late)
    assert any(one.entered for one in flights)


def test_it_arrives_wherever_there_is_a_path(cautious: ModuleType) -> None:
    trials = {seed: cautious.draw_trial(seed, wheel="plan", calm=True) for seed in range(60)}
    able = {seed: trial for seed, trial in trials.items() if cautious.is_reachable(trial)}
    assert len(able) > 15
    for seed, trial in able.items():
        assert cautious.fly(trial, seed).reached


# the driver


def _parameters(**numbers: Any) -> Any:
    briefing = ugv_briefing(
        area=Area(width=20.0, height=5.0, cell=0.5),
        limits=Limits(max_speed=1.5, max_acceleration=0.5),
        goal_tolerance=0.2,
        ground=UgvGround(tile=0.5, sensing_range=0.75, caution="cautious", rough_speed_share=0.4),
    )
    found = asdict(driver_parameters(briefing, "navigate"))
    changed = NavigateParameters(**found | numbers)
    return records(NavigateParameters, [changed]).view(np.recarray)[0]


def _step(p: Any, own: UgvState, u: tuple[float, float]) -> UgvState:
    return step_ugv(p.kinematics, own, *u, (p.max_speed, p.max_acceleration), p.max_speed, p.dt)


def _drive(p: Any, memory: Any, goals: Any, ticks: int, start: Any) -> Any:
    own, track = UgvState(*start, 0.0, 0.0, 0.0), []
    for tick in range(ticks):
        own = _step(p, own, navigate_control(p, memory, np.array(goals), tick, own, PLAIN))
        track.append(own)
    return np.array(track)


def _ground(state: int = CLEAR, **sizes: int) -> Any:
    """Return a map of 20 m by 5 m, all in one state."""
    memory = occupancy_grid(10, 40, **sizes)
    memory.tiles[:] = state
    return memory


GOAL = [[18.0, 2.5]]


@pytest.mark.parametrize(("bold", "passes"), [(0, False), (1, True)])
def test_unseen_ground_stops_the_cautious_and_not_the_bold(bold: int, passes: bool) -> None:
    memory = _ground(UNSEEN)
    memory.tiles[:, :20] = CLEAR
    track = _drive(_parameters(bold=bold), memory, GOAL, 600, (1.0, 2.5))
    assert (track[:, 0].max() > 10.0) == passes
    assert track[-1, 0] == pytest.approx(18.0 if passes else 10.0, abs=0.01)
    assert norm(track[-1, 2], track[-1, 3]) < 1e-3


def test_the_bold_brakes_for_a_tile_that_it_learns_to_be_blocked() -> None:
    p, memory = _parameters(bold=1), _ground(UNSEEN)
    _drive(p, memory, GOAL, 40, (1.0, 2.5))
    record_tiles(memory, np.arange(10), np.full(10, 20), np.full(10, BLOCK, np.uint8))
    track = _drive(p, memory, GOAL, 400, (4.0, 2.5))
    assert track[:, 0].max() < 10.0


def test_ugv_waits_until_its_own_tile_is_known() -> None:
    p, memory = _parameters(), _ground()
    memory.tiles[5, 2] = UNSEEN
    assert not _drive(p, memory, GOAL, 20, (1.2, 2.7))[:, 2:].any()
    record_tiles(memory, np.array([5]), np.array([2]), np.array([CLEAR], np.uint8))
    assert _drive(p, memory, GOAL, 20, (1.2, 2.7))[-1, 2] > 0.3


def test_ugv_among_blocked_tiles_takes_the_nearest_exit() -> None:
    p, memory = _parameters(), _ground()
    memory.tiles[2:8, 2:8] = BLOCK
    track = _drive(p, memory, GOAL, 600, (3.3, 2.6))
    assert track[:, 0].min() > 3.2
    assert track[-1, 0] == pytest.approx(18.0, abs=0.01)


def test_ugv_leaves_blocked_tiles_around_a_mapped_building() -> None:
    """The nearest exit is behind the building."""
    p, memory = _parameters(), _ground()
    memory.tiles[4:9, 8:16] = BLOCK
    memory.measured[4:6, 8:16] = MAPPED
    track = _drive(p, memory, GOAL, 800, (6.2, 3.05))
    over = (track[:, 0] > 4.0) & (track[:, 0] < 8.0)
    assert track[over, 1].min() > 3.0
    assert track[-1, 0] == pytest.approx(18.0, abs=0.01)


def test_it_comes_to_rough_ground_as_slow_as_that_lets_it() -> None:
    p, memory = _parameters(), _ground()
    memory.tiles[:, 20:24] = ROUGH
    track = _drive(p, memory, GOAL, 600, (1.0, 2.5))
    speed = np.hypot(track[:, 2], track[:, 3])
    rough = (track[:, 0] > 10.0) & (track[:, 0] < 12.0)
    assert speed[rough].max() < 1.05 * p.rough_share * p.max_speed
    assert speed.max() > 1.2
    assert track[-1, 0] == pytest.approx(18.0, abs=1e-3)


def test_news_in_every_tick_keeps_no_search_from_its_end() -> None:
    p, memory = _parameters(plan_tiles=15), _ground()
    own, plans, speeds = UgvState(1.0, 2.5, 0.0, 0.0, 0.0), set(), []
    far = np.array([9]), np.array([0])
    for tick in range(400):
        record_tiles(memory, *far, np.array([(CLEAR, FOUND)[tick % 2]], np.uint8))
        if tick == 100:  # a wall with a gap
            record_tiles(memory, np.arange(8), np.full(8, 30), np.full(8, BLOCK, np.uint8))
        own = _step(p, own, navigate_control(p, memory, np.array(GOAL), tick, own, PLAIN))
        plans.add(int(memory.flags[0]["plans"]))
        speeds.append(norm(own.v_x, own.v_y))
    assert len(plans) > 10
    assert np.hypot(own.p_x - 18.0, own.p_y - 2.5) < p.goal_tolerance
    assert min(speeds[60:150]) > 0.5  # meanwhile it drives on the previous plan


def test_without_goals_or_without_a_path_it_stands_still() -> None:
    p, memory = _parameters(), _ground()
    assert not _drive(p, memory, np.zeros((0, 2)), 5, (1.0, 2.5)).T[2:].any()
    memory.tiles[:, 20] = BLOCK
    assert not _drive(p, memory, GOAL, 5, (1.0, 2.5)).T[2:].any()


def test_the_state_ahead_is_where_the_pending_commands_lead() -> None:
    p, memory = _parameters(), _ground(delay=3)
    queue, own = [(0.0, 0.0)] * 3, UgvState(1.0, 2.5, 0.0, 0.0, 0.0)
    foreseen: dict[int, UgvState] = {}
    for tick in range(60):
        foreseen[tick + 3], _ = state_ahead(p, memory, tick, own, PLAIN)
        queue.append(navigate_control(p, memory, np.array(GOAL), tick, own, PLAIN))
        assert foreseen.get(tick, own) == own
        own = _step(p, own, queue.pop(0))
    assert own.v_x > 0.5
