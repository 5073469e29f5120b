"""Tolerance of a scenario's UAVs: the largest bounds that can be certified, and the smallest changes that help.

docs/explanation/proof.md defines the bounds: A, B, tau_c, epsilon and w. Each is varied alone.
"""

import functools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import msgspec

from agents.safety.handover import certified_radius, check_assumptions
from agents.safety.levels import bounds_of
from bus.errors import ScenarioError
from bus.numbers import at_least, at_most
from outrider.running.assumptions import altitude_fault, how_certifiable
from sim.engine.briefing import uav_briefing
from sim.models.safety import SafetyBounds
from sim.scenario.checks import check_scenario
from sim.scenario.safety import largest_noise
from sim.scenario.types import Scenario
from sim.scenario.vehicle_types import Uav

_PRECISION = 2.0**-10
"""Relative precision of a search."""
_MOST = 1e4
"""Largest value that is tried [SI units]."""


_NOTHING = 1e-3
"""Number below which a limit is taken for 0 [SI units]."""


class Bound(NamedTuple):
    """Bound of `[certificate]` that a scenario declares."""

    field: str
    symbol: str
    """Letter of docs/explanation/proof.md."""
    unit: str
    meaning: str
    declared: Callable[[SafetyBounds], float]


BOUNDS = (
    Bound(
        "max_measurement_age",
        "A",
        "s",
        "age of the newest detection",
        lambda bounds: bounds.max_measurement_age,
    ),
    Bound(
        "max_command_interval",
        "B",
        "s",
        "time between two plans",
        lambda bounds: bounds.interval_ticks * bounds.dt,
    ),
    Bound(
        "max_command_delay",
        "τ_c",
        "s",
        "delay of a command",
        lambda bounds: bounds.delay_ticks * bounds.dt,
    ),
    Bound(
        "max_measurement_error",
        "ε",
        "m",
        "error of a detection",
        lambda bounds: bounds.max_measurement_error,
    ),
    Bound(
        "max_tracking_error",
        "w",
        "m",
        "tracking error of the UAV",
        lambda bounds: bounds.max_tracking_error,
    ),
)
"""Bounds on which a certificate relies."""


class Tolerance(NamedTuple):
    """Largest value of one declared bound of a UAV, the others unchanged."""

    bound: Bound
    declared: float
    largest: float | None
    """Largest value with which sight can be certified and the law still acts (r_cert >= 0); None: there is none."""
    radius: float | None
    """r_cert with this value, its price [m]."""


def bounds_with(scenario: Scenario, uav: Uav, field: str, value: float) -> SafetyBounds | None:
    """Return the safety bounds of a UAV with another declared bound; None: nothing can be certified.

    Args:
        scenario: The scenario.
        uav: The UAV.
        field: Field of `[certificate]`.
        value: Its value.
    """
    declared = msgspec.structs.replace(scenario.certificate, **{field: value})
    return certified_bounds(msgspec.structs.replace(scenario, certificate=declared), uav)


def certified_bounds(scenario: Scenario, uav: Uav) -> SafetyBounds | None:
    """Return the safety bounds of a UAV if sight can be certified with them; None: it cannot."""
    briefing = uav_briefing(scenario, uav.name, scenario.seed)
    bounds = bounds_of(briefing)
    if check_assumptions(bounds) or altitude_fault(scenario, uav, briefing):
        return None
    return bounds


def largest(
    fits: Callable[[float], bool], start: float, most: float = _MOST, precision: float = _PRECISION
) -> float | None:
    """Return the largest number up to `most` that fits, for numbers that fit from 0 up to it; None: 0 does not fit.

    Args:
        fits: Condition.
        start: Number to try first, above 0.
        most: Upper end.
        precision: Relative precision of the result, which fits.
    """
    low, high = 0.0, min(start, most)
    while fits(high):
        if high >= most:
            return most
        low, high = high, min(2.0 * high, most)
    if low == 0.0 and not fits(0.0):
        return None
    while high - low > precision * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if fits(middle) else (low, middle)
        if high < _NOTHING:
            return 0.0
    return low


