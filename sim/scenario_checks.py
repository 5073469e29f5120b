"""What makes a scenario impossible, or unlike what one may expect: one small check for each."""

import math
import re
from collections.abc import Callable, Iterator

import msgspec

from bus.errors import ScenarioError
from sim.field import SENSORS
from sim.scenario import Scenario, Uav, Ugv
from sim.vehicles import stopping_distance

LAW_NAMES = ("tracking", "coverage", "linear", "switching", "logarithmic", "circle", "weighted", "path")
"""The laws; a test holds them equal to the agents' table, which the simulator may not import."""
DRIVER_NAMES = ("waypoints",)
"""The drivers; likewise."""
FREE_LAWS = ("tracking", "coverage")
"""Laws that never ask for r_s."""
_MOST_CELLS = 4_000_000
_MOST_TICKS = 10_000_000
_LONGEST_TICK = 1.0
_WHOLE = 1e-6
_INFINITE = re.compile(r"^(uav|ugv)\.\d+\.(max_speed|max_acceleration)$")
_FUNCTION = re.compile(r"^[A-Za-z_][\w.]*:[A-Za-z_]\w*$")

Fault = tuple[str, object, str]
"""A field, its value, and what is wrong and allowed."""
Check = Callable[[Scenario], Iterator[Fault]]


def _is_whole(number: float) -> bool:
    return abs(number - round(number)) <= _WHOLE


def _escorts(scenario: Scenario) -> Iterator[tuple[int, Uav, Ugv]]:
    ugvs = {ugv.name: ugv for ugv in scenario.ugv}
    for index, uav in enumerate(scenario.uav):
        if uav.escorts in ugvs:
            yield index, uav, ugvs[uav.escorts]


def _vehicles(scenario: Scenario) -> Iterator[tuple[str, Uav | Ugv]]:
    yield from ((f"uav.{k}", uav) for k, uav in enumerate(scenario.uav))
    yield from ((f"ugv.{k}", ugv) for k, ugv in enumerate(scenario.ugv))


def _floats(value: object, path: str) -> Iterator[tuple[str, float]]:
    if isinstance(value, float):
        yield path, value
    elif isinstance(value, tuple):
        for index, part in enumerate(value):
            yield from _floats(part, f"{path}.{index}")
    elif isinstance(value, msgspec.Struct):
        for field in value.__struct_fields__:
            yield from _floats(getattr(value, field), f"{path}.{field}" if path else field)


def numbers_are_finite(s: Scenario) -> Iterator[Fault]:
    """NaN nowhere, infinity only as a vehicle's bound."""
    for path, value in _floats(s, ""):
        if math.isnan(value) or (math.isinf(value) and not _INFINITE.match(path)):
            yield path, value, "allowed are finite numbers"


def names_are_different(s: Scenario) -> Iterator[Fault]:
    """Each vehicle has a name of its own."""
    seen = {"simulator"}
    for path, vehicle in _vehicles(s):
        if vehicle.name in seen:
            yield f"{path}.name", vehicle.name, "taken; every vehicle has a name of its own, and none is 'simulator'"
        seen.add(vehicle.name)


def escorts_are_there(s: Scenario) -> Iterator[Fault]:
    """Each UAV escorts a UGV of the scenario."""
    names = [ugv.name for ugv in s.ugv]
    for k, uav in enumerate(s.uav):
        if uav.escorts not in names:
            yield f"uav.{k}.escorts", uav.escorts, f"no such UGV; allowed: {', '.join(names)}"


def grid_divides_area(s: Scenario) -> Iterator[Fault]:
    """A whole number of cells, and not too many."""
    for side in ("width", "height"):
        size = getattr(s.area, side)
        if not _is_whole(size / s.area.cell):
            yield "area.cell", s.area.cell, f"does not divide area.{side} = {size:g} m; allowed are whole parts of it"
    cells = (s.area.width / s.area.cell) * (s.area.height / s.area.cell)
    if cells > _MOST_CELLS:
        yield "area.cell", s.area.cell, f"makes {cells:.3g} cells; allowed up to {_MOST_CELLS:,}"


def time_is_whole(s: Scenario) -> Iterator[Fault]:
    """A whole number of ticks, and not too many."""
    if s.dt > _LONGEST_TICK:
        yield "dt", s.dt, f"allowed up to {_LONGEST_TICK:g} s"
    if not _is_whole(s.duration / s.dt) or s.ticks < 1:
        yield "duration", s.duration, f"no whole number of ticks of dt = {s.dt:g} s; allowed are multiples of it"
    if s.duration / s.dt > _MOST_TICKS:
        yield "duration", s.duration, f"makes {s.duration / s.dt:.3g} ticks; allowed up to {_MOST_TICKS:,}"


