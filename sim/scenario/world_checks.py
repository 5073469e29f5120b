"""Checks of area, time, vehicles and detections, one function each."""

import math
import re
from collections import Counter
from collections.abc import Callable, Iterator

import msgspec

from bus.keys import STAFF
from bus.messages.links import LinkKind
from bus.numbers import above, at_least, at_most, enough_digits, exact
from bus.registry import DEFAULT_BODY
from sim.channel.description import least_ticks, link_faults, link_parameters
from sim.input.faults import Fault, is_whole
from sim.models.inner_loop import needed_reserve, tracking_error
from sim.scenario.types import Scenario
from sim.scenario.vehicle_types import Uav, Ugv

Check = Callable[[Scenario], Iterator[Fault]]

_MOST_CELLS = 4_000_000
_MOST_TICKS = 10_000_000
_TICK = (1e-6, 1.0)
"""Shortest and longest duration of a tick dt [s]."""
_WIDEST = 1e6
"""Largest side of Q [m], limited by the coordinates in messages."""
_LARGEST_BOUND = 1e12
"""Largest finite bound in messages."""
_BOUND = re.compile(r"(uav|ugv)\.\d+\.(max_speed|max_acceleration)|detections\.truncation")
_ROUNDING = 1e-12


def vehicles(scenario: Scenario) -> Iterator[tuple[str, Uav | Ugv]]:
    """Yield every vehicle with its path."""
    yield from ((f"uav.{k}", uav) for k, uav in enumerate(scenario.uav))
    yield from ((f"ugv.{k}", ugv) for k, ugv in enumerate(scenario.ugv))


def escorts(scenario: Scenario) -> Iterator[tuple[str, Uav, Ugv]]:
    """Yield every UAV with its path and the UGV that it escorts."""
    ugvs = {ugv.name: ugv for ugv in scenario.ugv}
    for k, uav in enumerate(scenario.uav):
        if uav.escorts in ugvs:
            yield f"uav.{k}", uav, ugvs[uav.escorts]


def _floats(value: object, path: str) -> Iterator[tuple[str, float]]:
    if isinstance(value, float):
        yield path, value
    elif isinstance(value, tuple):
        for index, part in enumerate(value):
            yield from _floats(part, f"{path}.{index}")
    elif isinstance(value, dict):
        for name, part in value.items():
            yield from _floats(part, f"{path}.{name}")
    elif isinstance(value, msgspec.Struct):
        for field in value.__struct_fields__:
            yield from _floats(getattr(value, field), f"{path}.{field}" if path else field)


def numbers_are_finite(scenario: Scenario) -> Iterator[Fault]:
    """Reject NaN, and infinity except for bounds: the types accept both."""
    for path, value in _floats(scenario, ""):
        bound = _BOUND.fullmatch(path) is not None
        allowed = f"numbers up to {_LARGEST_BOUND:g}, or inf" if bound else "finite numbers"
        if math.isnan(value):
            yield Fault(path, value, "not a number", allowed)
        elif math.isinf(value) and not bound:
            yield Fault(path, value, "infinite", allowed)
        elif bound and _LARGEST_BOUND < value < math.inf:
            yield Fault(path, value, "too large", allowed)


def names_are_different(scenario: Scenario) -> Iterator[Fault]:
    """Check that vehicle names are unique and not reserved."""
    taken = [*STAFF]
    for path, vehicle in vehicles(scenario):
        if vehicle.name in taken:
            allowed = f"any other than {', '.join(taken)}"
            yield Fault(f"{path}.name", vehicle.name, "the name is taken", allowed)
        taken.append(vehicle.name)


def escorts_are_there(scenario: Scenario) -> Iterator[Fault]:
    """Check that each UAV escorts a UGV of the scenario."""
    names = [ugv.name for ugv in scenario.ugv]
    for k, uav in enumerate(scenario.uav):
        if uav.escorts not in names:
            yield Fault(f"uav.{k}.escorts", uav.escorts, "no UGV has this name", ", ".join(names))


