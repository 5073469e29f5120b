"""Random ground, UGVs on it, and measures of their paths, for the attacks on cautious UGVs."""

import dataclasses
import math
from typing import Any

import numpy as np
import numpy.typing as npt

from agents.drivers.navigate_parameters import PLAN_TILES, NavigateParameters
from sim.compiling.compile import FloatArray
from sim.compiling.records import records
from sim.models.ground import CLEAR, TileArray
from sim.models.hazards import BLOCK, FOUND, ROUGH
from sim.models.kinematics import ACKERMANN, DIFFERENTIAL, Kinematics, UgvState

LATER = 1 << 40
"""Tick later than any in a run."""
_SAMPLES = np.linspace(0.0, 1.0, 17)
TELLERS = ("bumper", "nothing for long", "all but some", "at rest only", "any order", "all")
WHEELS = ("plan", "dash", "swerve", "noise")

Ugv = Any
"""Record of `NavigateParameters`."""


def parameters_of(**numbers: float | Kinematics) -> Ugv:
    """Return the record of the driver's parameters."""
    given = NavigateParameters(**numbers)  # type: ignore[arg-type]
    return records(NavigateParameters, [given]).view(np.recarray)[0]


def changed(ugv: Ugv, **numbers: float | Kinematics) -> Ugv:
    """Return a record with other numbers."""
    new = ugv.copy()
    for name, number in numbers.items():
        new[name] = number
    return new


@dataclasses.dataclass(frozen=True, kw_only=True)
class Trial:
    """Ground, a UGV on it, and an adversary."""

    parameters: Ugv
    truth: TileArray
    """Shape (rows, columns)."""
    start: tuple[float, float]
    goals: FloatArray
    delay: int
    """Ticks until a command takes effect."""
    slowest: float
    """Smallest true share of the maximum speed on rough ground."""
    teller: str
    """Order in which the adversary reveals tiles: one of `TELLERS`."""
    sensing_range: float
    """Range of the UGV's sensor [m]."""
    wheel: str
    """Nominal control: one of `WHEELS`."""
    ticks: int
    heading: float = 0.0
    """Initial heading of a UGV that steers [rad]."""
    clearance: float = 0.0
    """Distance that the UGV keeps from every tile not known to be drivable [m]; 0: none."""


def _ground(rng: np.random.Generator) -> TileArray:
    """Draw tiles: few or many blocked, a maze of corridors, or diagonal walls."""
    rows, columns = (int(n) for n in rng.integers(4, 26, 2))
    kind, density = rng.integers(4), rng.uniform(0.0, 0.45)
    tiles = rng.choice(
        np.array([CLEAR, ROUGH, FOUND], np.uint8),
        size=(rows, columns),
        p=[0.75, 0.2, 0.05],
    )
    if kind == 0:
        tiles[rng.random((rows, columns)) < density] = BLOCK
    elif kind == 3:
        tiles[rng.random((rows, columns)) < 0.1 * density] = BLOCK
    elif kind == 1:  # walls of odd rows and columns with gaps
        tiles[1::2, :] = np.where(rng.random(tiles[1::2, :].shape) < 0.3, tiles[1::2, :], BLOCK)
    else:
        i, j = np.indices((rows, columns))
        tiles[((i + j) % int(rng.integers(3, 8)) == 0) & (rng.random((rows, columns)) < 0.9)] = (
            BLOCK
        )
    return tiles


def touched(x: float, tile: float, count: int) -> list[int]:
    """Return the rows or columns whose closed intervals contain a coordinate."""
    at = math.floor(x / tile)
    return [n for n in (at - 1, at, at + 1) if 0 <= n < count and n * tile <= x <= (n + 1) * tile]


def _start(rng: np.random.Generator, truth: TileArray, tile: float) -> tuple[float, float] | None:
    """Draw a position in a drivable tile, often on an edge or a corner shared by drivable tiles only."""
    rows, columns = truth.shape
    for _ in range(50):
        i, j = int(rng.integers(rows)), int(rng.integers(columns))
        share = rng.choice([rng.random(), 0.0, 1.0, 0.5], size=2)
        x, y = min((j + share[0]) * tile, columns * tile), min((i + share[1]) * tile, rows * tile)
        around = [truth[r, c] for r in touched(y, tile, rows) for c in touched(x, tile, columns)]
        if around and BLOCK not in around:
            return float(x), float(y)
    return None