def looks_fit_ticks(s: Scenario) -> Iterator[Fault]:
    """A whole number of ticks between two looks."""
    period = 1.0 / (s.detections.rate * s.dt)
    if not _is_whole(period) or period < 1.0 - _WHOLE:
        yield (
            "detections.rate",
            s.detections.rate,
            f"allowed are 1/(n dt) with n = 1, 2, ...: {1.0 / s.dt:g}, {0.5 / s.dt:g}, ... 1/s",
        )


def sight_is_within_range(s: Scenario) -> Iterator[Fault]:
    """(5): r_v < r."""
    if s.visibility.radius >= s.sensor.range:
        yield "visibility.radius", s.visibility.radius, f"allowed: less than the sensor's range r = {s.sensor.range:g} m (5)"


def vehicles_are_inside(s: Scenario) -> Iterator[Fault]:
    """Vehicles and goals in Q."""
    points = [(f"{path}.position", vehicle.position) for path, vehicle in _vehicles(s)]
    points += [(f"ugv.{k}.goals.{i}", goal) for k, ugv in enumerate(s.ugv) for i, goal in enumerate(ugv.goals)]
    for path, (x, y) in points:
        if not (0.0 <= x <= s.area.width and 0.0 <= y <= s.area.height):
            yield path, [x, y], f"outside Q; allowed: [0, {s.area.width:g}] x [0, {s.area.height:g}] m"


def covered_is_inside(s: Scenario) -> Iterator[Fault]:
    """Covered rectangles have an inside, in Q."""
    for k, region in enumerate(s.coverage.covered):
        (x_0, y_0), (x_1, y_1) = region.lower, region.upper
        if not (0.0 <= x_0 < x_1 <= s.area.width and 0.0 <= y_0 < y_1 <= s.area.height):
            yield f"coverage.covered.{k}", [[x_0, y_0], [x_1, y_1]], "allowed: lower < upper on both axes, inside Q"


def speeds_are_within_bounds(s: Scenario) -> Iterator[Fault]:
    """Nobody starts faster than it may fly."""
    for path, vehicle in _vehicles(s):
        if math.hypot(*vehicle.velocity) > vehicle.max_speed:
            yield f"{path}.velocity", list(vehicle.velocity), f"allowed up to max_speed = {vehicle.max_speed:g} m/s"


def uav_is_faster(s: Scenario) -> Iterator[Fault]:
    """Section II: v_a > v_g, u_a > u_g."""
    for k, uav, ugv in _escorts(s):
        if uav.max_speed <= ugv.max_speed:
            yield f"uav.{k}.max_speed", uav.max_speed, f"allowed: more than the UGV's {ugv.max_speed:g} m/s"
        if uav.max_acceleration <= ugv.max_acceleration:
            yield f"uav.{k}.max_acceleration", uav.max_acceleration, f"allowed: more than the UGV's {ugv.max_acceleration:g} m/s²"


def ugv_is_seen_at_start(s: Scenario) -> Iterator[Fault]:
    """Proposition 2, condition 1."""
    for k, uav, ugv in _escorts(s):
        distance = math.dist(uav.position, ugv.position)
        if distance >= s.visibility.radius:
            yield (
                f"uav.{k}.position",
                list(uav.position),
                f"{distance:.4g} m from {ugv.name}; allowed: less than r_v = {s.visibility.radius:g} m",
            )


def switching_radius_is_positive(s: Scenario) -> Iterator[Fault]:
    """(18) leaves room for coverage."""
    if s.law.name in FREE_LAWS:
        return
    for k, uav, ugv in _escorts(s):
        r_s = s.visibility.radius - stopping_distance(uav.max_speed + ugv.max_speed, uav.max_acceleration)
        if not r_s > 0.0:
            yield (
                f"uav.{k}.max_acceleration",
                uav.max_acceleration,
                f"gives r_s = {r_s:.4g} m (18); r_s must be positive: allowed is more acceleration, or less speed",
            )


def law_is_known(s: Scenario) -> Iterator[Fault]:
    """Law, sensor and driver are in their tables, and the user's functions are named."""
    if s.law.name not in LAW_NAMES:
        yield "law.name", s.law.name, f"unknown; allowed: {', '.join(LAW_NAMES)}"
    if s.sensor.model not in SENSORS:
        yield "sensor.model", s.sensor.model, f"unknown; allowed: {', '.join(SENSORS)}"
    for k, ugv in enumerate(s.ugv):
        if ugv.driver not in DRIVER_NAMES:
            yield f"ugv.{k}.driver", ugv.driver, f"unknown; allowed: {', '.join(DRIVER_NAMES)}"
    for law, field in (("weighted", "weighting"), ("path", "path")):
        named = getattr(s.custom, field)
        if s.law.name == law and not named:
            yield f"custom.{field}", named, f"the law {law!r} needs it; allowed: module:function"
        elif named and not _FUNCTION.match(named):
            yield f"custom.{field}", named, "allowed: module:function"


