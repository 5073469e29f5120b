"""An adversary that drives along the walls of real buildings, while another flies the UAV: does a certified UGV hide?

Every town has its own buildings, altitudes, camera and network. In each of its worlds the UGV follows the walls as
closely as it declares, rounds their corners, and turns whenever that helps it to hide; the UAV dives, flees, and puts
buildings in between, inside the safety filter. Both know the true state. shapely judges each tick: is the UGV in range
of the camera and not behind a building? Counted are certified ticks without sight, ticks at which the filter gives up
a certificate although all assumptions hold, UAVs in a building, and runs with a detection whose error exceeds the
declared bound at some altitude. Exit code 1 if any count is not zero. In half of the towns the noise is not truncated
and the bound is that of `outrider network bounds` for a risk of 1 %: at most this share of their runs may exceed it.

    python tests/acceptance/walls.py --runs 100000          about half an hour on two cores
    python tests/acceptance/walls.py --runs 640 --seed 7     other towns
    python tests/acceptance/walls.py --runs 640 --unfiltered the same adversaries without the filter, which lose sight
    python tests/acceptance/walls.py --runs 1000 --takeovers runs in which drivers relieve each other (takeovers.py)
"""

import argparse
import math
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from itertools import repeat
from typing import Any

import numpy as np
import shapely
from shapely import affinity, ops

from agents.safety.decision import CERTIFIED
from agents.safety.levels import lowest_certified
from outrider.closed_loop.closed_loop import ClosedLoop
from outrider_networks.scenario_bounds import bounds_for
from sim.engine.briefing import uav_briefing
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario

SIZE = 40.0
"""Width and height of the area [m]."""
WORLDS = 64
"""Worlds in each town."""
TILE = 0.25
"""Width of a tile and of a cell [m]."""
SECONDS = 20.0
"""Duration of a run [s]."""
GAP = 0.02
"""Distance that the UGV keeps from walls beyond its declared clearance [m]: more than it moves aside in a tick."""
ROUND = 0.4
"""Radius of the inner corners of its route [m]."""
AGILE = 0.5
"""Maximum acceleration of the UGV [m/s²]."""
HIGHEST = 25.0
"""Maximum altitude [m]."""
COUNTS = ("certified out of sight", "certificate broken", "contacts", "errors beyond the bound")
"""Counts that must be zero."""
UNTRUNCATED, EXCEEDED = "runs with untruncated noise", "of these beyond the bound for a risk of 1 %"
RISK, SIGMAS = 0.01, 4.0
"""Share of the latter, and its tolerance in standard deviations."""


# -- towns


def blocks(rng: np.random.Generator) -> list[Any]:
    step, side = rng.uniform(9.0, 14.0), rng.uniform(4.0, 6.0)
    places = np.arange(4.0, SIZE - 4.0 - side, step)
    return [shapely.box(x, y, x + side, y + side) for x in places for y in places]


def scattered(rng: np.random.Generator) -> list[Any]:
    shapes = []
    for _ in range(int(rng.integers(3, 12))):
        x, y = rng.uniform(5.0, SIZE - 10.0, 2)
        w, h = rng.uniform(0.3, 7.0, 2)
        shapes.append(affinity.rotate(shapely.box(x, y, x + w, y + h), rng.uniform(0.0, 180.0)))
    return shapes


def triangles(rng: np.random.Generator) -> list[Any]:
    places = rng.uniform(7.0, SIZE - 7.0, (int(rng.integers(3, 9)), 1, 2))
    return [shapely.Polygon(one) for one in places + rng.uniform(-4.0, 4.0, (len(places), 3, 2))]


def walls(rng: np.random.Generator) -> list[Any]:
    places = rng.uniform(8.0, SIZE - 8.0, (int(rng.integers(2, 8)), 2))
    angles, half = rng.uniform(0.0, math.pi, len(places)), rng.uniform(2.0, 6.0, len(places))
    half_line = np.stack((np.cos(angles), np.sin(angles)), axis=-1) * half[:, None]
    lines = shapely.linestrings(np.stack((places - half_line, places + half_line), axis=1))
    return list(shapely.buffer(lines, 0.15, cap_style="flat"))