@functools.lru_cache(maxsize=64)
def tolerances(scenario: Scenario, uav: Uav) -> tuple[Tolerance, ...]:
    """Return how far each declared bound of a UAV may grow, alone, while sight can be certified and r_cert >= 0."""
    declared, found = bounds_of(uav_briefing(scenario, uav.name, scenario.seed)), list[Tolerance]()
    for bound in BOUNDS:
        field, step = bound.field, scenario.dt if bound.unit == "s" else 1e-3

        def fits(value: float, field: str = field) -> bool:
            found = bounds_with(scenario, uav, field, value)
            return found is not None and certified_radius(found) >= 0.0

        now = bound.declared(declared)
        most = largest(fits, max(now, 10.0 * step) if math.isfinite(now) else 1.0)
        if most is not None:  # rounded down to whole ticks or millimetres, where it is tried again
            most = math.floor(most / step * (1.0 + 1e-9)) * step
            most = round(most, 9)
        price = None if most is None else bounds_with(scenario, uav, field, most)
        radius = None if price is None else certified_radius(price)
        found.append(Tolerance(bound, now, most if price is not None else None, radius))
    return tuple(found)


class Change(NamedTuple):
    """Smallest change of one field with which sight can be certified."""

    field: str
    value: float
    """Value that the scenario has."""
    allowed: str
    """Sufficient values, as text with their unit."""

    @property
    def line(self) -> str:
        """Change in one line."""
        return f"{self.field} = {self.value:.9g}: certifiable {self.allowed}"


class _Field(NamedTuple):
    """Field that may be changed to make a scenario certifiable."""

    path: str
    unit: str
    raise_it: bool
    """True if a greater value helps, false if a smaller one does."""


def _fields(scenario: Scenario, uav: Uav) -> Iterator[_Field]:
    """Yield the fields of which one alone may help."""
    k = scenario.uav.index(uav)
    g = next(row for row, ugv in enumerate(scenario.ugv) if ugv.name == uav.escorts)
    yield _Field(f"uav.{k}.max_speed", "m/s", True)
    yield _Field(f"uav.{k}.max_speed", "m/s", False)
    yield _Field(f"uav.{k}.max_acceleration", "m/s²", True)
    yield _Field(f"ugv.{g}.max_speed", "m/s", False)
    yield _Field("visibility.radius", "m", True)
    yield _Field("detections.noise", "m", False)
    for bound in BOUNDS:
        if getattr(scenario.certificate, bound.field) is not None:
            yield _Field(f"certificate.{bound.field}", bound.unit, False)
    if uav.initial_altitude is not None:
        yield _Field(f"uav.{k}.max_altitude", "m", True)
        yield _Field(f"uav.{k}.max_altitude", "m", False)
        yield _Field("camera.half_angle", "rad", True)
        yield _Field(f"ugv.{g}.building_clearance", "m", True)


def _value_at(scenario: Scenario, path: str) -> float | None:
    """Return the number in a field; None: it has no finite number."""
    value: object = scenario
    for part in path.split("."):
        value = value[int(part)] if isinstance(value, tuple) else getattr(value, part)
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else None


def _replaced(part: Any, path: Sequence[str], value: float) -> Any:  # noqa: ANN401 - parts of a scenario
    """Return a part of a scenario with another number at a path within it."""
    if not path:
        return value
    first, *rest = path
    if isinstance(part, tuple):
        k = int(first)
        return (*part[:k], _replaced(part[k], rest, value), *part[k + 1 :])
    changed = {first: _replaced(getattr(part, first), rest, value)}
    return msgspec.structs.replace(part, **changed)


def _certifies(scenario: Scenario, uav: Uav, path: str, value: float) -> bool:
    """Return whether a scenario with another value is valid, and sight of this UAV can be certified."""
    try:
        tried = check_scenario(_replaced(scenario, path.split("."), value))
    except ScenarioError:
        return False
    (same,) = (one for one in tried.uav if one.name == uav.name)
    return certified_bounds(tried, same) is not None


def _threshold(fits: Callable[[float], bool], now: float, *, upwards: bool) -> float | None:
    """Return the nearest number above or below `now` that fits; None: none is found within a factor of 64."""
    factor, bad, good = (1.25 if upwards else 0.8), now, now * (1.25 if upwards else 0.8)
    for _ in range(18):
        if fits(good):
            break
        bad, good = good, good * factor
    else:
        return None
    while abs(good - bad) > _PRECISION * abs(good):
        middle = 0.5 * (good + bad)
        bad, good = (bad, middle) if fits(middle) else (middle, good)
    return good