def reference_speed_is_possible(s: Scenario) -> Iterator[Fault]:
    """v_ref <= v_a,max, and there is one."""
    for k, uav in enumerate(s.uav):
        if s.law.reference_speed is None and math.isinf(uav.max_speed):
            yield "law.reference_speed", None, f"needed, since uav.{k}.max_speed has no bound"
        elif s.law.reference_speed is not None and s.law.reference_speed > uav.max_speed:
            yield "law.reference_speed", s.law.reference_speed, f"allowed up to uav.{k}.max_speed = {uav.max_speed:g} m/s"


def controller_is_stable(s: Scenario) -> Iterator[Fault]:
    """The closed loop of (15) and (16), s³ - A s² - D s + (D A - B C), is Hurwitz."""
    a, b, c, d = s.law.a_c, s.law.b_c, s.law.c_c, s.law.d_c
    last = d * a - b * c
    if not (a < 0.0 and d < 0.0 and last > 0.0 and a * d > last):
        yield "law.a_c, b_c, c_c, d_c", [a, b, c, d], "the tracking loop is unstable; allowed: A < 0, D < 0, 0 < D A - B C < A D"


def circle_is_within_sight(s: Scenario) -> Iterator[Fault]:
    """(20): ‖p_v‖ < r_v."""
    radius = s.law.circle_radius
    if radius is not None and radius >= s.visibility.radius:
        yield "law.circle_radius", radius, f"allowed: less than r_v = {s.visibility.radius:g} m"


CHECKS: tuple[Check, ...] = (
    numbers_are_finite,
    names_are_different,
    escorts_are_there,
    grid_divides_area,
    time_is_whole,
    looks_fit_ticks,
    sight_is_within_range,
    vehicles_are_inside,
    covered_is_inside,
    speeds_are_within_bounds,
    uav_is_faster,
    ugv_is_seen_at_start,
    law_is_known,
    switching_radius_is_positive,
    reference_speed_is_possible,
    controller_is_stable,
    circle_is_within_sight,
)


def check_scenario(scenario: Scenario, *, source: str = "") -> Scenario:
    """The scenario itself, if it can be flown.

    Args:
        scenario: Made by hand or read from a file.
        source: The file, for the error.

    Raises:
        ScenarioError: One line with file, field, value and what is allowed.
    """
    for check in CHECKS:
        for field, value, wrong in check(scenario):
            raise ScenarioError(f"{source or scenario.name or 'scenario'}: {field} = {value!r}: {wrong}")
    return scenario


def scenario_warnings(scenario: Scenario) -> tuple[str, ...]:
    """What can be flown but will not do what one may expect, a line each."""
    return tuple(line for warn in (_circle_warnings, _law_warnings, _goal_warnings) for line in warn(scenario))


def _circle_warnings(s: Scenario) -> Iterator[str]:
    if s.law.name != "circle":
        return
    for _, uav, ugv in _escorts(s):
        r_s = s.visibility.radius - stopping_distance(uav.max_speed + ugv.max_speed, uav.max_acceleration)
        radius = s.law.circle_radius or r_s
        rate = abs(s.law.circle_rate)
        bound = min((uav.max_speed - ugv.max_speed) / radius, math.sqrt(uav.max_acceleration / radius))
        if rate > bound:
            needs = f"needs {radius * rate:.3g} m/s beside the UGV's {ugv.max_speed:g} m/s and {radius * rate**2:.3g} m/s²"
            yield (
                f"law.circle_rate = {s.law.circle_rate:g}: cannot be flown: {needs} of a vehicle with {uav.max_speed:g} m/s "
                f"and {uav.max_acceleration:g} m/s²; allowed up to (v_a - v_g)/r_pv and sqrt(u_a/r_pv): {bound:.4f} rad/s"
            )


def _law_warnings(s: Scenario) -> Iterator[str]:
    if s.law.name == "coverage":
        yield "law.name = 'coverage': coverage alone does not keep the UGV in sight"


def _goal_warnings(s: Scenario) -> Iterator[str]:
    for k, ugv in enumerate(s.ugv):
        if ugv.driver == "waypoints" and not ugv.goals:
            yield f"ugv.{k}.goals: none, so {ugv.name} will stand still"
