"""Checks of scenarios: errors for impossible ones, and warnings for surprising ones."""

import math
from collections.abc import Iterator
from itertools import pairwise

from bus.law_parameters import (
    law_parameters,
    own_parameters,
    parameter_names,
    unknown_parameters,
)
from bus.numbers import above, at_least, at_most, exact
from bus.policies import Vehicle, is_policy_file, policy_forms
from bus.registry import (
    DRIVERS,
    LAWS,
    SENSORS,
)
from sim.input.faults import Fault, near, one_line, unknown_name
from sim.input.reading import as_raw, type_fault, typed
from sim.scenario.building_checks import BUILDING_CHECKS, building_warnings
from sim.scenario.ground_checks import GROUND_CHECKS, hazard_warnings
from sim.scenario.team import endurances_suffice, teams_are_possible, watch_warnings
from sim.scenario.types import Scenario, switching_radius
from sim.scenario.world_checks import WORLD_CHECKS, Check, escorts

_ENTRIES = {
    "script": "steps such as { time = 0.0, velocity = [0.2, 0.0] }",
    "goals": "one [x, y] or more",
}
"""Required content of the fields that drivers need."""
_ROUNDING = 1e-9
_PARAMETERS = "law.parameters"


def names_are_known(scenario: Scenario) -> Iterator[Fault]:
    """Check that law, sensor and drivers are registered."""
    yield from unknown_name("law.name", scenario.law.name, LAWS)
    yield from unknown_name("sensor.model", scenario.sensor.model, SENSORS)
    for k, ugv in enumerate(scenario.ugv):
        yield from unknown_name(f"ugv.{k}.driver", ugv.driver, DRIVERS)


def _names_a_function(text: str) -> bool:
    module, separator, function = text.partition(":")
    return bool(separator) and all(part.isidentifier() for part in (*module.split("."), function))


def _policy_fault(text: str, vehicle: Vehicle) -> str:
    """Return what is wrong with the name of a policy; empty if nothing is."""
    try:
        known = is_policy_file(text, vehicle)
    except ValueError as error:
        return str(error)
    named = bool(text.partition(":")[2]) if known else _names_a_function(text)
    return "" if named else "not a policy"


_POLICIES: dict[str, Vehicle] = {"policy": "ugv", "uav_policy": "uav"}
"""Fields of `[custom]` that may name a saved policy, with the kind of vehicle."""


def _forms(field: str) -> str:
    return policy_forms(_POLICIES[field]) if field in _POLICIES else "module:function"


def own_functions_are_named(scenario: Scenario) -> Iterator[Fault]:
    """Check that a law with user code names it as `module:function`; it is not loaded here."""
    for field in scenario.custom.__struct_fields__:
        named = getattr(scenario.custom, field)
        if field in _POLICIES:
            wrong = _policy_fault(named, _POLICIES[field]) if named else ""
            if wrong:
                yield Fault(f"custom.{field}", named, wrong, _forms(field))
        elif named and not _names_a_function(named):
            yield Fault(f"custom.{field}", named, "not a function", "module:function")
    law = LAWS[scenario.law.name]
    needed = {f"the law {law.name!r}": law.own} if scenario.uav else {}
    needed |= {f"the driver {ugv.driver!r}": DRIVERS[ugv.driver].own for ugv in scenario.ugv}
    for who, field in needed.items():
        if field and not getattr(scenario.custom, field):
            yield Fault(f"custom.{field}", "", f"missing, required by {who}", _forms(field))


def drivers_have_their_task(scenario: Scenario) -> Iterator[Fault]:
    """Check that a UGV has the fields that its driver needs, and that script times increase."""
    for k, ugv in enumerate(scenario.ugv):
        times = [step.time for step in ugv.script]
        needed = DRIVERS[ugv.driver].needs
        if needed and not getattr(ugv, needed):
            wrong = f"missing, required by the driver {ugv.driver!r}"
            yield Fault(f"ugv.{k}.{needed}", [], wrong, _ENTRIES.get(needed, "a value"))
        for n, (earlier, later) in enumerate(pairwise(times), 1):
            if not later > earlier:
                yield Fault(
                    f"ugv.{k}.script.{n}.time",
                    later,
                    f"not after {exact(earlier)} s",
                    "increasing times",
                )