def grid_divides_area(scenario: Scenario) -> Iterator[Fault]:
    """Check that the cells divide the area, and are not too many."""
    cell = scenario.area.cell
    for side, size in (("width", scenario.area.width), ("height", scenario.area.height)):
        if size > _WIDEST:
            yield Fault(f"area.{side}", size, "too large", f"up to {_WIDEST:g} m")
        if not is_whole(size / cell, 1e-9 * max(1.0, size / cell)):
            yield Fault(
                "area.cell",
                cell,
                f"does not divide area.{side} = {exact(size)} m",
                "a divisor of both sides, in m",
            )
    cells = (scenario.area.width / cell) * (scenario.area.height / cell)
    if cells > _MOST_CELLS:
        least = math.sqrt(scenario.area.width) * math.sqrt(scenario.area.height / _MOST_CELLS)
        yield Fault(
            "area.cell",
            cell,
            f"makes {above(cells, _MOST_CELLS, 3)} cells, more than {_MOST_CELLS:,}",
            f"{at_least(least, 3)} m or more",
        )


def time_is_whole(scenario: Scenario) -> Iterator[Fault]:
    """Check that the duration is a whole number of ticks, that dt is in range, and that ticks are not too many."""
    if not _TICK[0] <= scenario.dt <= _TICK[1]:
        yield Fault("dt", scenario.dt, "out of range", f"{_TICK[0]:g} to {_TICK[1]:g} s")
        return
    ticks = scenario.duration / scenario.dt
    if ticks > _MOST_TICKS:
        yield Fault(
            "duration",
            scenario.duration,
            f"makes {above(ticks, _MOST_TICKS, 3)} ticks",
            f"{_MOST_TICKS:,} ticks at most, {at_most(_MOST_TICKS * scenario.dt)} s",
        )
    elif not is_whole(ticks, 1e-6):
        dt, near = scenario.dt, max(1, round(ticks)) * scenario.dt
        fitting = enough_digits(near, lambda duration: is_whole(duration / dt, 1e-6))
        yield Fault(
            "duration",
            scenario.duration,
            "not a whole number of ticks",
            f"multiples of dt = {exact(dt)} s, such as {fitting}",
        )


def rates_fit_ticks(scenario: Scenario) -> Iterator[Fault]:
    """Check that the periods of detector and ground sensor are whole numbers of ticks."""
    rates = {"detections.rate": scenario.detections.rate}
    if scenario.has_ground:
        rates["ground.rate"] = scenario.ground.rate
    for field, rate in rates.items():
        per_tick = rate * scenario.dt
        period = 1.0 / per_tick if per_tick > 0.0 else math.inf
        if period > _MOST_TICKS or not is_whole(period, 1e-6):
            some = ", ".join(_rate(n, scenario.dt) for n in (1, 2, 3))
            wrong = "the period is not a whole number of ticks"
            yield Fault(field, rate, wrong, f"{some}, ... 1/s")


def _rate(ticks: int, dt: float) -> str:
    """Return the rate of a period of this number of ticks as text [1/s]."""
    return enough_digits(1.0 / (ticks * dt), lambda rate: is_whole(1.0 / (rate * dt), 1e-6), 4)


def sight_is_within_range(scenario: Scenario) -> Iterator[Fault]:
    """Check that the sensor's range exceeds r_v, Klodt 2015, eq. (5): r_v < r."""
    if scenario.visibility.radius >= scenario.sensor.range:
        allowed = f"less than sensor.range = {exact(scenario.sensor.range)} m"
        yield Fault(
            "visibility.radius", scenario.visibility.radius, "r_v < r does not hold (5)", allowed
        )