def courtyards(rng: np.random.Generator) -> list[Any]:
    x, y, side, door = (*rng.uniform(6.0, 12.0, 2), rng.uniform(14.0, 20.0), rng.uniform(6.0, 9.0))
    outer = shapely.box(x, y, x + side, y + side)
    middle = x + 0.5 * side
    gate = shapely.box(middle - 0.5 * door, y - 1.0, middle + 0.5 * door, y + 0.5 * side)
    return [outer.difference(outer.buffer(-2.0, join_style="mitre")).difference(gate)]


KINDS = (blocks, scattered, triangles, walls, courtyards)


def town(rng: np.random.Generator) -> tuple[list[Any], list[float]]:
    """Return simple polygons that neither overlap nor touch, and their heights [m]."""
    kept: list[Any] = []
    for shape in KINDS[rng.integers(len(KINDS))](rng):
        simple = shape.geom_type == "Polygon" and not shape.interiors and shape.area > 0.1
        if simple and shape.is_valid and all(shape.distance(other) > 0.1 for other in kept):
            kept.append(shape)
    tallest = rng.uniform(1.0, 8.0)
    return kept, (tallest * rng.choice([1.0, 0.6], len(kept))).tolist()


def rings(shapes: list[Any], clearance: float) -> list[Any]:
    """Return the closed routes around the buildings, inside the area, at this distance [m]."""
    # inner corners are round, so that the UGV can follow them
    around = shapely.union_all(shapely.buffer(shapes, clearance + ROUND, quad_segs=64))
    around = shapely.buffer(around, -ROUND, quad_segs=64)
    parts = shapely.get_parts(around)
    found = [part.exterior for part in parts] + [hole for part in parts for hole in part.interiors]
    inside = shapely.box(0.5, 0.5, SIZE - 0.5, SIZE - 0.5)
    return [ring for ring in found if ring.length > 4.0 and inside.contains(ring)]


def risked_error(changes: list[str]) -> float:
    """Return the error that a run of 'town' with these changes exceeds with the probability RISK [m]."""
    scenario = load_scenario("town", overrides=[*changes, f"uav.0.initial_altitude={HIGHEST}"])
    # the risk is shared with the bounds of age and command interval
    return bounds_for(scenario, 3.0 * RISK).set["certificate.max_measurement_error"]


def scenario_of(rng: np.random.Generator) -> tuple[Scenario, list[Any], list[float], Any] | None:
    """Return a scenario, its buildings, their heights, and the route of the UGV; None if this town has none."""
    shapes, heights = town(rng)
    clearance = rng.choice([0.5, 1.0, 1.5, 2.5])
    routes = rings(shapes, clearance + GAP) if shapes else []
    if not routes:
        return None
    route = routes[rng.integers(len(routes))]
    farther = rings(shapes, clearance + 2.0 * TILE)  # on tiles that the product accepts as a start
    if not farther:
        return None
    x, y = ops.nearest_points(shapely.union_all(farther), shapely.Point(route.coords[0]))[0].coords[
        0
    ]
    v_g = rng.choice([0.2, 0.3])
    loss = rng.choice([0.0, 0.0, 0.1, 0.3])
    delay, half_angle = rng.choice([0.0, 0.1, 0.25]), rng.choice([0.5, 0.785, 1.2])
    polygons = ", ".join(
        f"{{height={h!r}, polygon={[list(c) for c in s.exterior.coords[:-1]]!r}}}"
        for s, h in zip(shapes, heights, strict=True)
    )
    changes = [
        "building_field=[]",
        f"building=[{polygons}]",
        "buildings.known=true",
        f"duration={SECONDS}",
        f"area={{width={SIZE}, height={SIZE}, cell={TILE}}}",
        f"ground.tile={TILE}",
        f"camera.half_angle={half_angle}",
        f"detections.noise={rng.choice([0.01, 0.05])}",
        f"detections.dropout={rng.choice([0.0, 0.1, 0.4])}",
        f"links.detections.delay={rng.choice([0.0, 0.1, 0.3])}",
        f"links.detections.loss={loss}",
        f"certificate.max_measurement_age={rng.choice([1.0, 2.0])}",
        f"uav.0.min_altitude={0.3 + 0.3 / math.tan(half_angle)}",  # it sees a cell
        f"uav.0.max_altitude={HIGHEST}",
        f"uav.0.position=[{x}, {y}]",
        f"uav.0.max_climb_rate={rng.choice([0.3, 1.0, 4.0])}",
        f"uav.0.max_vertical_acceleration={rng.choice([0.2, 1.0, 3.0])}",
        "uav.0.max_acceleration=0.6",
        f"ugv.0.position=[{x}, {y}]",
        "ugv.0.goals=[]",
        f"ugv.0.max_speed={v_g}",
        f"ugv.0.max_acceleration={AGILE}",
        f"ugv.0.building_clearance={clearance}",
        "ugv.0.keeps_clearance=true",
    ]
    only = f"commands={{delay={delay}, loss={loss}}}, detections={{delay=0.1, loss={loss}}}"
    if loss or delay:
        changes.append(f"links.only=[{{vehicle='uav_0', {only}}}]")
        changes.append(f"certificate.max_command_interval={2.0 if loss else 0.05}")
    if rng.spawn(1)[0].random() < 0.5:
        changes += ["detections.truncation=inf"]
        changes += [f"certificate.max_measurement_error={risked_error(changes)!r}"]
    high = load_scenario("town", overrides=[*changes, f"uav.0.initial_altitude={HIGHEST}"])
    floor = lowest_certified(uav_briefing(high, "uav_0", 0))
    if floor is None:
        return None
    above = min(rng.choice([0.0, 0.01, 1.0, HIGHEST]), HIGHEST - floor)
    start = load_scenario("town", overrides=[*changes, f"uav.0.initial_altitude={floor + above}"])
    return start, shapes, heights, route


