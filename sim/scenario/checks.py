"""Refusals of scenarios that cannot be flown, and warnings of those that fly unlike what one may expect."""

import math
from collections.abc import Iterator
from itertools import pairwise

from bus.law_parameters import (
    law_parameters,
    own_parameters,
    parameter_names,
    parameters_class,
    unknown_parameters,
)
from bus.policies import Vehicle, policy_forms, policy_kinds
from bus.registry import (
    DRIVERS,
    LAWS,
    SENSORS,
)
from sim.input.faults import Fault, near, one_line, unknown_name
from sim.input.reading import as_raw, type_fault, typed
from sim.scenario.ground_checks import GROUND_CHECKS, hazard_warnings
from sim.scenario.types import Scenario, switching_radius
from sim.scenario.world_checks import WORLD_CHECKS, Check, escorts

_ENTRIES = {
    "script": "steps such as { time = 0.0, velocity = [0.2, 0.0] }",
    "goals": "one [x, y] or more",
}
"""Entries of the fields that drivers need."""
_ROUNDING = 1e-9
_PARAMETERS = "law.parameters"


def names_are_known(scenario: Scenario) -> Iterator[Fault]:
    """Law, sensor and drivers are rows of their tables."""
    yield from unknown_name("law.name", scenario.law.name, LAWS)
    yield from unknown_name("sensor.model", scenario.sensor.model, SENSORS)
    for k, ugv in enumerate(scenario.ugv):
        yield from unknown_name(f"ugv.{k}.driver", ugv.driver, DRIVERS)


def _names_a_function(text: str) -> bool:
    module, separator, function = text.partition(":")
    return bool(separator) and all(part.isidentifier() for part in (*module.split("."), function))


def _names_a_policy(text: str, vehicle: Vehicle) -> bool:
    kind, separator, file = text.partition(":")
    return bool(separator and file) if kind in policy_kinds(vehicle) else _names_a_function(text)


_POLICIES: dict[str, Vehicle] = {"policy": "ugv", "uav_policy": "uav"}
"""Fields of `[custom]` that may name a saved policy, with the kind of vehicle that it moves."""


def _forms(field: str) -> str:
    return policy_forms(_POLICIES[field]) if field in _POLICIES else "module:function"


def own_functions_are_named(scenario: Scenario) -> Iterator[Fault]:
    """A law with a function of the user's own has one, as `module:function`; it is not loaded here."""
    for field in scenario.custom.__struct_fields__:
        named = getattr(scenario.custom, field)
        if field in _POLICIES:
            if named and not _names_a_policy(named, _POLICIES[field]):
                yield Fault(f"custom.{field}", named, "names no policy", _forms(field))
        elif named and not _names_a_function(named):
            yield Fault(f"custom.{field}", named, "names no function", "module:function")
    law = LAWS[scenario.law.name]
    needed = {f"the law {law.name!r}": law.own} if scenario.uav else {}
    needed |= {f"the driver {ugv.driver!r}": DRIVERS[ugv.driver].own for ugv in scenario.ugv}
    for who, field in needed.items():
        if field and not getattr(scenario.custom, field):
            yield Fault(f"custom.{field}", "", f"{who} needs it", _forms(field))


def drivers_have_their_task(scenario: Scenario) -> Iterator[Fault]:
    """A UGV has what its driver needs, and each step of a script is later than the one before."""
    for k, ugv in enumerate(scenario.ugv):
        times = [step.time for step in ugv.script]
        needed = DRIVERS[ugv.driver].needs
        if needed and not getattr(ugv, needed):
            wrong = f"the driver {ugv.driver!r} needs it"
            yield Fault(f"ugv.{k}.{needed}", [], wrong, _ENTRIES.get(needed, "a value"))
        for n, (earlier, later) in enumerate(pairwise(times), 1):
            if not later > earlier:
                yield Fault(
                    f"ugv.{k}.script.{n}.time", later, f"not after {earlier:g} s", "times that rise"
                )


def switching_radius_is_positive(scenario: Scenario) -> Iterator[Fault]:
    """There is room to cover ground in, Klodt 2015, eq. (18): r_s > 0."""
    if not LAWS[scenario.law.name].needs_radius:
        return
    for path, uav, ugv in escorts(scenario):
        r_s = switching_radius(scenario, uav, ugv)
        if r_s == -math.inf:
            wrong = "r_s of (18) does not exist without a bound of the speed"
            yield Fault(
                f"{path}.max_speed",
                uav.max_speed,
                wrong,
                "finite speeds, or max_acceleration = inf too",
            )
        elif not r_s > 0.0:
            least = (uav.max_speed + ugv.max_speed) ** 2 / (2.0 * scenario.visibility.radius)
            wrong = f"too weak for these speeds and this r_v: r_s = {r_s:.4g} m (18)"
            yield Fault(
                f"{path}.max_acceleration", uav.max_acceleration, wrong, f"above {least:.4g} m/s²"
            )


def law_parameters_are_possible(scenario: Scenario) -> Iterator[Fault]:
    """Every parameter is one of a law; those of the law that is flown have their types and keep their bounds."""
    law = scenario.law
    own = parameter_names(law.name)
    for name in unknown_parameters(law):
        wrong = f"no law has it{near(name, own)}"
        yield Fault(f"{_PARAMETERS}.{name}", law.parameters[name], wrong, ", ".join(own) or "none")
    parameters = parameters_class(law.name)
    if parameters is not None:
        fault = type_fault(dict(own_parameters(law)), parameters)
        if fault is not None:
            yield fault._replace(field=f"{_PARAMETERS}.{fault.field}".rstrip("."))


