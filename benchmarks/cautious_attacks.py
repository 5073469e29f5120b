"""Attacks on the guarantee of a cautious UGV, see docs/explanation/ground.md.

python benchmarks/cautious_attacks.py NAME

attack: 10,000 runs over ground that an adversary reveals in its own order; in half of them it also controls the UGV.
lossy: the same over links that lose, delay and reorder commands.
clearance: the same, over the same links, for UGVs that keep a distance from all ground that they do not know.
steering: the same, over the same links, for UGVs that steer: differential drives and cars.
broken: the same with faulty filters, each of which must be caught.
arrivals: share of reachable goals that are reached, with the sensor alone and with ground revealed in any order.
speed: durations of a plan and of a tick; the slowest tick of a UGV that plans over 400 x 400 tiles.

About six minutes for `clearance`, three for `attack` and `lossy`, one or two for each other.
"""

import dataclasses
import math
import time
from collections.abc import Callable, Iterator

import numpy as np
import numpy.typing as npt
from cautious_trials import (
    LATER,
    WHEELS,
    Trial,
    Ugv,
    changed,
    draw_distant_trial,
    draw_steering_trial,
    draw_trial,
    entered_ticks,
    is_rough,
    near_ticks,
)
from markdown_tables import head, print_chosen

from agents.drivers.cautious import (
    Open,
    braking_distance,
    is_safe,
    open_from,
    open_to,
    segment_is_open,
)
from agents.drivers.navigate import navigate_control
from agents.drivers.navigate_parameters import PLAN_TILES
from agents.drivers.pending_stops import PLAIN, state_ahead, store_command, update_claim
from agents.drivers.planning import continue_search, start_search
from agents.drivers.tile_map import OccupancyGrid, occupancy_grid, record_block, record_tiles
from sim.models.ground import CERTIFIED, CLEAR, NO_CLAIM, PATH_UNKNOWN, UNSEEN, TileArray
from sim.models.hazards import BLOCK, FOUND, TOUCH
from sim.models.kinematics import UgvState, step_ugv, ugv_within_walls
from sim.models.trajectories import NO_TRAJECTORY
from sim.models.vehicles import brake, clip_norm, norm

RUNS = 10_000
Check = Callable[[Ugv, bool, TileArray, Open, UgvState, float, float], bool]


@dataclasses.dataclass(frozen=True)
class Outcome:
    """Result of one run."""

    broken: int
    """Certified ticks followed by an uncertified one."""

    entered: int
    """Ticks with a point in a tile not known to be drivable, or not known to be so far from blocked ones."""
    near: int
    """Ticks with a point within the clearance of a blocked tile."""
    driven: float
    """Length of the path [m]."""
    ticks: int
    """Ticks until the last goal was reached, or until the end."""
    reached: bool