def drawn_scenario(rng: np.random.Generator) -> tuple[Scenario, list[Any], list[float], Any]:
    """Return the first result of `scenario_of` that is not None."""
    return next(filter(None, (scenario_of(rng) for _ in range(1000))))


# -- adversaries


class RouteFollower:
    """Points along a closed route, in many worlds."""

    def __init__(self, ring: Any, speed: float, dt: float, rng: np.random.Generator) -> None:
        self._ring = ring
        self._along = np.zeros(WORLDS)  # speed along the route
        self._arrived = np.zeros(WORLDS, dtype=bool)
        self._s, self._turn = np.zeros(WORLDS), rng.choice([-1.0, 1.0], WORLDS)
        self._speed, self._dt, self._rng = speed, dt, rng

    def _at(self, s: Any) -> Any:
        points = shapely.line_interpolate_point(self._ring, np.mod(s, self._ring.length))
        return shapely.get_coordinates(points)

    def command(self, position: Any, velocity: Any, hides: Any) -> Any:
        """Return the accelerations of the UGVs. `hides`: function from places to True where a UGV would be hidden."""
        ahead = 1.0 + 3.0 * self._rng.random(WORLDS)
        better = hides(self._at(self._s - self._turn * ahead)) & ~hides(
            self._at(self._s + self._turn * ahead)
        )
        turns = np.where(better, 0.2, 0.01) > self._rng.random(WORLDS)
        self._turn = np.where(turns, -self._turn, self._turn)
        stands = ~self._arrived | (self._rng.random(WORLDS) < 0.05)
        change = np.where(stands, 0.0, self._turn * self._speed) - self._along
        most = 0.5 * AGILE * self._dt
        self._along += np.clip(change, -most, most)
        self._s += self._along * self._dt
        off = self._at(self._s) - position
        far = np.maximum(np.linalg.norm(off, axis=-1), 1e-12)
        self._arrived |= far < 0.01
        # slow enough to stop on its route, not beyond
        braking = np.abs(self._along) + np.sqrt(0.5 * AGILE * far)
        speed = np.minimum(np.minimum(self._speed, braking), far / self._dt)
        wanted = off * (speed / far)[:, None]
        return (wanted - velocity) / self._dt