def switching_radius_is_positive(scenario: Scenario) -> Iterator[Fault]:
    """Check that r_s > 0, so that there is room for coverage, Klodt 2015, eq. (18)."""
    if not LAWS[scenario.law.name].needs_radius:
        return
    for path, uav, ugv in escorts(scenario):
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
                f"above {at_least(least, 4)} m/s²",
            )


def law_parameters_are_possible(scenario: Scenario) -> Iterator[Fault]:
    """Check that each parameter belongs to a law; the active law's parameters must have valid types and values."""
    law = scenario.law
    own = parameter_names(law.name)
    for name in unknown_parameters(law):
        wrong = f"unknown parameter{near(name, own)}"
        yield Fault(f"{_PARAMETERS}.{name}", law.parameters[name], wrong, ", ".join(own) or "none")
    fault = type_fault(dict(own_parameters(law)), LAWS[law.name].parameters)
    if fault is not None:
        yield fault._replace(field=f"{_PARAMETERS}.{fault.field}".rstrip("."))


def reference_speed_is_possible(scenario: Scenario) -> Iterator[Fault]:
    """Check that v_ref of (10) exists, and that every UAV can fly it."""
    v_ref = getattr(law_parameters(scenario.law), "reference_speed", None)
    if v_ref is None:
        return
    for k, uav in enumerate(scenario.uav):
        if math.isinf(v_ref) and math.isinf(uav.max_speed):
            yield Fault(
                f"{_PARAMETERS}.reference_speed",
                None,
                f"missing, and uav.{k}.max_speed = inf gives no default",
                "a number > 0, in m/s",
            )
        elif math.isfinite(v_ref) and v_ref > uav.max_speed:
            allowed = f"up to uav.{k}.max_speed = {exact(uav.max_speed)} m/s"
            yield Fault(
                f"{_PARAMETERS}.reference_speed", v_ref, "faster than the UAV can fly", allowed
            )


def controller_is_stable(scenario: Scenario) -> Iterator[Fault]:
    r"""Check that the tracking loop of (15) and (16) is Hurwitz in continuous time.

    $$ s^3 - A_c s^2 - D_c s + (D_c A_c - B_c C_c) $$

    By Routh: all coefficients positive, and A_c D_c > D_c A_c - B_c C_c. The default is (s + 1)³.
    """
    parameters = law_parameters(scenario.law)
    if not hasattr(parameters, "a_c"):
        return
    a, b, c, d = parameters.a_c, parameters.b_c, parameters.c_c, parameters.d_c
    last = d * a - b * c
    if not (a < 0.0 and d < 0.0 and last > 0.0 and a * d > last):
        value = {"a_c": a, "b_c": b, "c_c": c, "d_c": d}
        yield Fault(
            _PARAMETERS,
            value,
            "the tracking loop (15), (16) is unstable",
            "A < 0, D < 0, 0 < D A - B C < A D",
        )


def circle_is_within_sight(scenario: Scenario) -> Iterator[Fault]:
    """Check that the virtual point of (25) is always nearer than r_v."""
    if scenario.law.name != "circle":
        return
    r_v, radius = scenario.visibility.radius, law_parameters(scenario.law).circle_radius
    for path, uav, ugv in escorts(scenario):
        if math.isfinite(radius) and radius >= r_v:
            yield Fault(
                f"{_PARAMETERS}.circle_radius",
                radius,
                "the circle is out of sight",
                f"less than r_v = {exact(r_v)} m",
            )
        elif math.isinf(radius) and switching_radius(scenario, uav, ugv) >= r_v:
            wrong = f"missing, and r_s = r_v since {path}.max_acceleration = inf"
            yield Fault(
                f"{_PARAMETERS}.circle_radius", None, wrong, f"less than r_v = {exact(r_v)} m"
            )


