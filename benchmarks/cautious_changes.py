"""Attacks on the guarantee of a cautious UGV whose driver changes in flight, see docs/explanation/ground.md.

python benchmarks/cautious_changes.py NAME

drivers: 10,000 flights in which an operator and other drivers control the UGV in between, over links that delay, lose
    and reorder commands, and become slower in flight; the UGV may keep a distance from unknown ground.
steering: the same with UGVs that steer, of which a third keeps a distance from unknown ground, and with turn rates.
mapped: 10,000 flights with a map of buildings among hazards that the UAV misses, so that the UGV stops in blocked
    tiles, or starts in one; in half of them the drivers change, too.

Each flight runs the UGV's pilot; ground, receiver and counters are independent of the simulator. A quarter of an hour
each. A UGV may end without moving: it knows no drivable path to its next goal, or has reached it, or the link is slower
than declared for the rest of the flight.
"""

import dataclasses
import itertools
import math
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import numpy.typing as npt
from cautious_attacks import moved
from cautious_trials import (
    LATER,
    Trial,
    changed,
    draw_distant_trial,
    draw_trial,
    entered_ticks,
    is_rough,
    near_ticks,
    path_points,
    steered,
)
from markdown_tables import print_chosen

from agents.ugv import UgvPilot
from bus.messages.buildings import Building
from bus.messages.ground import BLOCK_SIDE, TILE_LETTERS, MapUpdate, TileReport, UgvGround
from bus.messages.scenario import Area, Limits
from bus.messages.vehicle import Teleoperation, UgvBriefing, UgvCommand, UgvObservation
from bus.registry import KINEMATICS
from sim.models.ground import UNSEEN, TileArray
from sim.models.hazards import BLOCK
from sim.models.kinematics import POINT, UgvState
from sim.models.vehicles import brake

RUNS = 10_000
_OTHERS = ("teleop", "teleop", "waypoints", "wander")
_TICKS = 250
_COMMAND_TIMEOUT = 0.5
"""Time for which the last command stays in effect [s]."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Flight:
    """A trial, and what happens in it."""

    trial: Trial
    changes: dict[int, str]
    """Driver assigned in each of these ticks."""
    slower: tuple[int, int]
    """Tick from which the link is slower than declared, and by how much [ticks]."""
    lossy: bool
    """True if commands are lost and reordered."""
    houses: tuple[tuple[int, int, int, int], ...] = ()
    """Mapped buildings: first row and column, last row and column."""
    kept: float = 0.0
    """Distance that the UGV keeps from them [m]."""
    missed: float = 0.0
    """Probability with which the UAV reports a blocked tile as clear."""


class Link:
    """A vehicle's receiver behind a link, by its description in docs/explanation/proof.md."""

    def __init__(self, flight: Flight, rng: np.random.Generator) -> None:
        self._flight, self._rng, self._timeout = (
            flight,
            rng,
            math.floor(_COMMAND_TIMEOUT / flight.trial.parameters.dt),
        )
        self._coming: dict[int, list[UgvCommand]] = {}
        self._stored: dict[int, tuple[int, tuple[float, float]]] = {}
        self._newest, self._bare = -1, (0.0, 0.0)
        self._plain = False
        self.committed = -1
        """First tick of the committed trajectory; -1: none."""

    def send(self, command: UgvCommand) -> None:
        """Send a command, unless it is lost."""
        flight, tick = self._flight, command.tick
        late = flight.trial.delay + (flight.slower[1] if tick >= flight.slower[0] else 0)
        if flight.lossy:
            if self._rng.random() < 0.15:
                return
            late = int(self._rng.integers(0, late + 2))
        self._coming.setdefault(tick + late, []).append(command)

    def act(self, tick: int, own: UgvState, u_max: float, dt: float) -> tuple[float, float]:
        """Return the acceleration of this tick [m/s²]."""
        for command in self._coming.pop(tick, []):
            for one in command.backup_trajectories:
                if one.begins >= tick:
                    self._stored.setdefault(one.begins, (one.parent, one.acceleration))
            if command.tick > self._newest:
                self._newest, self._bare = command.tick, command.acceleration
                if not command.backup_trajectories:
                    self.committed, self._plain = -1, True
        due = self._stored.pop(tick, None)
        if due is not None and due[0] == self.committed:
            self.committed, self._plain = tick, False
            return due[1]
        if self._plain and tick - self._newest <= self._timeout:
            return self._bare
        return brake(own.v_x, own.v_y, u_max, dt)