class Pilot:
    """Nominal control of the UAVs, redrawn every second or so in each world."""

    def __init__(self, shapes: list[Any], rng: np.random.Generator, worlds: int = WORLDS) -> None:
        self._centers = shapely.get_coordinates(shapely.centroid(shapes))
        self._rng, self._worlds = rng, worlds
        self._mode, self._angle = np.zeros(worlds, int), np.zeros(worlds)
        self._climb = np.full(worlds, -1.0)

    def command(self, uav: Any, ugv: Any, velocity: Any) -> Any:
        """Return accelerations, x, y and z; the filter and the world bound them [m/s²]."""
        rng, worlds = self._rng, self._worlds
        new = rng.random(worlds) < 0.04
        self._mode = np.where(new, rng.integers(0, 4, worlds), self._mode)
        self._angle = np.where(new, rng.uniform(0.0, 2.0 * math.pi, worlds), self._angle)
        self._climb = np.where(new, rng.choice([-9.0, -9.0, 0.0, 9.0], worlds), self._climb)
        gaps = np.linalg.norm(ugv[:, None] - self._centers, axis=-1)
        behind = 2.0 * self._centers[np.argmin(gaps, axis=-1)] - ugv  # beyond the nearest building
        heading = np.select(
            [(self._mode == k)[:, None] for k in (0, 1)],
            [uav - ugv, behind - uav],
            np.stack((np.cos(self._angle), np.sin(self._angle)), axis=-1),
        )
        heading = heading / np.maximum(np.linalg.norm(heading, axis=-1, keepdims=True), 1e-9)
        level = np.where(
            (self._mode == 3)[:, None], heading * 0.3, (2.0 * heading - velocity) / 0.05
        )
        return np.concatenate((level, self._climb[:, None]), axis=-1)


# -- the judge


class Judge:
    """Visibility of the UGVs by shapely, independent of the product's geometry."""

    def __init__(self, scenario: Scenario, shapes: list[Any], heights: list[float]) -> None:
        self._shapes, self._heights = np.array(shapes, dtype=object), np.array(heights)
        self._tree = shapely.STRtree(self._shapes)
        self._marker = scenario.ugv[0].marker_height
        self._r_v, self._tangent = scenario.visibility.radius, math.tan(scenario.camera.half_angle)
        self.clearance = scenario.ugv[0].building_clearance
        self._all = shapely.union_all(self._shapes)

    def hidden(self, uav: Any, z: Any, ugv: Any) -> Any:
        """Return where a building is in between. Shape (worlds,)."""
        found = np.zeros(len(ugv), dtype=bool)
        low = self._heights.max() - self._marker, np.maximum(z - self._marker, 1e-12)
        world, k = self._tree.query(_lines(ugv, uav, np.clip(low[0] / low[1], 0.0, 1.0)))
        share = np.clip((self._heights[k] - self._marker) / low[1][world], 0.0, 1.0)
        behind = share > 0.0
        world, k, share = world[behind], k[behind], share[behind]
        lines = _lines(ugv[world], uav[world], share)
        found[world[shapely.intersects(lines, self._shapes[k])]] = True
        return found

    def sees(self, uav: Any, z: Any, ugv: Any) -> Any:
        """Return where the UGV is visible. Shape (worlds,)."""
        far = np.linalg.norm(uav - ugv, axis=-1)
        radius = np.minimum(self._r_v, (z - self._marker) * self._tangent)
        return (far < radius) & ~self.hidden(uav, z, ugv)

    def is_clear(self, ugv: Any) -> Any:
        """Return where the UGV keeps its clearance. Shape (worlds,)."""
        return shapely.distance(shapely.points(ugv), self._all) >= self.clearance

    def touches(self, uav: Any, z: Any) -> Any:
        """Return where the UAV is in a building. Shape (worlds,)."""
        found = np.zeros(len(uav), dtype=bool)
        world, k = self._tree.query(shapely.points(uav), predicate="intersects")
        found[world[z[world] < self._heights[k]]] = True
        return found


def _lines(begin: Any, end: Any, share: Any) -> Any:
    return shapely.linestrings(np.stack((begin, begin + share[:, None] * (end - begin)), axis=1))


# -- runs