def points_are_inside(scenario: Scenario) -> Iterator[Fault]:
    """Check that vehicles and goals lie in Q."""
    points = [(f"{path}.position", vehicle.position) for path, vehicle in vehicles(scenario)]
    points += [
        (f"ugv.{k}.goals.{i}", goal)
        for k, ugv in enumerate(scenario.ugv)
        for i, goal in enumerate(ugv.goals)
    ]
    for path, (x, y) in points:
        if not (0.0 <= x <= scenario.area.width and 0.0 <= y <= scenario.area.height):
            yield Fault(
                path,
                [x, y],
                "outside Q",
                f"[0, {exact(scenario.area.width)}] x [0, {exact(scenario.area.height)}] m",
            )


def covered_is_inside(scenario: Scenario) -> Iterator[Fault]:
    """Check that covered rectangles are not empty, and lie in Q."""
    for k, region in enumerate(scenario.coverage.covered):
        for axis, letter, size in ((0, "x", scenario.area.width), (1, "y", scenario.area.height)):
            low, high = region.lower[axis], region.upper[axis]
            path, allowed = f"coverage.covered.{k}", f"{letter} from 0 to {exact(size)} m"
            if low >= high:
                yield Fault(
                    f"{path}.upper.{axis}",
                    high,
                    "not above the lower corner",
                    f"more than {exact(low)} m",
                )
            if low < 0.0:
                yield Fault(f"{path}.lower.{axis}", low, "outside Q", allowed)
            if high > size:
                yield Fault(f"{path}.upper.{axis}", high, "outside Q", allowed)


def starts_are_within_bounds(scenario: Scenario) -> Iterator[Fault]:
    """Check that initial speeds are within the bounds."""
    for path, vehicle in vehicles(scenario):
        speed = math.hypot(*vehicle.velocity)
        if speed > vehicle.max_speed * (1.0 + _ROUNDING):
            allowed = f"up to {path}.max_speed = {exact(vehicle.max_speed)} m/s"
            yield Fault(
                f"{path}.velocity",
                vehicle.velocity,
                f"a speed of {above(speed, vehicle.max_speed)} m/s",
                allowed,
            )


def uav_is_stronger(scenario: Scenario) -> Iterator[Fault]:
    """Check that the UAV is faster and accelerates more than the UGV (section II of the paper)."""
    for path, uav, ugv in escorts(scenario):
        for field, unit in (("max_speed", "m/s"), ("max_acceleration", "m/s²")):
            mine, its = getattr(uav, field), getattr(ugv, field)
            if mine <= its:
                yield Fault(
                    f"{path}.{field}",
                    mine,
                    f"not above the UGV {ugv.name}",
                    f"above {exact(its)} {unit}",
                )


def ugv_is_seen_at_start(scenario: Scenario) -> Iterator[Fault]:
    """Check the visibility constraint at the start (Proposition 2 of the paper); in a team, for its g nearest UAVs."""
    radius, seen = scenario.visibility.radius, Counter[str]()
    pairs = [
        (math.dist(uav.position, ugv.position), path, uav, ugv)
        for path, uav, ugv in escorts(scenario)
    ]
    for distance, path, uav, ugv in sorted(pairs, key=lambda pair: pair[:2]):
        needed = scenario.team is None or seen[ugv.name] < scenario.team.guards
        seen[ugv.name] += 1
        if distance >= radius and needed:
            allowed = f"nearer than visibility.radius = {exact(radius)} m"
            yield Fault(
                f"{path}.position",
                uav.position,
                f"{above(distance, radius)} m from {ugv.name} at the start",
                allowed,
            )


def wind_is_possible(scenario: Scenario) -> Iterator[Fault]:
    """Check that the wind's mean is within its limit."""
    mean, limit = math.hypot(*scenario.wind.mean), scenario.wind.limit
    if limit is not None and mean > limit * (1.0 + _ROUNDING):
        allowed = f"up to wind.limit = {exact(limit)} m/s²"
        wrong = f"an acceleration of {above(mean, limit)} m/s²"
        yield Fault("wind.mean", scenario.wind.mean, wrong, allowed)


