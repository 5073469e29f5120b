"""Kinematics of the UGVs in a scenario: checks, and initial headings."""

import math
from collections.abc import Iterator

from bus.numbers import exact
from bus.registry import DEFAULT_KINEMATICS, KINEMATICS
from sim.input.faults import Fault, unknown_name
from sim.scenario.types import Scenario
from sim.scenario.vehicle_types import Ugv

_NEEDS = {"differential": "track", "ackermann": "max_curvature"}
"""Field that each kind of kinematics needs, and no other kind has."""
_ALONG = 1e-6
"""Largest sine of the angle between initial velocity and heading."""


def steers(ugv: Ugv) -> bool:
    """Return whether a UGV moves along its heading only."""
    return ugv.kinematics != DEFAULT_KINEMATICS


def initial_heading(ugv: Ugv) -> float:
    """Return the initial heading of a UGV [rad]; 0 for a point."""
    if not steers(ugv):
        return 0.0
    if ugv.heading is not None:
        return math.remainder(ugv.heading, math.tau)
    goal = ugv.goals[0] if ugv.goals else ugv.position
    ahead = goal[0] - ugv.position[0], goal[1] - ugv.position[1]
    x, y = ugv.velocity if ugv.velocity != (0.0, 0.0) else ahead
    return math.atan2(y, x)


def kinematics_are_possible(scenario: Scenario) -> Iterator[Fault]:
    """Check that the kinematics of UGVs are known, complete and finite, and that they start along their heading."""
    for k, ugv in enumerate(scenario.ugv):
        path = f"ugv.{k}"
        yield from unknown_name(f"{path}.kinematics", ugv.kinematics, KINEMATICS)
        for kind, field in _NEEDS.items():
            given = getattr(ugv, field)
            if ugv.kinematics == kind and given is None:
                yield Fault(
                    f"{path}.kinematics", kind, f"has no {field}", f"a {path}.{field} above 0"
                )
            if ugv.kinematics != kind and given is not None:
                yield Fault(
                    f"{path}.{field}", given, f"not used by {ugv.kinematics}", f"only with {kind}"
                )
        if steers(ugv):
            yield from _steering_faults(path, ugv)
        elif ugv.heading is not None:
            yield Fault(
                f"{path}.heading", ugv.heading, "a point has no heading", f"only with {_NAMES}"
            )


_NAMES = " or ".join(_NEEDS)


def _steering_faults(path: str, ugv: Ugv) -> Iterator[Fault]:
    for field, unit in (("max_speed", "m/s"), ("max_acceleration", "m/s²")):
        bound = getattr(ugv, field)
        if math.isinf(bound):
            allowed = f"a finite number of {unit} with kinematics = {ugv.kinematics!r}"
            yield Fault(f"{path}.{field}", bound, "unbounded", allowed)
    heading, (v_x, v_y) = initial_heading(ugv), ugv.velocity
    aside = v_y * math.cos(heading) - v_x * math.sin(heading)
    if abs(aside) > _ALONG * math.hypot(v_x, v_y):
        yield Fault(
            f"{path}.velocity",
            ugv.velocity,
            "not along the heading",
            f"along {path}.heading = {exact(heading)}, forwards or in reverse",
        )