def reference_speed_is_possible(scenario: Scenario) -> Iterator[Fault]:
    """There is a v_ref of (10), and every UAV can fly it."""
    v_ref = getattr(law_parameters(scenario.law), "reference_speed", None)
    if v_ref is None:
        return
    for k, uav in enumerate(scenario.uav):
        if math.isinf(v_ref) and math.isinf(uav.max_speed):
            yield Fault(
                f"{_PARAMETERS}.reference_speed",
                None,
                f"missing, and uav.{k}.max_speed = inf is none",
                "a number > 0, in m/s",
            )
        elif math.isfinite(v_ref) and v_ref > uav.max_speed:
            allowed = f"up to uav.{k}.max_speed = {uav.max_speed:g} m/s"
            yield Fault(
                f"{_PARAMETERS}.reference_speed", v_ref, "faster than the UAV can fly", allowed
            )


def controller_is_stable(scenario: Scenario) -> Iterator[Fault]:
    r"""The tracking loop of (15) and (16) is Hurwitz in continuous time.

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
    """The virtual point of (25) is always nearer than r_v."""
    if scenario.law.name != "circle":
        return
    r_v, radius = scenario.visibility.radius, law_parameters(scenario.law).circle_radius
    for path, uav, ugv in escorts(scenario):
        if math.isfinite(radius) and radius >= r_v:
            yield Fault(
                f"{_PARAMETERS}.circle_radius",
                radius,
                "the circle lies out of sight",
                f"less than r_v = {r_v:g} m",
            )
        elif math.isinf(radius) and switching_radius(scenario, uav, ugv) >= r_v:
            wrong = f"missing, and r_s = r_v since {path}.max_acceleration = inf"
            yield Fault(f"{_PARAMETERS}.circle_radius", None, wrong, f"less than r_v = {r_v:g} m")


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
    *GROUND_CHECKS,
)
"""In the order in which they are made: a later one may rely on those before it."""


def check_scenario(scenario: Scenario, *, source: str = "") -> Scenario:
    """The scenario, if it can be flown.

    Args:
        scenario: Read from a file or made in Python; NumPy's numbers and whole numbers in it become floats.
        source: The file, for the error; the scenario's name by default.

    Returns:
        An equal scenario in which every value has its type.

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
    """Warns of what can be flown but will not do what one may expect.

    Args:
        scenario: One that `check_scenario` has passed.

    Returns:
        A line for each.
    """
    return tuple(
        line
        for warnings in (
            _law_warnings,
            _code_warnings,
            _circle_warnings,
            _task_warnings,
            hazard_warnings,
        )
        for line in warnings(scenario)
    )


def _law_warnings(scenario: Scenario) -> Iterator[str]:
    if scenario.uav and not LAWS[scenario.law.name].keeps_sight:
        name = f'law.name = "{scenario.law.name}"'
        yield f"{name}: visibility is not kept, this law never turns back to the UGV"


def _code_warnings(scenario: Scenario) -> Iterator[str]:
    """Code of the user's own that neither law nor driver loads."""
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
            yield f"custom.{field} = {value!r}: nothing flies it; for {users}"


def largest_circle_rate(r_pv: float, v_a: float, v_g: float, u_a: float) -> float:
    r"""The largest $|\omega|$ [rad/s] at which the circle can be flown around any UGV (Remark 3 of the paper).

    The UAV needs the speed $r_{pv}\omega + v_g \le v_a$ and the acceleration $r_{pv}\omega^2 \le u_a$.

    Args:
        r_pv: Radius [m].
        v_a: Largest speed of the UAV [m/s].
        v_g: Largest speed of the UGV [m/s].
        u_a: Largest acceleration of the UAV [m/s²].
    """
    return min((v_a - v_g) / r_pv, math.sqrt(u_a / r_pv))


def _circle_warnings(scenario: Scenario) -> Iterator[str]:
    """A circle that cannot be flown, see `largest_circle_rate`."""
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
            needs = (
                f"needs {radius * rate:.3g} m/s and {radius * rate * rate:.3g} m/s² of {uav.name}"
            )
            has = (
                f"which beside {ugv.name} has v_a - v_g = {spare:.3g} m/s "
                f"and u_a = {uav.max_acceleration:.3g} m/s²"
            )
            reason = f"the smaller of (v_a - v_g)/r_pv and sqrt(u_a/r_pv), r_pv = {radius:.4g} m"
            field = f"{_PARAMETERS}.circle_rate = {parameters.circle_rate}"
            allowed = f"allowed up to {bound:.4f} rad/s, {reason}"
            yield f"{field}: cannot be flown: {needs}, {has}; {allowed}"


def _task_warnings(scenario: Scenario) -> Iterator[str]:
    for k, ugv in enumerate(scenario.ugv):
        wanted = DRIVERS[ugv.driver].wants
        if wanted and not getattr(ugv, wanted):
            needs = f"its driver needs {_ENTRIES.get(wanted, 'one or more')} to move"
            yield f"ugv.{k}.{wanted} = []: {ugv.name} will stand still; {needs}"