def draw_trial(seed: int, *, wheel: str | None = None, calm: bool = False) -> Trial:
    """Draw the trial of a seed; a calm trial can be expected to arrive."""
    rng = np.random.default_rng(seed)
    while True:
        truth, tile = _ground(rng), float(rng.uniform(0.1, 1.0))
        start = _start(rng, truth, tile)
        if start is not None:
            break
    rows, columns = truth.shape
    dt = float(rng.uniform(0.02, 0.2))
    slowest = float(rng.uniform(0.05, 1.0))
    delay = int(rng.choice([0, 0, 1, 2, 5]))
    v_max = tile * float(np.exp(rng.uniform(math.log(0.5), math.log(4.0 if calm else 40.0))))
    stop = tile * float(np.exp(rng.uniform(math.log(0.1), math.log(2.0 if calm else 20.0))))
    u_max = 0.5 * v_max * v_max / stop
    if rng.random() < 0.05 and not calm:
        u_max = math.inf
    cells = rng.integers(0, [rows, columns], size=(int(rng.integers(1, 4)), 2))
    goals = (cells[:, ::-1] + rng.random(cells.shape)) * tile
    believed = slowest if delay else float(rng.uniform(0.05, 1.0))
    parameters = parameters_of(
        dt=dt,
        width=columns * tile,
        height=rows * tile,
        max_speed=v_max,
        max_acceleration=u_max,
        goal_tolerance=0.3 * tile,
        kinematics=Kinematics(),
        tile=tile,
        rough_share=believed,
        bold=0,
        plan_ticks=max(1, round(rng.choice([0.0, 0.2, 1.0]) / dt)),
        plan_tiles=PLAN_TILES,
    )
    given = Trial(
        parameters=parameters,
        truth=truth,
        start=start,
        goals=np.ascontiguousarray(goals),
        delay=delay,
        slowest=slowest,
        teller="bumper" if calm else str(rng.choice(TELLERS)),
        sensing_range=tile
        * float(rng.uniform(1.0, 3.0) if calm else rng.choice([0.01, 0.3, 1.0, 2.5])),
        wheel=wheel or ("plan" if rng.random() < 0.5 else str(rng.choice(WHEELS[1:]))),
        ticks=20_000 if calm else 300,
    )
    most = int(rng.choice([3, 30, PLAN_TILES]))  # many ticks a plan, some, or one
    return dataclasses.replace(given, parameters=changed(parameters, plan_tiles=most))


def draw_distant_trial(seed: int, *, wheel: str | None = None) -> Trial:
    """Draw the trial of a seed in which the UGV keeps a distance, at its start too, from blocked tiles."""
    rng = np.random.default_rng([seed, 2])
    while True:
        trial = draw_trial(int(rng.integers(1 << 30)), wheel=wheel)
        tile, (rows, columns) = trial.parameters.tile, trial.truth.shape
        blocks = np.argwhere(trial.truth == BLOCK)
        x, y = trial.start
        away = [
            np.hypot(*np.maximum(np.abs(blocks - (i, j)) - 1.0, 0.0).T).min(initial=3.0)
            for i in touched(y, tile, rows)
            for j in touched(x, tile, columns)
        ]
        if min(away) > 0.0:
            kept = tile * min(away) * float(rng.choice([0.999, rng.random()]))
            return dataclasses.replace(trial, clearance=kept)


def draw_steering_trial(seed: int, *, wheel: str | None = None, calm: bool = False) -> Trial:
    """Draw the trial of a seed with a UGV that steers."""
    return steered(draw_trial(seed, wheel=wheel, calm=calm), seed, calm=calm)


