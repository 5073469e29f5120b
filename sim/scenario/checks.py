"""Checks of scenarios: errors for impossible ones, and warnings for surprising ones."""

import itertools
from collections.abc import Iterator
from itertools import pairwise

from bus.errors import ScenarioError
from bus.numbers import exact
from bus.policies import Vehicle, is_policy_file, policy_forms
from bus.registry import (
    BODIES,
    DRIVERS,
    LAWS,
    SENSORS,
)
from sim.input.faults import Fault, one_line, unknown_name
from sim.input.reading import as_raw, typed
from sim.scenario.building_checks import (
    BUILDING_CHECKS,
    altitudes_are_possible,
    building_fields_are_possible,
    building_warnings,
    buildings_are_apart,
    buildings_have_a_shape,
    buildings_leave_stops_free,
    cameras_see,
)
from sim.scenario.ground_checks import (
    GROUND_CHECKS,
    fields_are_possible,
    fields_have_room,
    hazard_warnings,
    hazards_are_known,
    hazards_have_a_shape,
    hazards_lie_in_area,
    routes_are_open,
    starts_and_goals_are_free,
    tiles_fit_area,
)
from sim.scenario.kinematics import kinematics_are_possible
from sim.scenario.laws import (
    LAW_CHECKS,
    circle_is_within_sight,
    circle_warnings,
    law_parameters_are_possible,
    law_warnings,
    laws_are_known,
    switching_radius_is_positive,
)
from sim.scenario.team import endurances_suffice, teams_are_possible, watch_warnings
from sim.scenario.team_bands import bands_are_apart
from sim.scenario.types import Scenario
from sim.scenario.world_checks import (
    WORLD_CHECKS,
    Check,
    commands_act,
    escorts_are_there,
    grid_divides_area,
    inner_loops_resist,
    links_are_possible,
    names_are_different,
    numbers_are_finite,
    points_are_inside,
    rates_fit_ticks,
    sight_is_within_range,
    time_is_whole,
    uav_is_stronger,
    ugv_is_seen_at_start,
    wind_is_possible,
)

_ENTRIES = {
    "script": "steps such as { time = 0.0, velocity = [0.2, 0.0] }",
    "goals": "one [x, y] or more",
}
"""Required content of the fields that drivers need."""


def names_are_known(scenario: Scenario) -> Iterator[Fault]:
    """Check that laws, sensor, drivers and bodies are registered."""
    yield from laws_are_known(scenario)
    yield from unknown_name("sensor.model", scenario.sensor.model, SENSORS)
    for k, ugv in enumerate(scenario.ugv):
        yield from unknown_name(f"ugv.{k}.driver", ugv.driver, DRIVERS)
    for k, uav in enumerate(scenario.uav):
        yield from unknown_name(f"uav.{k}.body", uav.body, BODIES)


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
    laws = [LAWS[scenario.law_of(uav).name] for uav in scenario.uav]
    needed = {f"the law {law.name!r}": law.own for law in laws}
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


_FIRST: tuple[Check, ...] = (
    numbers_are_finite,
    names_are_different,
    escorts_are_there,
    names_are_known,
    hazards_are_known,
)
"""Checks on which all others rely."""
CHECKS: tuple[Check, ...] = (
    *_FIRST,
    *WORLD_CHECKS,
    kinematics_are_possible,
    law_parameters_are_possible,
    own_functions_are_named,
    drivers_have_their_task,
    *LAW_CHECKS,
    *BUILDING_CHECKS,
    *GROUND_CHECKS,
    teams_are_possible,
    bands_are_apart,
    endurances_suffice,
)
"""Checks in order."""
_SHAPES = hazards_have_a_shape, buildings_have_a_shape
_RELIES: dict[Check, tuple[Check, ...]] = {
    rates_fit_ticks: (time_is_whole,),
    ugv_is_seen_at_start: (sight_is_within_range, points_are_inside),
    inner_loops_resist: (time_is_whole, wind_is_possible),
    commands_act: (time_is_whole, links_are_possible),
    **dict.fromkeys(LAW_CHECKS, (law_parameters_are_possible,)),
    circle_is_within_sight: (law_parameters_are_possible, switching_radius_is_positive),
    cameras_see: (altitudes_are_possible,),
    buildings_are_apart: (buildings_have_a_shape,),
    buildings_leave_stops_free: (buildings_have_a_shape, altitudes_are_possible),
    tiles_fit_area: (grid_divides_area,),
    hazards_lie_in_area: (hazards_have_a_shape,),
    starts_and_goals_are_free: (hazards_have_a_shape,),
    routes_are_open: (
        *(tiles_fit_area, points_are_inside, *_SHAPES),
        *(starts_and_goals_are_free, buildings_leave_stops_free),
    ),
    fields_have_room: (fields_are_possible, building_fields_are_possible, routes_are_open),
    teams_are_possible: (uav_is_stronger, inner_loops_resist, commands_act, cameras_see),
    bands_are_apart: (altitudes_are_possible,),
    endurances_suffice: (uav_is_stronger,),
}
"""Checks that mean nothing if one of these has found a fault, or was left out."""