def inner_loops_resist(scenario: Scenario) -> Iterator[Fault]:
    r"""Check that the inner loop of a disturbed UAV is stable at dt and has enough acceleration.

    $z^2 - (2 - k_d dt - k_p dt^2 / 2) z + 1 - k_d dt + k_p dt^2 / 2$ has its roots within the unit circle if $k_d dt <
    2$ and $k_p dt < 2 k_d$, by Jury's criterion.
    """
    for k, uav in enumerate(scenario.uav):
        path, loop, wind = f"uav.{k}.tracking", uav.tracking, scenario.wind.largest
        k_p, k_d = loop.position_gain, loop.velocity_gain
        if uav.body != DEFAULT_BODY or (wind == 0.0 and uav.position_error == 0.0):
            continue
        unstable = f"the inner loop is unstable at dt = {exact(scenario.dt)} s"
        needed = needed_reserve(loop, wind, uav.position_error, scenario.dt)
        if k_d * scenario.dt >= 2.0:
            yield Fault(
                f"{path}.velocity_gain",
                k_d,
                unstable,
                f"less than {at_most(2.0 / scenario.dt)} 1/s",
            )
        elif k_p * scenario.dt >= 2.0 * k_d:
            limit = f"less than 2 velocity_gain / dt = {at_most(2.0 * k_d / scenario.dt)} 1/s²"
            yield Fault(f"{path}.position_gain", k_p, unstable, limit)
        elif math.isinf(needed):
            yield Fault(f"{path}.position_gain", k_p, "the inner loop is too slow", "larger ones")
        elif math.isinf(tracking_error(loop, wind, uav.position_error, scenario.dt)):
            wrong = f"cannot hold a wind of {exact(wind)} m/s² and a position_error of {exact(uav.position_error)} m"
            allowed = f"{needed + 5e-4:.3f} m/s² or more"
            yield Fault(f"{path}.reserve", loop.reserve, wrong, allowed)


def links_are_possible(scenario: Scenario) -> Iterator[Fault]:
    """Check that each link is valid and belongs to a vehicle."""
    names, traces = [vehicle.name for _, vehicle in vehicles(scenario)], scenario.links.traces
    for kind in LinkKind:
        yield from link_faults(getattr(scenario.links, kind), f"links.{kind}.", traces)
    for k, own in enumerate(scenario.links.only):
        if own.vehicle not in names:
            yield Fault(
                f"links.only.{k}.vehicle", own.vehicle, "no vehicle has this name", ", ".join(names)
            )
        for kind in LinkKind:
            yield from link_faults(getattr(own, kind), f"links.only.{k}.{kind}.", traces)


def _time_from(ticks: int, dt: float) -> str:
    """Return the time of a number of ticks as text, not rounded to fewer ticks [s]."""
    return enough_digits(ticks * dt, lambda time: round(time / dt) >= ticks)


def commands_act(scenario: Scenario) -> Iterator[Fault]:
    """Check that commands do not arrive after the command timeout: else the vehicle would always brake."""
    for _, vehicle in vehicles(scenario):
        commands = scenario.links.of(vehicle.name, LinkKind.COMMANDS)
        least = least_ticks(link_parameters(commands, scenario.dt, traces=scenario.links.traces))
        if least > round(scenario.command_timeout / scenario.dt):
            path = f"{scenario.links.path_of(vehicle.name, LinkKind.COMMANDS)} of {vehicle.name}"
            age = f"{_time_from(least, scenario.dt)} s"
            wrong = (
                f"commands are {age} old or more on arrival ({path}), "
                "so that the vehicle would always brake"
            )
            yield Fault("command_timeout", scenario.command_timeout, wrong, f"{age} or more")


WORLD_CHECKS: tuple[Check, ...] = (
    grid_divides_area,
    time_is_whole,
    rates_fit_ticks,
    sight_is_within_range,
    points_are_inside,
    covered_is_inside,
    starts_are_within_bounds,
    uav_is_stronger,
    ugv_is_seen_at_start,
    wind_is_possible,
    inner_loops_resist,
    links_are_possible,
    commands_act,
)
"""Checks in order, after those of numbers and names."""