def smallest_changes(scenario: Scenario, uav: Uav) -> tuple[Change, ...]:
    """Return, for each single field that can make sight certifiable, the smallest change that does.

    Args:
        scenario: Scenario in which sight of this UAV's UGV cannot be certified.
        uav: The UAV.
    """
    found = []
    for one in _fields(scenario, uav):
        now = _value_at(scenario, one.path)
        if now is None or now == 0.0:
            continue
        fits = functools.partial(_certifies, scenario, uav, one.path)
        value = _threshold(fits, now, upwards=one.raise_it)
        if value is not None:
            shown = at_least(value, 4) if one.raise_it else at_most(value, 4)
            word = "from" if one.raise_it else "up to"
            found.append(Change(one.path, now, f"{word} {shown} {one.unit}"))
    return (*found, *_declarations(scenario, uav))


def _declarations(scenario: Scenario, uav: Uav) -> Iterator[Change]:
    """Yield the bounds that are unbounded because the scenario declares none, such as the tracking error of a body."""
    for one in tolerances(scenario, uav):
        if math.isinf(one.declared) and one.largest is not None:
            allowed = f"up to {at_most(one.largest, 4)} {one.bound.unit}"
            yield Change(f"certificate.{one.bound.field}", math.inf, allowed)


class Verdict(NamedTuple):
    """Verdict on the sight of a UAV's UGV: how often it can be certified, or the changes that would help."""

    certifiable: str
    """`always`, `not always`, `hardly ever` or `never`, as far as known in advance."""
    r_cert: float | None
    """Distance within which the law acts freely [m]; None: nothing can be certified."""
    radius: float
    """Distance within which the UAV sees the UGV, at its initial altitude [m]."""
    largest_age: float | None
    """Largest age of the newest detection with which sight can be certified [s]."""
    noise: float
    """Largest standard deviation of its detections per axis [m]."""
    noise_factor: float
    """Its ratio to `detections.noise`, which grows with altitude."""
    changes: tuple[Change, ...]
    """Smallest changes, of which each alone makes sight certifiable; empty if it is."""

    @property
    def lines(self) -> tuple[str, ...]:
        """Verdict for people, a line for each change."""
        higher = f", noise up to {self.noise:.3g} m, {self.noise_factor:.3g} times detections.noise"
        noisy = higher if self.noise_factor > 1.0 else ""
        if self.r_cert is None:
            cures = "one of these changes would do:" if self.changes else "no single change helps"
            return (
                f"sight cannot be certified{noisy}; {cures}",
                *(f"  {one.line}" for one in self.changes),
            )
        old = (
            ""
            if self.largest_age is None
            else f", measurements up to {at_most(self.largest_age, 4)} s old"
        )
        room = f"r_cert {self.r_cert:.3g} m of {self.radius:.3g} m"
        return (f"sight can {self.certifiable} be certified ({room}{old}{noisy})",)


def _seen(bounds: SafetyBounds) -> float:
    """Return the distance that r_cert is compared with [m]: both are distances of the reference plus w."""
    w = bounds.max_tracking_error
    return bounds.radius + (w if math.isfinite(w) else 0.0)


def verdict(scenario: Scenario, uav: Uav) -> Verdict:
    """Return whether sight of a UAV's UGV can be certified; if not, the search for changes takes about a second."""
    briefing = uav_briefing(scenario, uav.name, scenario.seed)
    bounds, noise = certified_bounds(scenario, uav), largest_noise(scenario, uav)
    how = how_certifiable(msgspec.structs.replace(scenario, uav=(uav,), team=None))
    ages = [one.largest for one in tolerances(scenario, uav) if one.bound.symbol == "A"]
    return Verdict(
        certifiable="never" if bounds is None else how or "always",
        r_cert=None if bounds is None else certified_radius(bounds),
        radius=_seen(bounds or bounds_of(briefing)),
        largest_age=None if bounds is None else ages[0],
        noise=noise,
        noise_factor=noise / scenario.detections.noise if scenario.detections.noise else 1.0,
        changes=smallest_changes(scenario, uav) if bounds is None else (),
    )