CHECKS: tuple[Check, ...] = (
    *WORLD_CHECKS,
    names_are_known,
    law_parameters_are_possible,
    own_functions_are_named,
    drivers_have_their_task,
    switching_radius_is_positive,
    reference_speed_is_possible,
    controller_is_stable,
    circle_is_within_sight,
    *BUILDING_CHECKS,
    *GROUND_CHECKS,
    teams_are_possible,
    endurances_suffice,
)
"""Checks in order: later ones may rely on earlier ones."""


def check_scenario(scenario: Scenario, *, source: str = "") -> Scenario:
    """Check a scenario and return it.

    Args:
        scenario: Read from a file or made in Python; NumPy numbers and integers become floats.
        source: Name of the file for error messages; the scenario's name by default.

    Returns:
        Equal scenario with correctly typed values.

    Raises:
        ScenarioError: One line with file, field, value, what is wrong and what is allowed.
    """
    file = one_line(str(source or scenario.name or "scenario"))
    checked = typed(as_raw(scenario, file=file), type(scenario), file=file)
    for check in CHECKS:
        for fault in check(checked):
            raise fault.error(file)
    return checked


def scenario_warnings(scenario: Scenario) -> tuple[str, ...]:
    """Return warnings about valid scenarios with surprising behavior.

    Args:
        scenario: Scenario that `check_scenario` has accepted.

    Returns:
        One line for each warning.
    """
    return tuple(
        line
        for warnings in (
            _law_warnings,
            _separation_warnings,
            _code_warnings,
            _circle_warnings,
            _task_warnings,
            hazard_warnings,
            building_warnings,
            watch_warnings,
        )
        for line in warnings(scenario)
    )


def _law_warnings(scenario: Scenario) -> Iterator[str]:
    if scenario.uav and not LAWS[scenario.law.name].keeps_sight:
        name = f'law.name = "{scenario.law.name}"'
        yield f"{name}: visibility is not maintained: this law never returns to the UGV"


def _separation_warnings(scenario: Scenario) -> Iterator[str]:
    if len(scenario.uav) > 1 and scenario.team is None:  # a team flies at separate altitudes
        names = ", ".join(uav.name for uav in scenario.uav)
        yield f"{names}: nothing keeps UAVs apart; the metric min_separation is the smallest distance"


def _code_warnings(scenario: Scenario) -> Iterator[str]:
    """Warn of user code that neither law nor driver uses."""
    law = LAWS[scenario.law.name]
    loaded = {law.own, law.inner} if scenario.uav else set[str]()
    loaded |= {DRIVERS[ugv.driver].own for ugv in scenario.ugv}
    for field in scenario.custom.__struct_fields__:
        value: str = getattr(scenario.custom, field)
        if value and field not in loaded:
            laws = [
                f"law.name = {row.name}" for row in LAWS.values() if field in (row.own, row.inner)
            ]
            drivers = [f"ugv.*.driver = {row.name}" for row in DRIVERS.values() if field == row.own]
            users = " or ".join((*laws, *drivers))
            yield f"custom.{field} = {value!r}: not used; requires {users}"


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


def _circle_warnings(scenario: Scenario) -> Iterator[str]:
    """Warn of a circle that cannot be flown; see `largest_circle_rate`."""
    if scenario.law.name != "circle":
        return
    parameters = law_parameters(scenario.law)
    rate = abs(parameters.circle_rate)
    for _, uav, ugv in escorts(scenario):
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
            reason = f"the smaller of (v_a - v_g)/r_pv and sqrt(u_a/r_pv), r_pv = {radius:.4g} m"
            field = f"{_PARAMETERS}.circle_rate = {parameters.circle_rate}"
            allowed = f"allowed up to {at_most(bound, 4)} rad/s, {reason}"
            yield f"{field}: cannot be flown: {needs}, {has}; {allowed}"


def _task_warnings(scenario: Scenario) -> Iterator[str]:
    for k, ugv in enumerate(scenario.ugv):
        wanted = DRIVERS[ugv.driver].wants
        if wanted and not getattr(ugv, wanted):
            needs = f"its driver needs {_ENTRIES.get(wanted, 'one or more')} to move"
            yield f"ugv.{k}.{wanted} = []: {ugv.name} will stand still; {needs}"