def attack(seed: int, filtered: bool = True) -> Counter[str]:
    """Fly one town, and return its counts. `filtered`: inside the safety filter."""
    rng = np.random.default_rng(seed)
    scenario, shapes, heights, ring = drawn_scenario(rng)
    loop = ClosedLoop(
        scenario,
        WORLDS,
        external=["uav_0", "ugv_0"],
        safety_filter=filtered,
        estimate=True,
        end_on_sight_lost=False,
        threads=1,
    )
    loop.begin(list(range(seed * WORLDS, (seed + 1) * WORLDS)))
    vehicles, judge, pilot = loop.state.batch.vehicles, Judge(scenario, shapes, heights), None
    follower, pilot = (
        RouteFollower(ring, scenario.ugv[0].max_speed, scenario.dt, rng),
        Pilot(shapes, rng),
    )
    counts = Counter(runs=WORLDS, towns=1)
    clear, broken = np.ones(WORLDS, dtype=bool), np.zeros(WORLDS)
    lost, wrong, exceeded = np.zeros((3, WORLDS), dtype=bool)
    bound, largest = uav_briefing(scenario, "uav_0", 0).safety.max_measurement_error, 0.0
    for _ in range(round(SECONDS / scenario.dt)):
        (uav, ugv), z = (
            vehicles["position"].swapaxes(0, 1).copy(),
            vehicles["vertical"]["altitude"][:, 0].copy(),
        )
        error = np.linalg.norm(vehicles["detection"][:, 0] - (uav - ugv), axis=-1)  # NaN: none
        exceeded |= error > bound + 1e-9
        largest = max(largest, float(np.nanmax(error, initial=0.0)))
        seen = judge.sees(uav, z, ugv)
        clear &= judge.is_clear(ugv)
        velocity = vehicles["reference_velocity"]
        actions = np.zeros((WORLDS, 2, 3))
        actions[:, 0] = pilot.command(uav, ugv, velocity[:, 0])
        places = vehicles["reference_position"][:, 1]
        actions[:, 1, :2] = follower.command(
            places, velocity[:, 1], lambda at, p=uav, h=z: judge.hidden(p, h, at)
        )
        loop.step(actions)
        certified = filtered & (loop.decisions("uav_0")["reason"] == CERTIFIED)
        broken = np.where(clear, loop.metrics("uav_0")["certificate_broken"], broken)
        wrong |= certified & clear & ~seen
        lost |= ~seen
        counts["contacts"] += int(judge.touches(uav, z).sum())
        counts["ticks"] += WORLDS
        counts["certified ticks"] += int(certified.sum())
        counts["ticks behind a building"] += int(judge.hidden(uav, z, ugv).sum())
    counts["certified out of sight"] += int(wrong.sum())
    counts["certificate broken"] += int((broken > 0).sum())
    cut = scenario.detections.truncation
    counts["errors beyond the bound" if cut < math.inf else EXCEEDED] += int(exceeded.sum())
    counts[UNTRUNCATED] += WORLDS if cut == math.inf else 0
    counts["towns with errors beyond the noise at 10 m"] += (
        largest > cut * scenario.detections.noise
    )
    counts["contacts"] += int(vehicles["vertical"]["contacts"].sum())
    counts["runs that lose sight"] += int(lost.sum())
    counts["runs that break the clearance"] += int((~clear).sum())
    loop.close()
    return counts


Attack = Callable[[int, bool], Counter[str]]


def results(
    fly: Attack, seeds: range, jobs: int, filtered: bool
) -> Iterator[tuple[int, Counter[str]]]:
    """Yield the seed and the counts of each town."""
    if jobs == 1:
        yield from ((one, fly(one, filtered)) for one in seeds)
        return
    with ProcessPoolExecutor(jobs) as pool:
        yield from zip(seeds, pool.map(fly, seeds, repeat(filtered)), strict=True)


def main() -> int:
    """Attack, print the counts, and return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--runs", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--unfiltered", action="store_true")
    parser.add_argument("--takeovers", action="store_true")
    options = parser.parse_args()
    total, began, shown = Counter[str](), time.monotonic(), 0.0
    fly, worlds, first = attack, WORLDS, options.seed * 100_000
    if options.takeovers:
        from takeovers import attack as fly  # noqa: PLC0415 - compiles much

        worlds = 1
    seeds = range(first, first + -(-options.runs // worlds))
    towns = results(fly, seeds, options.jobs, not options.unfiltered)
    with suppress(KeyboardInterrupt):  # then print the counts so far
        for seed, counts in towns:
            total += counts
            for name in COUNTS:
                if counts[name]:
                    print(f"town {seed}: {name}: {counts[name]}", flush=True)
            if time.monotonic() - shown > 10.0:
                shown = time.monotonic()
                print(f"{total['runs']:,} runs in {shown - began:.0f} s", flush=True)
    for name in (*COUNTS, *(name for name in sorted(total) if name not in COUNTS)):
        print(f"{total[name]:12,}  {name}")
    expected = RISK * total[UNTRUNCATED]
    unlikely = total[EXCEEDED] > expected + SIGMAS * math.sqrt(expected)
    return 1 if unlikely or any(total[name] for name in COUNTS) else 0


if __name__ == "__main__":
    sys.exit(main())