def steered(trial: Trial, seed: int, *, calm: bool = False) -> Trial:
    """Return a trial whose UGV is a differential drive or a car, tight or wide."""
    rng = np.random.default_rng([seed, 3])
    tile, ugv = trial.parameters.tile, trial.parameters
    size = tile * float(np.exp(rng.uniform(math.log(0.2), math.log(1.0 if calm else 5.0))))
    car = rng.random() < 0.5
    kinematics = Kinematics(ACKERMANN if car else DIFFERENTIAL, size, 1.0 / size)
    if math.isinf(ugv.max_acceleration):
        ugv = changed(ugv, max_acceleration=ugv.max_speed / ugv.dt)
    parameters = changed(ugv, kinematics=kinematics)
    heading = float(rng.uniform(-math.pi, math.pi))
    return dataclasses.replace(trial, parameters=parameters, heading=heading)


def is_rough(trial: Trial, x: float, y: float) -> bool:
    """Return whether a point touches a rough tile."""
    rows, columns = trial.truth.shape
    return any(
        trial.truth[i, j] == ROUGH
        for i in touched(y, trial.parameters.tile, rows)
        for j in touched(x, trial.parameters.tile, columns)
    )


def path_points(trial: Trial, states: list[UgvState]) -> tuple[FloatArray, FloatArray]:
    """Return points of the path [m]: x and y. Shape (ticks, points)."""
    track = np.array(states)
    a, b, dt = track[:-1], track[1:], trial.parameters.dt
    shares = [np.repeat(_SAMPLES[None], len(a), axis=0)]
    for k in (2, 3):  # where the path reverses on an axis
        change = b[:, k] - a[:, k]
        shares.append(np.clip(-a[:, k] / np.where(change == 0.0, 1.0, change), 0.0, 1.0)[:, None])
    t = np.concatenate(shares, axis=1)
    points = []
    for k in (0, 1):
        path = a[:, k, None] + dt * t * (a[:, k + 2, None] + 0.5 * t * (b - a)[:, k + 2, None])
        points.append(np.where(t == 1.0, b[:, k, None], path))
    return points[0], points[1]


def near_ticks(trial: Trial, states: list[UgvState]) -> npt.NDArray[np.bool_]:
    """Return the ticks with a point of the path within the clearance of a blocked tile. Shape (ticks,)."""
    x, y = path_points(trial, states)
    s, near = trial.parameters.tile, np.zeros(len(x), bool)
    for row, column in np.argwhere(trial.truth == BLOCK):
        d_x = np.maximum(np.maximum(column * s - x, x - (column + 1) * s), 0.0)
        d_y = np.maximum(np.maximum(row * s - y, y - (row + 1) * s), 0.0)
        near |= (np.hypot(d_x, d_y) <= trial.clearance).any(axis=1)
    return near


def entered_ticks(
    trial: Trial,
    known: npt.NDArray[np.int64],
    states: list[UgvState],
    blocked: npt.NDArray[np.int64] | None = None,
) -> npt.NDArray[np.bool_]:
    """Return the ticks with a point of the path in a closed tile not known to be drivable at the tick's start.

    The start itself may lie in such a tile.

    Args:
        trial: The trial.
        known: Tick from which each tile is known to be drivable. Shape (rows, columns).
        states: State at each tick.
        blocked: Tick from which it is known to be blocked instead; None: no tile is.

    Returns:
        Shape (ticks,).
    """
    track = np.array(states)
    a, b = track[:-1], track[1:]
    x, y = path_points(trial, states)
    s, bad = trial.parameters.tile, np.zeros(len(a), bool)
    tick = np.arange(len(a))[:, None]
    rows, columns = known.shape
    i, j = np.floor(y / s).astype(int), np.floor(x / s).astype(int)
    for r in (i - 1, i, i + 1):
        for c in (j - 1, j, j + 1):
            there = (r >= 0) & (r < rows) & (c >= 0) & (c < columns)
            on = (r * s <= y) & (y <= (r + 1) * s) & (c * s <= x) & (x <= (c + 1) * s) & there
            there = np.clip(r, 0, rows - 1), np.clip(c, 0, columns - 1)
            bad |= (on & (known[there] > tick)).any(axis=1)
            if blocked is not None:
                bad |= (on & (blocked[there] <= tick)).any(axis=1)
    moved = (a[:, :2] != b[:, :2]).any(axis=1) | (a[:, 2:4] != 0.0).any(axis=1)
    found: npt.NDArray[np.bool_] = bad & moved
    return found