class Teller:
    """Adversary that reveals true tiles in its own order."""

    def __init__(self, trial: Trial, memory: OccupancyGrid, rng: np.random.Generator) -> None:
        self.trial, self.memory, self.rng = trial, memory, rng
        rows, columns = trial.truth.shape
        s = trial.parameters.tile
        self._low_x, self._low_y = np.arange(columns) * s, np.arange(rows) * s
        self._hidden = rng.random(trial.truth.shape) < 0.2
        self._wakes = int(rng.integers(0, 150))

    def _reveal(self, chosen: npt.NDArray[np.bool_]) -> None:
        rows, columns = np.nonzero(chosen & (self.memory.reported == UNSEEN))
        if len(rows):
            record_tiles(self.memory, rows, columns, self.trial.truth[rows, columns])

    def _near(self, x: float, y: float, sensing_range: float) -> npt.NDArray[np.bool_]:
        s = self.trial.parameters.tile
        d_x = np.maximum(np.maximum(self._low_x - x, x - self._low_x - s), 0.0)
        d_y = np.maximum(np.maximum(self._low_y - y, y - self._low_y - s), 0.0)
        return d_x[None, :] ** 2 + d_y[:, None] ** 2 <= sensing_range * sensing_range

    def reveal(self, tick: int, x: float, y: float, speed: float) -> None:
        """Reveal tiles at a tick, given the UGV's position [m] and speed [m/s]."""
        teller, sensing_range, rng = self.trial.teller, self.trial.sensing_range, self.rng
        if teller == "all":
            if tick == 0:
                self._reveal(np.ones_like(self._hidden))
        elif teller == "nothing for long":
            if tick >= self._wakes:
                self._reveal(self._near(x, y, 4.0 * sensing_range))
        elif teller == "all but some":
            self._reveal(~self._hidden | (self._near(x, y, sensing_range) & (rng.random() < 0.1)))
        elif teller == "at rest only":
            if speed < 1e-9:
                self._reveal(
                    self._near(x, y, sensing_range) & (rng.random(self._hidden.shape) < 0.5)
                )
        elif teller == "any order":
            self._reveal(self._near(x, y, 0.0))
            i, j = (int(rng.integers(0, 1 + n // 8)) for n in self._hidden.shape)
            block = np.zeros((8, 8), np.uint8)
            part = self.trial.truth[8 * i : 8 * i + 8, 8 * j : 8 * j + 8]
            block[: part.shape[0], : part.shape[1]] = part
            block[rng.random((8, 8)) < 0.9] = UNSEEN
            record_block(self.memory, i, j, block.reshape(-1))
        else:
            self._reveal(self._near(x, y, sensing_range))


def _wanted(
    trial: Trial, rng: np.random.Generator, before: tuple[float, float], own: UgvState
) -> tuple[float, float]:
    """Return the adversary's nominal control [m/s²]: straight on, a sharp turn, or anything."""
    u = min(trial.parameters.max_acceleration, trial.parameters.max_speed / trial.parameters.dt)
    speed = norm(own.v_x, own.v_y)
    if trial.wheel == "swerve" and speed > 0.2 * trial.parameters.max_speed:
        side = rng.choice([-1.0, 1.0])
        return -side * u * own.v_y / speed, side * u * own.v_x / speed
    if trial.wheel != "noise" and rng.random() < 0.97 and before != (0.0, 0.0):
        return before
    angle = rng.choice([rng.uniform(0.0, 2.0 * math.pi), 0.25 * math.pi * rng.integers(8)])
    return u * math.cos(angle), u * math.sin(angle)


class Receiver:
    """Vehicle's end of a link that loses commands, delays some too long, and reorders the rest.

    Args:
        memory: Memory of the sender; a packet carries its pending trajectories.
        rng: Random number generator of the adversary.
    """

    def __init__(self, memory: OccupancyGrid, rng: np.random.Generator) -> None:
        self._memory, self._rng = memory, rng
        self._delay = len(memory.sent) - 2
        self._coming: dict[int, list[tuple[int, int, float, float]]] = {}
        self._there: dict[int, tuple[int, float, float]] = {}
        self._share, self._silent = rng.choice([0.05, 0.3, 0.8]), 0
        self.flown = NO_TRAJECTORY
        """Committed trajectory, by the tick at which it started."""

    def send(self, tick: int) -> None:
        """Send the packet of a tick, unless it is lost."""
        if self._silent == 0 and self._rng.random() < 0.05:
            self._silent = int(self._rng.integers(1, 25))
        self._silent = max(0, self._silent - 1)
        if self._silent or self._rng.random() < self._share:
            return
        last, sent = tick + self._delay, self._memory.sent
        rows = [sent[k % len(sent)] for k in range(max(tick, last - 5), last + 1)]
        packet = [
            (int(row["begins"]), int(row["parent"]), *row["acceleration"].tolist()) for row in rows
        ]
        late = int(self._rng.integers(0, self._delay + 3))  # at most two ticks too late
        self._coming.setdefault(tick + late, []).extend(packet)

    def act(self, tick: int, own: UgvState, parameters: Ugv) -> tuple[float, float]:
        """Return the command of this tick [m/s²]: the due trajectory's if it arrived and its parent is committed."""
        for begins, parent, u_x, u_y in self._coming.pop(tick, []):
            if begins >= tick:
                self._there.setdefault(begins, (parent, u_x, u_y))
        due = self._there.pop(tick, None)
        if due is not None and due[0] == self.flown:
            self.flown = tick
            return due[1], due[2]
        return brake(own.v_x, own.v_y, parameters.max_acceleration, parameters.dt)


def _filtered_by(
    check: Check | None, trial: Trial, memory: OccupancyGrid, tick: int, own: UgvState,
    wanted: tuple[float, float], flown: int,
) -> tuple[float, float]:  # fmt: skip
    """Return the nominal control if it is safe, else the braking one: by the filter, or by another check."""
    parameters = trial.parameters
    ahead, parent = state_ahead(parameters, memory, tick, own, flown)
    ground = open_to(0)
    if check is None:
        ground = open_from(memory, parameters.tile, parameters.bold, ahead.p_x, ahead.p_y)
    if not (check or is_safe)(parameters, trial.delay > 0, memory.tiles, ground, ahead, *wanted):
        wanted = brake(ahead.v_x, ahead.v_y, parameters.max_acceleration, parameters.dt)
    store_command(memory, tick, parent, *wanted)
    update_claim(parameters, memory, ahead, *wanted)
    return wanted


def moved(ugv: Ugv, own: UgvState, u: tuple[float, float], ground_speed: float) -> UgvState:
    """Return the state after a tick with a command [m/s²], on ground with this largest speed [m/s]."""
    bounds = ugv.max_speed, ugv.max_acceleration
    after = step_ugv(ugv.kinematics, own, *u, bounds, ground_speed, ugv.dt)
    return ugv_within_walls(ugv.kinematics, after, ugv.width, ugv.height)


def fly(
    trial: Trial,
    seed: int,
    check: Check | None = None,
    believed: int | None = None,
    *,
    lossy: bool = False,
    kept: float | None = None,
) -> Outcome:
    """Simulate a trial.

    Args:
        trial: Trial to simulate.
        seed: Seed of the adversary's choices.
        check: Replacement of `is_safe` in a faulty filter; then the adversary controls the UGV.
        believed: Delay assumed by a faulty filter.
        lossy: True for lost, late and reordered commands, which then carry the stop that follows them.
        kept: Clearance of a faulty UGV [m].
    """
    parameters, rng = trial.parameters, np.random.default_rng([seed, 1])
    kept = trial.clearance if kept is None else kept
    memory = occupancy_grid(
        *trial.truth.shape,
        trial.delay if believed is None else believed,
        clearance=(kept + TOUCH) / parameters.tile if kept > 0.0 else -1.0,
    )
    teller = Teller(trial, memory, rng)
    known = np.full(trial.truth.shape, LATER)
    own, driven, tick = UgvState(*trial.start, 0.0, 0.0, trial.heading), 0.0, 0
    queue, states, wanted = [(0.0, 0.0)] * trial.delay, [own], (0.0, 0.0)
    receiver = Receiver(memory, rng) if lossy else None
    flown = PLAIN if receiver is None else NO_TRAJECTORY
    last, reached = trial.goals[-1], False
    claim, broken = NO_CLAIM, 0
    for tick in range(trial.ticks):
        teller.reveal(tick, own.p_x, own.p_y, norm(own.v_x, own.v_y))
        fresh = (known == LATER) & (memory.tiles != UNSEEN) & (memory.tiles != BLOCK)
        known[fresh] = tick
        if check is None and trial.wheel == "plan":
            u = navigate_control(parameters, memory, trial.goals, tick, own, flown)
            at_last = memory.flags[0]["goal"] == len(trial.goals) - 1
            reached = at_last and math.dist(own[:2], last) < parameters.goal_tolerance
            if reached and trial.ticks > 1000:
                break
        else:
            wanted = _wanted(trial, rng, wanted, own)
            u = _filtered_by(check, trial, memory, tick, own, wanted, flown)
        before, claim = claim, int(memory.flags[0]["claim"])
        broken += before == CERTIFIED and claim == PATH_UNKNOWN
        queue.append(u)
        u_x, u_y = queue.pop(0)
        if receiver is not None:
            receiver.send(tick)
            u_x, u_y = receiver.act(tick, own, parameters)
            flown = receiver.flown
        v_max = parameters.max_speed
        if is_rough(trial, own.p_x, own.p_y):
            v_max *= rng.uniform(trial.slowest, 1.0)
        before_tick, own = own, moved(parameters, own, (u_x, u_y), v_max)
        driven += math.dist(before_tick[:2], own[:2])
        states.append(own)
    near = int(near_ticks(trial, states).sum()) if trial.clearance > 0.0 else 0
    entered = int(entered_ticks(trial, known, states).sum())
    return Outcome(broken, entered, near, driven, tick, bool(reached))


def is_reachable(trial: Trial) -> bool:
    """Return true if the true tiles connect the start to each goal."""
    parameters, memory = trial.parameters, occupancy_grid(*trial.truth.shape)
    memory.tiles[:] = trial.truth
    columns = trial.truth.shape[1]
    positions = [trial.start, *trial.goals]
    tiles = [
        int(y / parameters.tile) * columns + min(int(x / parameters.tile), columns - 1)
        for x, y in positions
    ]
    tiles = [min(n, trial.truth.size - 1) for n in tiles]
    if any(trial.truth.reshape(-1)[n] == BLOCK for n in tiles):
        return False
    start_search(memory, tiles[0])
    continue_search(1.0, parameters.tile, memory, -1, trial.truth.size)
    return bool(np.isfinite(memory.cost[tiles]).all())


def _brakes_short(
    ugv: Ugv, late: bool, t: TileArray, ground: Open, own: UgvState, *u: float
) -> bool:
    kept = clip_norm(*u, ugv.max_acceleration)
    return is_safe(
        changed(ugv, max_acceleration=1.25 * ugv.max_acceleration), late, t, ground, own, *kept
    )


def _after(ugv: Ugv, own: UgvState, u_x: float, u_y: float) -> tuple[tuple[float, float], ...]:
    """Return the positions at the end of the tick and at the stop after it [m]."""
    bounds = ugv.max_speed, ugv.max_acceleration
    x, y, w_x, w_y, _ = step_ugv(ugv.kinematics, own, u_x, u_y, bounds, ugv.max_speed, ugv.dt)
    speed = norm(w_x, w_y)
    share = braking_distance(speed, ugv.max_acceleration, ugv.dt) / speed if speed else 0.0
    return (x, y), (x + share * w_x, y + share * w_y)


def _forgets_corners(
    ugv: Ugv, late: bool, t: TileArray, ground: Open, own: UgvState, *u: float
) -> bool:
    """Check the tiles of some points of the path only."""
    there, end = _after(ugv, own, *u)
    for (x_0, y_0), (x_1, y_1) in (((own.p_x, own.p_y), there), (there, end)):
        n = 1 + int(2.0 * math.dist((x_0, y_0), (x_1, y_1)) / ugv.tile)
        for k in range(n + 1):
            x, y = x_0 + k / n * (x_1 - x_0), y_0 + k / n * (y_1 - y_0)
            if not (0.0 <= x <= ugv.width and 0.0 <= y <= ugv.height):
                return False
            i = min(int(y / ugv.tile), t.shape[0] - 1)
            j = min(int(x / ugv.tile), t.shape[1] - 1)
            if t[i, j] in (UNSEEN, BLOCK):
                return False
    return True


def _takes_the_chord(
    ugv: Ugv, late: bool, t: TileArray, ground: Open, own: UgvState, *u: float
) -> bool:
    """Approximate the path within a tick by a straight line."""
    there, end = _after(ugv, own, *u)
    inside = all(0.0 <= x <= ugv.width and 0.0 <= y <= ugv.height for x, y in (there, end))
    return (
        inside
        and segment_is_open(t, ugv.tile, ground, (own.p_x, own.p_y), there)
        and segment_is_open(t, ugv.tile, ground, there, end)
    )


def _checks_only_now(
    ugv: Ugv, late: bool, t: TileArray, ground: Open, own: UgvState, *u: float
) -> bool:
    """Check braking from the current state, not from the state after the command."""
    return is_safe(
        ugv, late, t, ground, own, *brake(own.v_x, own.v_y, ugv.max_acceleration, ugv.dt)
    )


BROKEN: dict[str, Check] = {
    "brakes too short": _brakes_short,
    "tiles of some points only": _forgets_corners,
    "straight within a tick": _takes_the_chord,
    "braking from before the command": _checks_only_now,
}
"""Faulty filters. A filter that ignores the delay of commands is faulty, too."""


def lossy(runs: int = RUNS) -> Iterator[str]:
    """Run the attacks over links that lose, delay and reorder commands."""
    yield from attack(runs, lossy=True)


def clearance(runs: int = RUNS) -> Iterator[str]:
    """Run the attacks on UGVs that keep a distance from all ground that they do not know."""
    yield from attack(runs, lossy=True, draw=draw_distant_trial)


def steering(runs: int = RUNS) -> Iterator[str]:
    """Run the attacks on UGVs that steer: differential drives and cars."""
    yield from attack(runs, lossy=True, draw=draw_steering_trial)


def attack(
    runs: int = RUNS, *, lossy: bool = False, draw: Callable[[int], Trial] = draw_trial
) -> Iterator[str]:
    """Run the attacks and count violations."""
    count = dict.fromkeys(("flights", "entered", "near", "broken", "ticks", "still"), 0)
    driven = 0.0
    for seed in range(runs):
        trial = draw(seed)
        one = fly(trial, seed, lossy=lossy)
        count["flights"] += 1
        count["entered"] += one.entered > 0
        count["near"] += one.near > 0
        count["broken"] += one.broken
        count["ticks"] += one.ticks + 1
        count["still"] += one.driven == 0.0
        driven += one.driven / trial.parameters.tile
        if one.entered:
            yield f"seed {seed}: {one.entered} ticks in tiles not known to be drivable"
    yield f"{count['flights']} runs of {count['ticks']} ticks and {driven:.0f} tiles' path"
    yield f"{count['entered']} of them entered a tile not known to be drivable"
    if draw is draw_distant_trial:
        yield f"{count['near']} of them came as near to a blocked tile as the clearance"
    if lossy:
        yield f"the certificate was broken {count['broken']} times"
    yield f"in {count['still']} of them the UGV did not move"


def broken(runs: int = 500) -> Iterator[str]:
    """Run faulty filters against an adversary that controls the UGV."""
    yield head("filter | runs that enter a tile not known to be drivable")
    for name, check in {"none": is_safe, **BROKEN}.items():
        caught = sum(fly(pushed_trial(k), k, check).entered > 0 for k in range(runs))
        yield f"| {name} | {caught} of {runs} |"
    late = [seed for seed in range(3 * runs) if pushed_trial(seed).delay][:runs]
    caught = sum(fly(pushed_trial(k), k, is_safe, believed=0).entered > 0 for k in late)
    yield f"| delay of the commands ignored | {caught} of {len(late)} |"
    distant = [pushed_trial(seed, draw_distant_trial) for seed in range(runs)]
    kept = [max(one.clearance - one.parameters.tile, 0.0) for one in distant]
    caught = sum(fly(one, k, kept=kept[k]).near > 0 for k, one in enumerate(distant))
    yield f"| a tile less than the clearance | {caught} of {runs} |"


def pushed_trial(seed: int, draw: Callable[..., Trial] = draw_trial) -> Trial:
    """Draw the trial of a seed in which the adversary controls the UGV."""
    return draw(seed, wheel=WHEELS[1 + seed % 3])


def arrivals(runs: int = 500) -> Iterator[str]:
    """Count the calm trials that arrive."""
    able = [
        seed for seed in range(5 * runs) if is_reachable(draw_trial(seed, wheel="plan", calm=True))
    ]
    done = [fly(draw_trial(k, wheel="plan", calm=True), k) for k in able[:runs]]
    yield f"{sum(one.reached for one in done)} of {len(done)} with a path to all goals arrive"
    yield f"{sum(one.entered > 0 for one in done)} of them enter a tile not known to be drivable"
    for k, one in zip(able, done, strict=False):
        if not one.reached:
            yield f"seed {k} does not arrive"


def _scattered(side: int) -> OccupancyGrid:
    """Return a map of random tiles, clear at the UGV's start and in the opposite corner."""
    memory = occupancy_grid(side, side)
    memory.tiles[:] = np.random.default_rng(0).choice(
        5, size=(side, side), p=[0.3, 0.4, 0.1, 0.15, 0.05]
    )
    memory.tiles[:4, :4] = memory.tiles[-4:, -4:] = CLEAR
    return memory


def _slowest_tick(most: int, ticks: int = 600) -> str:
    """Return the slowest ticks of a UGV with new tiles in each tick, at this planning rate, over 400 x 400 tiles."""
    memory, goals, took = _scattered(400), np.array([[199.0, 199.0]]), list[float]()
    parameters = changed(
        draw_trial(3, wheel="plan", calm=True).parameters, width=200.0, height=200.0, tile=0.5, dt=0.05, max_speed=1.0,
        max_acceleration=0.5, plan_ticks=4, bold=1, plan_tiles=most,
    )  # fmt: skip
    own = UgvState(1.0, 1.0, 0.0, 0.0, 0.0)
    for tick in range(ticks):
        state = np.array([(CLEAR, FOUND)[tick % 2]], np.uint8)
        record_tiles(memory, np.array([399]), np.array([399]), state)
        began = time.perf_counter()
        u = navigate_control(parameters, memory, goals, tick, own, PLAIN)
        took.append(1e3 * (time.perf_counter() - began))
        own = moved(parameters, own, u, parameters.max_speed)
    slowest = ", ".join(f"{one:.1f}" for one in sorted(took)[:-4:-1])
    plans, driven = memory.flags[0]["plans"], math.dist(own[:2], (1.0, 1.0))
    return f"the slowest of {ticks} ticks took {slowest} ms; {plans} plans, {driven:.1f} m driven"


def speed() -> Iterator[str]:
    """Yield the durations of a plan over tiles with hazards, and of a tick."""
    for side in (30, 80, 400):
        memory, took = _scattered(side), []
        for _ in range(30):
            began = time.perf_counter()
            start_search(memory, 0)
            continue_search(2.5, 0.5, memory, -1, side * side)
            took.append(time.perf_counter() - began)
        yield f"plan over {side} x {side} tiles: {1e3 * np.median(took[1:]):.2f} ms"
    for most in (400 * 400, PLAN_TILES):
        yield f"{most:,} tiles per tick: {_slowest_tick(most)}"
    trial = draw_trial(3, wheel="plan", calm=True)
    parameters, memory = trial.parameters, occupancy_grid(*trial.truth.shape)
    memory.tiles[:] = trial.truth
    own, began, ticks = UgvState(*trial.start, 0.0, 0.0, trial.heading), time.perf_counter(), 5000
    for tick in range(ticks):
        u = navigate_control(parameters, memory, trial.goals, tick, own, PLAIN)
        own = moved(parameters, own, u, parameters.max_speed)
    yield f"a tick on known ground: {1e6 * (time.perf_counter() - began) / ticks:.1f} µs with the vehicle"


TABLES = {
    "attack": attack,
    "lossy": lossy,
    "clearance": clearance,
    "steering": steering,
    "broken": broken,
    "arrivals": arrivals,
    "speed": speed,
}


if __name__ == "__main__":
    print_chosen(TABLES, __doc__)