class Ground:
    """Reports of the UGV's own sensor, which are true, and of a UAV, which may miss hazards."""

    def __init__(self, flight: Flight, rng: np.random.Generator) -> None:
        self._flight, self._rng = flight, rng
        truth, tile = flight.trial.truth, flight.trial.parameters.tile
        rows, columns = truth.shape
        self.known: TileArray = np.full(truth.shape, UNSEEN, np.uint8)
        """States as the UGV knows them; its own reports are final, and so is a blocked tile."""
        self._own = np.zeros(truth.shape, bool)
        self._low_x, self._low_y = np.arange(columns) * tile, np.arange(rows) * tile
        wrong = (truth == BLOCK) & (rng.random(truth.shape) < flight.missed)
        self._seen = np.where(wrong, np.uint8(1), truth)

    def own(self, x: float, y: float) -> tuple[TileReport, ...]:
        """Return the new reports of the UGV's own sensor at a position [m]."""
        trial = self._flight.trial
        s, sensing_range = trial.parameters.tile, trial.sensing_range
        d_x = np.maximum(np.maximum(self._low_x - x, x - self._low_x - s), 0.0)
        d_y = np.maximum(np.maximum(self._low_y - y, y - self._low_y - s), 0.0)
        new = (d_x[None, :] ** 2 + d_y[:, None] ** 2 <= sensing_range * sensing_range) & ~self._own
        self._own |= new
        self.known[new] = trial.truth[new]
        states = trial.truth
        return tuple(
            TileReport(int(j), int(i), TILE_LETTERS[states[i, j]]) for i, j in np.argwhere(new)
        )

    def radioed(self) -> tuple[MapUpdate, ...]:
        """Return a block of the UAV's map, or nothing."""
        if self._rng.random() < 0.7:
            return ()
        rows, columns = self.known.shape
        row, column = (int(self._rng.integers(-(-n // BLOCK_SIDE))) for n in (rows, columns))
        i, j = row * BLOCK_SIDE, column * BLOCK_SIDE
        block = np.full((BLOCK_SIDE, BLOCK_SIDE), UNSEEN, np.uint8)
        part = self._seen[i : i + BLOCK_SIDE, j : j + BLOCK_SIDE]
        block[: part.shape[0], : part.shape[1]] = part
        tiles = slice(i, i + part.shape[0]), slice(j, j + part.shape[1])
        new = ~self._own[tiles] & (self.known[tiles] != BLOCK)
        self.known[tiles][new] = part[new]
        letters = "".join(TILE_LETTERS[state] for state in block.reshape(-1))
        return (MapUpdate(row=row, column=column, tiles=letters),)


def _footprints(flight: Flight) -> list[tuple[tuple[float, float], ...]]:
    """Return the corners of the mapped buildings, each within its tiles [m]."""
    s, inset = float(flight.trial.parameters.tile), 0.01
    found = []
    for row, column, last_row, last_column in flight.houses:
        left, low = (column + inset) * s, (row + inset) * s
        right, high = (last_column + 1 - inset) * s, (last_row + 1 - inset) * s
        found.append(((left, low), (right, low), (right, high), (left, high)))
    return found


def _kinematics(flight: Flight) -> dict[str, Any]:
    """Return the fields of a briefing that describe the UGV's kinematics."""
    own = flight.trial.parameters.kinematics
    kind = KINEMATICS[own.kind]
    fields = {"differential": {"track": float(own.track)}}
    fields["ackermann"] = {"max_curvature": float(own.max_curvature)}
    return {"kinematics": kind, **fields.get(kind, {})}


def briefing(flight: Flight) -> UgvBriefing:
    """Return the briefing of the UGV."""
    trial, ugv = flight.trial, flight.trial.parameters
    s = float(ugv.tile)
    bound = None if math.isinf(ugv.max_acceleration) else float(ugv.max_acceleration)
    return UgvBriefing(
        vehicle="ugv_0",
        dt=float(ugv.dt),
        area=Area(width=float(ugv.width), height=float(ugv.height), cell=s),
        limits=Limits(max_speed=float(ugv.max_speed), max_acceleration=bound),
        key="1" * 32,
        driver=flight.changes[0],
        **_kinematics(flight),
        goals=tuple((float(x), float(y)) for x, y in trial.goals),
        goal_tolerance=float(ugv.goal_tolerance),
        command_timeout=_COMMAND_TIMEOUT,
        buildings=tuple(Building(polygon=corners, height=3.0) for corners in _footprints(flight)),
        ground=UgvGround(
            tile=s,
            sensing_range=float(trial.sensing_range),
            caution="cautious",
            delay=trial.delay * float(ugv.dt),
            building_clearance=flight.kept,
            tile_clearance=trial.clearance,
            rough_speed_share=float(ugv.rough_share),
            executes_trajectories=True,
        ),
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class Result:
    """Counts of one flight."""

    certified: int
    """Ticks with a certificate."""
    broken: int
    """Certificates that ended because the stopping path was not known to be drivable, though all reports were true."""
    entered: int
    near: int
    """Certified ticks with a point in a tile not known to be drivable, and nearer than the clearance."""
    house: int
    """Ticks nearer to a mapped building than the clearance, certified or not, if `navigate` drove all the time."""
    waits: bool
    """True if `navigate` took over for the last 60 ticks or more, and did not move."""


def _operated(flight: Flight, rng: np.random.Generator) -> tuple[Teleoperation, ...]:
    """Return an operator's message: any velocity, or speed and turn rate if the UGV steers, or nothing."""
    if rng.random() < 0.9:
        return ()
    if flight.trial.parameters.kinematics.kind != POINT and rng.random() < 0.7:
        speed = float(flight.trial.parameters.max_speed * rng.uniform(-1.0, 1.0))
        turn_rate = float(rng.choice([0.0, rng.normal(), 1e3 * rng.normal()]))
        return (Teleoperation(operator="operator", speed=speed, turn_rate=turn_rate),)
    speed = flight.trial.parameters.max_speed * float(rng.choice([1.0, rng.random()]))
    angle = float(rng.uniform(0.0, 2.0 * math.pi))
    velocity = (float(speed * math.cos(angle)), float(speed * math.sin(angle)))
    return (Teleoperation(operator="operator", velocity=velocity),)


def _near_house(flight: Flight, states: list[UgvState]) -> npt.NDArray[np.bool_]:
    """Return the ticks with a point of the path nearer to a mapped building than the clearance. Shape (ticks,)."""
    x, y = path_points(flight.trial, states)
    near = np.zeros(len(x), bool)
    for corners in _footprints(flight):
        (left, low), (right, high) = corners[0], corners[2]
        d_x = np.maximum(np.maximum(left - x, x - right), 0.0)
        d_y = np.maximum(np.maximum(low - y, y - high), 0.0)
        near |= (np.hypot(d_x, d_y) < flight.kept).any(axis=1)
    return near


def _moved(flight: Flight, own: UgvState, u: tuple[float, float], share: float) -> UgvState:
    """Return the state after a tick with a command [m/s²], at this share of the maximum speed."""
    ugv = flight.trial.parameters
    return moved(ugv, own, u, ugv.max_speed * share)


class Record:
    """Record of the knowledge, claims and trajectory of the UGV, tick by tick."""

    def __init__(self, flight: Flight) -> None:
        shape = flight.trial.truth.shape
        self._flight = flight
        self._since, self._blocked = np.full(shape, LATER), np.full(shape, LATER)
        self.states = [UgvState(*flight.trial.start, 0.0, 0.0, flight.trial.heading)]
        self._claims: list[str] = []
        self._drivers: list[str] = []

    def add(
        self, tick: int, known: TileArray, driver: str, answer: UgvCommand, there: UgvState
    ) -> None:
        """Record a tick, and the state after it."""
        report = answer.report
        claim = "" if report is None else "certified" if report.certified else report.uncertified
        self._since[(known != UNSEEN) & (known != BLOCK) & (self._since == LATER)] = tick
        self._blocked[(known == BLOCK) & (self._blocked == LATER)] = tick
        self._claims.append(claim)
        self._drivers.append(driver)
        self.states.append(there)

    def result(self) -> Result:
        """Return the counts."""
        flight, trial, claims = self._flight, self._flight.trial, self._claims
        own, near = np.array([claim == "certified" for claim in claims]), 0
        entered = entered_ticks(trial, self._since, self.states, self._blocked)
        if trial.clearance > 0.0:
            near += int((near_ticks(trial, self.states) & own).sum())
        house = np.zeros_like(own)
        if flight.houses:
            house = _near_house(flight, self.states)
            near += int((house & own).sum())
        last = len(claims)
        while last > 0 and self._drivers[last - 1] == "navigate":
            last -= 1
        driven = sum(math.dist(a[:2], b[:2]) for a, b in itertools.pairwise(self.states[last:]))
        return Result(
            certified=int(own.sum()),
            broken=0
            if flight.missed
            else sum(
                a == "certified" and "stopping path" in b for a, b in itertools.pairwise(claims)
            ),
            entered=int((entered & own).sum()),
            near=near,
            house=int(house.sum()) if set(self._drivers) == {"navigate"} else 0,
            waits=0 < last <= len(claims) - 60 and driven < 0.01 * trial.parameters.tile,
        )


def fly(flight: Flight, seed: int) -> Result:
    """Fly, and compare the UGV's reports with the truth."""
    rng, trial, ugv = np.random.default_rng([seed, 3]), flight.trial, flight.trial.parameters
    pilot, link, ground = UgvPilot(briefing(flight)), Link(flight, rng), Ground(flight, rng)
    record, driver = Record(flight), flight.changes[0]
    for tick in range(trial.ticks):
        own, assigned = record.states[-1], flight.changes.get(tick) if tick else None
        driver = assigned or driver
        answer = pilot.act(
            UgvObservation(
                tick=tick,
                time=tick * float(ugv.dt),
                position=(own.p_x, own.p_y),
                velocity=(own.v_x, own.v_y),
                heading=None if ugv.kinematics.kind == POINT else own.heading,
                driver=assigned,
                tile_reports=ground.own(own.p_x, own.p_y),
                map_updates=ground.radioed() if trial.teller != "bumper" else (),
                operator=_operated(flight, rng) if driver == "teleop" else (),
                committed_trajectory=None if link.committed < 0 else link.committed,
            )
        )
        link.send(answer)
        u = link.act(tick, own, ugv.max_acceleration, ugv.dt)
        share = float(rng.uniform(trial.slowest, 1.0)) if is_rough(trial, *own[:2]) else 1.0
        record.add(tick, ground.known, driver, answer, _moved(flight, own, u, share))
    return record.result()


def _changes(rng: np.random.Generator, first: str) -> dict[int, str]:
    """Draw up to five changes between `navigate` and other drivers."""
    found, driver = {0: first}, first
    for tick in sorted(rng.integers(1, _TICKS, int(rng.integers(1, 6))).tolist()):
        driver = str(rng.choice(_OTHERS)) if driver == "navigate" else "navigate"
        found[tick] = driver
    return found


def draw_flight(seed: int) -> Flight:
    """Draw a flight with changes of the driver."""
    rng = np.random.default_rng([seed, 5])
    trial = draw_distant_trial(seed) if seed % 3 == 0 else draw_trial(seed, calm=seed % 3 == 1)
    delay = int(rng.choice([0, 1, 2, 5, 10]))
    trial = dataclasses.replace(
        trial,
        parameters=changed(trial.parameters, rough_share=trial.slowest),
        delay=delay,
        ticks=_TICKS,
        teller=str(rng.choice(["bumper", "radio"])),
    )
    slower = (
        (int(rng.integers(_TICKS)), int(rng.integers(1, 25))) if rng.random() < 0.3 else (LATER, 0)
    )
    first = str(rng.choice(["navigate", *_OTHERS]))
    return Flight(
        trial=trial,
        changes=_changes(rng, first),
        slower=slower,
        lossy=bool(rng.random() < 0.5),
    )


def _is_near(flight: Flight, tiles: float) -> bool:
    """Return whether the start is nearer to a building than the clearance plus this many tiles."""
    kept = flight.kept + tiles * float(flight.trial.parameters.tile)
    states = [UgvState(*flight.trial.start, 0.0, 0.0, flight.trial.heading)] * 2
    return bool(_near_house(dataclasses.replace(flight, kept=kept), states).any())


def _stranded(flight: Flight, rng: np.random.Generator) -> Flight:
    """Move the start into a missed hazard, near a building if possible, with other hazards around it."""
    trial = flight.trial
    s, truth = float(trial.parameters.tile), trial.truth.copy()
    for _ in range(50):
        i, j = (int(rng.integers(n)) for n in truth.shape)
        x, y = (float((k + rng.random()) * s) for k in (j, i))
        flight = dataclasses.replace(flight, trial=dataclasses.replace(trial, start=(x, y)))
        if _is_near(flight, 3.0) and not _is_near(flight, 1.5):
            break
    around = truth[max(i - 2, 0) : i + 3, max(j - 2, 0) : j + 3]
    around[rng.random(around.shape) < 0.9] = BLOCK
    truth[i, j] = BLOCK
    sensing_range = 2.5 * s
    return dataclasses.replace(
        flight, trial=dataclasses.replace(flight.trial, truth=truth, sensing_range=sensing_range)
    )


def draw_mapped(seed: int) -> Flight:
    """Draw a flight with a map of buildings, among hazards that the UAV misses."""
    rng = np.random.default_rng([seed, 6])
    while True:
        flight = draw_flight(int(rng.integers(3 << 30)) // 3 * 3 + 1)
        trial = flight.trial
        s, (rows, columns) = trial.parameters.tile, trial.truth.shape
        kept = s * float(rng.uniform(0.1, 1.5))
        density = float(rng.choice([0.0, 0.4, 0.8]))  # of the hazards around the buildings
        houses, truth = list[tuple[int, int, int, int]](), trial.truth.copy()
        for _ in range(int(rng.integers(1, 5))):
            r, c = int(rng.integers(rows)), int(rng.integers(columns))
            e, d = (
                min(r + int(rng.integers(3)), rows - 1),
                min(c + int(rng.integers(3)), columns - 1),
            )
            houses.append((r, c, e, d))
            around = truth[max(r - 4, 0) : e + 5, max(c - 4, 0) : d + 5]
            around[rng.random(around.shape) < density] = BLOCK
        for r, c, e, d in houses:
            truth[r : e + 1, c : d + 1] = BLOCK
        changes = flight.changes if rng.random() < 0.5 else {0: "navigate"}
        flight = dataclasses.replace(
            flight,
            trial=dataclasses.replace(
                trial,
                truth=truth,
                teller="radio",
                sensing_range=s * float(rng.choice([0.01, 0.01, 0.3, 1.0])),
            ),
            changes=changes,
            houses=tuple(houses),
            kept=kept,
            missed=float(rng.choice([0.3, 0.9])),
        )
        if seed % 2:
            flight = _stranded(flight, rng)
        if not _is_near(flight, 1.5):
            return flight


def attack(runs: int, draw: Callable[[int], Flight]) -> Iterator[str]:
    """Fly, and count violations."""
    ticks, flights = Counter[str](), Counter[str]()
    for seed in range(runs):
        one = dataclasses.asdict(fly(draw(seed), seed))
        ticks.update(one)
        flights.update({name: int(count > 0) for name, count in one.items()})
    yield f"{runs} flights, certified in {ticks['certified']} ticks of {flights['certified']} flights"
    yield f"certificates broken: {ticks['broken']} in {flights['broken']} flights"
    yield f"certified in a tile not known to be drivable: {ticks['entered']} ticks of {flights['entered']} flights"
    yield f"certified nearer than the clearance: {ticks['near']} ticks of {flights['near']} flights"
    yield (
        "nearer to a mapped building, certified or not, under navigate from the start: "
        f"{ticks['house']} ticks of {flights['house']} flights"
    )
    yield f"flights that end with 60 or more ticks of navigate without moving: {flights['waits']}"


def drivers(runs: int = RUNS) -> Iterator[str]:
    """Attack UGVs whose drivers change."""
    yield from attack(runs, draw_flight)


def draw_steering(seed: int) -> Flight:
    """Draw a flight with changes of the driver of a UGV that steers."""
    flight = draw_flight(seed)
    return dataclasses.replace(flight, trial=steered(flight.trial, seed))


def steering(runs: int = RUNS) -> Iterator[str]:
    """Attack UGVs that steer whose drivers change."""
    yield from attack(runs, draw_steering)


def mapped(runs: int = RUNS) -> Iterator[str]:
    """Attack UGVs with a map of buildings."""
    yield from attack(runs, draw_mapped)


TABLES = {"drivers": drivers, "steering": steering, "mapped": mapped}


if __name__ == "__main__":
    print_chosen(TABLES, __doc__)