def _independent_faults(scenario: Scenario) -> Iterator[Fault]:
    """Yield the faults of all checks, except of those that rely on a check which has found one."""
    failed: set[Check] = set()
    for check in CHECKS:
        relies = _RELIES.get(check, ()) + (() if check in _FIRST else _FIRST)
        faults = () if failed.intersection(relies) else tuple(check(scenario))
        if faults or failed.intersection(relies):
            failed.add(check)
        yield from faults


def check_scenario(scenario: Scenario, *, source: str = "", every: bool = False) -> Scenario:
    """Check a scenario and return it.

    Args:
        scenario: Read from a file or made in Python; NumPy numbers and integers become floats.
        source: Name of the file for error messages; the scenario's name by default.
        every: True: report every independent fault, not the first one only.

    Returns:
        Equal scenario with correctly typed values.

    Raises:
        ScenarioError: One line with file, field, value, what is wrong and what is allowed.
    """
    file = one_line(str(source or scenario.name or "scenario"))
    checked = typed(as_raw(scenario, file=file), type(scenario), file=file, every=every)
    faults = _independent_faults(checked)
    lines = [fault.line(file) for fault in (faults if every else itertools.islice(faults, 1))]
    if lines:
        raise ScenarioError(*lines)
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
            law_warnings,
            _separation_warnings,
            _code_warnings,
            circle_warnings,
            _task_warnings,
            hazard_warnings,
            building_warnings,
            watch_warnings,
            _body_warnings,
        )
        for line in warnings(scenario)
    )


def _separation_warnings(scenario: Scenario) -> Iterator[str]:
    if len(scenario.uav) > 1 and scenario.team is None:  # a team flies at separate altitudes
        names = ", ".join(uav.name for uav in scenario.uav)
        yield f"{names}: nothing keeps UAVs apart; the metric min_separation is the smallest distance"


def _code_warnings(scenario: Scenario) -> Iterator[str]:
    """Warn of user code that neither law nor driver uses."""
    laws = [LAWS[scenario.law_of(uav).name] for uav in scenario.uav]
    loaded = {field for law in laws for field in (law.own, law.inner)}
    loaded |= {DRIVERS[ugv.driver].own for ugv in scenario.ugv}
    for field in scenario.custom.__struct_fields__:
        value: str = getattr(scenario.custom, field)
        if value and field not in loaded:
            users = [
                f"law.name = {row.name}" for row in LAWS.values() if field in (row.own, row.inner)
            ]
            users += [f"ugv.*.driver = {row.name}" for row in DRIVERS.values() if field == row.own]
            yield f"custom.{field} = {value!r}: not used; requires {' or '.join(users)}"


def _body_warnings(scenario: Scenario) -> Iterator[str]:
    """Warn of a body whose tracking error has no declared bound."""
    for k, uav in enumerate(scenario.uav):
        declared = scenario.certificate.max_tracking_error is not None
        if BODIES[uav.body].make and scenario.filters(uav) and not declared:
            yield (
                f"uav.{k}.body = {uav.body!r}: its tracking error is unknown, so that sight is never certified; "
                "measure it, and declare certificate.max_tracking_error"
            )


def check_no_robot(scenario: Scenario) -> None:
    """Check that no UAV is flown by a robot, where no process can report it.

    Raises:
        ScenarioError: If a UAV's body is `reported`.
    """
    for k, uav in enumerate(scenario.uav):
        if BODIES[uav.body].reported:
            others = ", ".join(row.name for row in BODIES.values() if not row.reported)
            raise ScenarioError(
                f"uav.{k}.body = {uav.body!r}: only a process of its own can report a robot, such as `outrider "
                f"simulator` with `outrider mavlink --autopilot {uav.name}`; allowed here: {others}"
            )


def _task_warnings(scenario: Scenario) -> Iterator[str]:
    for k, ugv in enumerate(scenario.ugv):
        wanted = DRIVERS[ugv.driver].wants
        if wanted and not getattr(ugv, wanted):
            needs = f"its driver needs {_ENTRIES.get(wanted, 'one or more')} to move"
            yield f"ugv.{k}.{wanted} = []: {ugv.name} will stand still; {needs}"
