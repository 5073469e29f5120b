"""Control laws of a scenario's UAVs, and the checks of their names and parameters."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import msgspec

from bus.law_parameters import (
    law_parameters,
    own_parameters,
    parameter_names,
    unknown_parameters,
)
from bus.messages.scenario import Law
from bus.numbers import above, at_least, at_most, exact
from bus.registry import LAWS
from sim.input.faults import Fault, near, unknown_name
from sim.input.reading import type_fault
from sim.scenario.types import Scenario, switching_radius
from sim.scenario.vehicle_types import Uav, Ugv
from sim.scenario.world_checks import escorts

_ROUNDING = 1e-9


def law_title(scenario: Scenario) -> str:
    """Return the names of the laws that the UAVs fly, such as `certified, uav_1 lookahead`."""
    names = {uav.name: scenario.law_of(uav).name for uav in scenario.uav}
    common = scenario.law.name
    shown = [common] if common in names.values() or not names else []
    return ", ".join([*shown, *(f"{uav} {name}" for uav, name in names.items() if name != common)])


def with_law(scenario: Scenario, law: Law) -> Scenario:
    """Return the scenario with the same law for all UAVs."""
    uavs = tuple(msgspec.structs.replace(uav, law=None) for uav in scenario.uav)
    return msgspec.structs.replace(scenario, law=law, uav=uavs)


class _Flown(NamedTuple):
    """A law and the UAVs that fly it."""

    path: str
    """Field of the law, `law` or `uav.k.law`."""
    law: Law
    escorts: tuple[tuple[str, Uav, Ugv], ...]
    """Path of each UAV, the UAV and its UGV."""


def _flown(scenario: Scenario) -> Iterator[_Flown]:
    """Yield the scenario's law, then each UAV's own."""
    rows = tuple(escorts(scenario))
    yield _Flown("law", scenario.law, tuple(row for row in rows if row[1].law is None))
    for row in rows:
        if row[1].law is not None:
            yield _Flown(f"{row[0]}.law", scenario.law_of(row[1]), (row,))


def laws_are_known(scenario: Scenario) -> Iterator[Fault]:
    """Check that the laws are registered."""
    yield from unknown_name("law.name", scenario.law.name, LAWS)
    for k, uav in enumerate(scenario.uav):
        if uav.law is not None and uav.law.name is not None:
            yield from unknown_name(f"uav.{k}.law.name", uav.law.name, LAWS)


def law_parameters_are_possible(scenario: Scenario) -> Iterator[Fault]:
    """Check that each parameter belongs to a law; a flown law's parameters must have valid types and values."""
    for path, law, _ in _flown(scenario):
        parameters, own = f"{path}.parameters", parameter_names(law.name)
        for name in unknown_parameters(law):
            wrong = f"unknown parameter{near(name, own)}"
            allowed = ", ".join(own) or "none"
            yield Fault(f"{parameters}.{name}", law.parameters[name], wrong, allowed)
        fault = type_fault(dict(own_parameters(law)), LAWS[law.name].parameters)
        if fault is not None:
            yield fault._replace(field=f"{parameters}.{fault.field}".rstrip("."))


def _slower(scenario: Scenario, path: str, uav: Uav, ugv: Ugv) -> str:
    """Return the speed up to which the UAV's acceleration would do, as the end of a sentence; empty: there is none."""
    most = math.sqrt(2.0 * scenario.visibility.radius * uav.max_acceleration) - ugv.max_speed
    return f", or {path}.max_speed below {at_most(most, 4)} m/s" if most > ugv.max_speed else ""


def switching_radius_is_positive(scenario: Scenario) -> Iterator[Fault]:
    """Check that r_s > 0, so that there is room for coverage, Klodt 2015, eq. (18)."""
    for path, uav, ugv in escorts(scenario):
        if not LAWS[scenario.law_of(uav).name].needs_radius:
            continue
        r_s = switching_radius(scenario, uav, ugv)
        if r_s == -math.inf:
            wrong = "r_s of (18) is undefined for an unbounded speed"
            yield Fault(
                f"{path}.max_speed",
                uav.max_speed,
                wrong,
                "finite speeds, or also max_acceleration = inf",
            )
        elif not r_s > 0.0:
            least = (uav.max_speed + ugv.max_speed) ** 2 / (2.0 * scenario.visibility.radius)
            wrong = f"too weak for these speeds and this r_v: r_s = {r_s:.4g} m (18)"
            yield Fault(
                f"{path}.max_acceleration",
                uav.max_acceleration,
                wrong,
                f"above {at_least(least, 4)} m/s²{_slower(scenario, path, uav, ugv)}",
            )


