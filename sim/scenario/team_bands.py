"""Altitude bands of UAVs in teams: they keep the UAVs apart."""

from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

from bus.messages.buildings import AltitudeLimits
from bus.numbers import exact
from sim.input.faults import Fault
from sim.scenario.types import Scenario, altitude_limits

_ROUNDING = 1e-9
"""Tolerance of the separation of two bands [m]."""


class _Band(NamedTuple):
    """Altitudes of one UAV."""

    path: str
    name: str
    limits: AltitudeLimits

    @property
    def shown(self) -> str:
        low, high = self.limits.min_altitude, self.limits.max_altitude
        return f"{self.name} [{exact(low)}, {exact(high)}] m"


def bands_are_apart(scenario: Scenario) -> Iterator[Fault]:
    """Check that the altitude bands of all UAVs are separated, if UAVs form teams.

    UAVs of different teams may meet as well, so their bands count too.
    """
    team = scenario.team
    if team is None:
        return
    bands = [
        _Band(f"uav.{k}", uav.name, limits)
        for k, uav in enumerate(scenario.uav)
        if (limits := altitude_limits(scenario, uav)) is not None
    ]
    bands.sort(key=lambda one: (one.limits.initial_altitude, one.limits.min_altitude))
    for below, above in pairwise(bands):
        gap = above.limits.min_altitude - below.limits.max_altitude
        if gap < team.separation - _ROUNDING:
            wrong = (
                f"the bands of {below.shown} and {above.shown} are not {exact(team.separation)} m "
                "apart (team.separation)"
            )
            field, value, allowed = _smallest_change(below, above, team.separation)
            yield Fault(field, value, wrong, allowed)


def _smallest_change(below: _Band, above: _Band, apart: float) -> tuple[str, float, str]:
    """Return a field to change, its value, and what suffices.

    One bound is changed if that suffices, else one of each UAV, else the initial altitude too.
    """
    low, high = below.limits, above.limits
    lowest, start = f"{above.path}.min_altitude", f"{above.path}.initial_altitude"
    least = low.max_altitude + apart
    if least <= high.initial_altitude:
        return lowest, high.min_altitude, f"from {_shown(least)} m"
    most = high.min_altitude - apart
    if most >= low.initial_altitude:
        return f"{below.path}.max_altitude", low.max_altitude, f"up to {_shown(most)} m"
    room = high.initial_altitude - apart - low.initial_altitude
    top = low.initial_altitude + max(0.0, 0.5 * room)
    changes = [f"{below.path}.max_altitude = {_shown(top)}"]
    if high.max_altitude < top + apart:
        changes.append(f"{above.path}.max_altitude = {_shown(top + apart)}")
    if room < 0.0:
        changes.append(f"{lowest} = {_shown(top + apart)}")
    allowed = f"{_shown(top + apart)} m, with {' and '.join(changes)}"
    if room < 0.0:
        return start, high.initial_altitude, allowed
    return lowest, high.min_altitude, allowed


def _shown(altitude: float) -> str:
    """Return an altitude without the noise of rounding, far below the tolerance."""
    return exact(round(altitude, 12))