def reference_speed_is_possible(scenario: Scenario) -> Iterator[Fault]:
    """Check that v_ref of (10) exists, and that every UAV can fly it."""
    for path, law, flying in _flown(scenario):
        v_ref = getattr(law_parameters(law), "reference_speed", None)
        if v_ref is None:
            continue
        field = f"{path}.parameters.reference_speed"
        for uav_path, uav, _ in flying:
            if math.isinf(v_ref) and math.isinf(uav.max_speed):
                yield Fault(
                    field,
                    None,
                    f"missing, and {uav_path}.max_speed = inf gives no default",
                    "a number > 0, in m/s",
                )
            elif math.isfinite(v_ref) and v_ref > uav.max_speed:
                allowed = f"up to {uav_path}.max_speed = {exact(uav.max_speed)} m/s"
                yield Fault(field, v_ref, "faster than the UAV can fly", allowed)


def controller_is_stable(scenario: Scenario) -> Iterator[Fault]:
    r"""Check that the tracking loop of (15) and (16) is Hurwitz in continuous time.

    $$ s^3 - A_c s^2 - D_c s + (D_c A_c - B_c C_c) $$

    By Routh: all coefficients positive, and A_c D_c > D_c A_c - B_c C_c. The default is (s + 1)³.
    """
    for path, law, _ in _flown(scenario):
        parameters = law_parameters(law)
        if not hasattr(parameters, "a_c"):
            continue
        a, b, c, d = parameters.a_c, parameters.b_c, parameters.c_c, parameters.d_c
        last = d * a - b * c
        if not (a < 0.0 and d < 0.0 and last > 0.0 and a * d > last):
            value = {"a_c": a, "b_c": b, "c_c": c, "d_c": d}
            yield Fault(
                f"{path}.parameters",
                value,
                "the tracking loop (15), (16) is unstable",
                "A < 0, D < 0, 0 < D A - B C < A D",
            )


def circle_is_within_sight(scenario: Scenario) -> Iterator[Fault]:
    """Check that the virtual point of (25) is always nearer than r_v."""
    for law_path, law, flying in _flown(scenario):
        if law.name != "circle":
            continue
        r_v, radius = scenario.visibility.radius, law_parameters(law).circle_radius
        field, allowed = f"{law_path}.parameters.circle_radius", f"less than r_v = {exact(r_v)} m"
        for path, uav, ugv in flying:
            if math.isfinite(radius) and radius >= r_v:
                yield Fault(field, radius, "the circle is out of sight", allowed)
            elif math.isinf(radius) and switching_radius(scenario, uav, ugv) >= r_v:
                wrong = f"missing, and r_s = r_v since {path}.max_acceleration = inf"
                yield Fault(field, None, wrong, allowed)


LAW_CHECKS = (
    switching_radius_is_positive,
    reference_speed_is_possible,
    controller_is_stable,
    circle_is_within_sight,
)
"""Checks in order, after the checks of names and parameters."""


def law_warnings(scenario: Scenario) -> Iterator[str]:
    """Warn of laws that never return to the UGV."""
    for path, law, flying in _flown(scenario):
        if flying and not LAWS[law.name].keeps_sight:
            name = f'{path}.name = "{law.name}"'
            yield f"{name}: visibility is not maintained: this law never returns to the UGV"


def largest_circle_rate(r_pv: float, v_a: float, v_g: float, u_a: float) -> float:
    r"""Return the largest $|\omega|$ [rad/s] at which a UAV can circle around any UGV (Remark 3 of the paper).

    The UAV needs the speed $r_{pv}\omega + v_g \le v_a$ and the acceleration $r_{pv}\omega^2 \le u_a$.

    Args:
        r_pv: Radius [m].
        v_a: Maximum speed of the UAV [m/s].
        v_g: Maximum speed of the UGV [m/s].
        u_a: Maximum acceleration of the UAV [m/s²].
    """
    return min((v_a - v_g) / r_pv, math.sqrt(u_a / r_pv))


def circle_warnings(scenario: Scenario) -> Iterator[str]:
    """Warn of a circle that cannot be flown; see `largest_circle_rate`."""
    for path, law, flying in _flown(scenario):
        if law.name != "circle":
            continue
        parameters = law_parameters(law)
        rate = abs(parameters.circle_rate)
        for _, uav, ugv in flying:
            radius = parameters.circle_radius
            if math.isinf(radius):
                radius = switching_radius(scenario, uav, ugv)
            spare = uav.max_speed - ugv.max_speed
            bound = largest_circle_rate(radius, uav.max_speed, ugv.max_speed, uav.max_acceleration)
            if rate > bound * (1.0 + _ROUNDING):
                speed = above(radius * rate, spare, 3)
                needed = above(radius * rate * rate, uav.max_acceleration, 3)
                needs = f"needs {speed} m/s and {needed} m/s² of {uav.name}"
                has = (
                    f"which relative to {ugv.name} has v_a - v_g = {spare:.6g} m/s "
                    f"and u_a = {exact(uav.max_acceleration)} m/s²"
                )
                reason = (
                    f"the smaller of (v_a - v_g)/r_pv and sqrt(u_a/r_pv), r_pv = {radius:.4g} m"
                )
                field = f"{path}.parameters.circle_rate = {parameters.circle_rate}"
                allowed = f"allowed up to {at_most(bound, 4)} rad/s, {reason}"
                yield f"{field}: cannot be flown: {needs}, {has}; {allowed}"
