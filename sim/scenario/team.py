"""Teams of a scenario: members, leash of the scouts, and the checks of `[team]`."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import msgspec

from bus.messages.base import or_infinite
from bus.messages.team import MOST_UAVS, Endurance, Team
from bus.numbers import at_least, at_most, exact
from sim.input.faults import Fault
from sim.models.endurance import CERTIFYING, RESERVE, farthest_in_area, reach_time, return_time
from sim.models.safety import visible_radius
from sim.scenario.building_tables import max_building_height
from sim.scenario.safety import safety_parameters
from sim.scenario.types import Scenario, altitude_limits
from sim.scenario.vehicle_types import Uav, Ugv

_ROUNDING = 1e-9
_PRECISION = 0.01
"""Precision of the lowest and the highest altitude of a scout [m]."""


def mates_of(scenario: Scenario, uav: str) -> tuple[str, ...]:
    """Return all UAVs of a UAV's team in name order, itself included; empty: it has no team."""
    if scenario.team is None:
        return ()
    escorts = {one.name: one.escorts for one in scenario.uav}
    return tuple(sorted(name for name in escorts if escorts[name] == escorts[uav]))


def teams_of(scenario: Scenario) -> tuple[tuple[str, ...], ...]:
    """Return the teams, by their UAVs in name order; empty without `[team]`."""
    mates = (mates_of(scenario, uav.name) for uav in scenario.uav)
    return tuple(dict.fromkeys(team for team in mates if team))


def observer_rows(scenario: Scenario) -> tuple[list[int], ...]:
    """Return the rows of the UAVs that observe together: all UAVs of a team, or one UAV without a team."""
    names = sorted(uav.name for uav in scenario.uav)
    groups: dict[tuple[str, ...], list[int]] = {}
    for row, name in enumerate(names):
        groups.setdefault(mates_of(scenario, name) or (name,), []).append(row)
    return tuple(groups.values())


def leash(
    team: Team, uav: Uav, v_g: float, r_v: float, error: float, tracking: float, dt: float
) -> float:
    r"""Return the largest distance from which a scout returns while the UGV is still within r_v [m].

    $$ L = v_a \left[ (r_v - \varepsilon - 2w)/v_g - S - 5 v_a/(2 u_a) - 2\,dt \right] $$

    The UGV was measured at most S before the scout turns back; turn, flight and stop take $L/v_a + 5 v_a/(2 u_a) +
    2\,dt$. With an altitude, R(z) at the lowest one replaces r_v, see `lowest_sight`.

    Args:
        team: Settings with S.
        uav: The scout.
        v_g: Maximum speed of the UGV [m/s].
        r_v: Visibility radius [m].
        error: Largest measurement error epsilon [m].
        tracking: Largest tracking error w [m].
        dt: Length of a tick [s].
    """
    v_a, u_a = uav.max_speed, uav.max_acceleration
    time = (r_v - error - 2.0 * tracking) / v_g - team.silence - 5.0 * v_a / (2.0 * u_a) - 2.0 * dt
    return v_a * time if math.isfinite(v_a) else -math.inf


def _escorted(scenario: Scenario, uav: Uav) -> Ugv:
    return next(one for one in scenario.ugv if one.name == uav.escorts)


def lowest_sight(scenario: Scenario, uav: Uav) -> float:
    """Return R(z), the distance within which a UAV sees its UGV at the lowest altitude above all roofs [m].

    In the plane it is r_v. The UGV is taken to keep the distance from buildings that it declares (A9).
    """
    limits, ugv = altitude_limits(scenario, uav), _escorted(scenario, uav)
    if limits is None:
        return scenario.visibility.radius
    roofs, lowest = max_building_height(scenario), limits.min_altitude
    if roofs is not None:
        lowest = max(lowest, roofs + limits.vertical_clearance, math.nextafter(roofs, math.inf))
    return float(
        visible_radius(
            lowest,
            scenario.visibility.radius,
            math.tan(scenario.camera.half_angle),
            ugv.marker_height,
            roofs or 0.0,
            ugv.building_clearance,
        )
    )


def _leash_of(scenario: Scenario, team: Team, uav: Uav, radius: float | None = None) -> float:
    """Return the leash of a scout [m]; `radius`: distance within which it sees the UGV, None: `lowest_sight` [m]."""
    safety = safety_parameters(scenario, uav.name)
    error, tracking = map(or_infinite, (safety.max_measurement_error, safety.max_tracking_error))
    r_v, v_g = radius or lowest_sight(scenario, uav), _escorted(scenario, uav).max_speed
    return leash(team, uav, v_g, r_v, error, tracking, scenario.dt)


def briefed_team(scenario: Scenario, uav: Uav) -> Team | None:
    """Return the settings of a UAV's team, with a definite `scout_range`; None: it has no team."""
    team = scenario.team
    if team is None or team.scout_range is not None:
        return team
    return msgspec.structs.replace(team, scout_range=_leash_of(scenario, team, uav))


def endurance_of(uav: Uav) -> Endurance | None:
    """Return the endurance of a UAV in the form of a message; None: it is unlimited."""
    if uav.endurance is None or uav.base is None:
        return None
    return Endurance(endurance=uav.endurance, charge_time=uav.charge_time, base=uav.base)


class Watch(NamedTuple):
    """Times of a watch with relief [s], see docs/explanation/teams.md."""

    lead: float
    """From the request for relief to the acceptance."""
    watch: float
    """For which a UAV guards with one charge, T_w."""
    away: float
    """From the release to the next acceptance, with a full charge in between."""


def watch_of(scenario: Scenario, uav: Uav) -> Watch:
    """Return the times of a UAV with an endurance, for the point of the area that is farthest from its base."""
    distance = farthest_in_area(uav.base or uav.position, scenario.area)
    ugv = _escorted(scenario, uav)
    v_a, u_a, silence = (
        uav.max_speed,
        uav.max_acceleration,
        scenario.team.silence if scenario.team else 0.0,
    )
    out = reach_time(distance, v_a, u_a, ugv.max_speed) + CERTIFYING
    back = return_time(distance, v_a, u_a)
    watch = (uav.endurance or math.inf) - RESERVE - out - back
    return Watch(out + 2.0 * silence, watch, back + uav.charge_time + out)


def endurances_suffice(scenario: Scenario) -> Iterator[Fault]:
    """Check that each UAV with an endurance has a base in the area, and guards longer than its relief takes."""
    area = scenario.area
    for k, uav in enumerate(scenario.uav):
        if uav.endurance is None:
            continue
        if scenario.team is None:
            yield Fault(
                f"uav.{k}.endurance", uav.endurance, "only a team can relieve it", "with [team]"
            )
        if uav.base is None:
            yield Fault(f"uav.{k}.base", None, "missing: it cannot charge", "[x, y] in m")
            continue
        if not (0.0 <= uav.base[0] <= area.width and 0.0 <= uav.base[1] <= area.height):
            inside = f"[0, {exact(area.width)}] x [0, {exact(area.height)}] m"
            yield Fault(f"uav.{k}.base", list(uav.base), "outside the area", inside)
        times = watch_of(scenario, uav)
        if not times.watch > times.lead:
            least = uav.endurance - times.watch + times.lead
            wrong = "too short: its base is too far for a relief in time"
            yield Fault(f"uav.{k}.endurance", uav.endurance, wrong, f"above {at_least(least, 4)} s")


def watch_warnings(scenario: Scenario) -> Iterator[str]:
    """Warn of a team that cannot guard without a gap, with what would do."""
    team = scenario.team
    for mates in teams_of(scenario):
        uavs = [uav for uav in scenario.uav if uav.name in mates]
        if team is None or any(uav.endurance is None for uav in uavs):
            continue
        times = [watch_of(scenario, uav) for uav in uavs]
        watch, away = min(one.watch for one in times), max(one.away for one in times)
        count, g = len(uavs), team.guards
        needed = math.ceil(g + g * away / watch - _ROUNDING)
        if count >= needed:
            continue
        cures = [f"{needed} UAVs"]
        if count > g:
            longest = (count - g) * watch / g
            used = away - max(uav.charge_time for uav in uavs)
            extra = g * away / (count - g) - watch
            cures.append(
                f"an endurance of {at_least(min(uav.endurance or 0.0 for uav in uavs) + extra, 4)} s"
            )
            if longest > used:
                cures.append(f"a charge time of {at_most(longest - used, 4)} s")
        yield (
            f"{', '.join(mates)}: the watch has gaps: a UAV guards for {watch:.4g} s per charge, and is away for "
            f"{away:.4g} s; needed: {' or '.join(cures)}"
        )


def teams_are_possible(scenario: Scenario) -> Iterator[Fault]:
    """Check the number of guards and of UAVs, and that scouts return in time."""
    team = scenario.team
    if team is None:
        return
    for mates in teams_of(scenario):
        count, names = len(mates), ", ".join(mates)
        if count > MOST_UAVS:
            yield Fault("uav", count, f"too many for one team ({names})", f"up to {MOST_UAVS}")
        if team.guards > count:
            wrong = f"more than the UAVs of the team: {names}"
            yield Fault("team.guards", team.guards, wrong, f"up to {count}")
    r_v = scenario.visibility.radius
    for k, uav in enumerate(scenario.uav):
        longest = _leash_of(scenario, team, uav)
        if not longest >= r_v:
            fault = _too_high(scenario, team, k) or _too_low(scenario, team, k)
            yield fault or _no_leash(scenario, team, f"uav.{k}", uav)
        if team.scout_range is None:
            continue
        if team.scout_range < r_v:
            wrong, allowed = "below r_v, where a guard flies", f"from {exact(r_v)} m"
            yield Fault("team.scout_range", team.scout_range, wrong, allowed)
        if team.scout_range > longest:
            wrong = f"beyond the leash: {uav.name} might return too late to find the UGV within r_v"
            yield Fault(
                "team.scout_range", team.scout_range, wrong, f"up to {at_most(longest, 4)} m"
            )


def _too_high(scenario: Scenario, team: Team, k: int) -> Fault | None:
    """Return the fault of a UAV that could be a scout at r_v if it flew lower, where its detections have less noise."""
    uav, r_v = scenario.uav[k], scenario.visibility.radius
    limits = altitude_limits(scenario, uav)
    if limits is None:
        return None

    def fits(highest: float) -> bool:
        lower = msgspec.structs.replace(uav, max_altitude=highest)
        uavs = (*scenario.uav[:k], lower, *scenario.uav[k + 1 :])
        return _leash_of(msgspec.structs.replace(scenario, uav=uavs), team, lower, r_v) >= r_v

    low, high = limits.initial_altitude, limits.max_altitude
    if fits(high) or not fits(low):
        return None
    while high - low > _PRECISION:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if fits(middle) else (low, middle)
    wrong = f"the noise of {uav.name}'s detections grows with altitude, so a scout may return too late from r_v"
    enough = max(limits.initial_altitude, math.floor(low / _PRECISION) * _PRECISION)
    return Fault(f"uav.{k}.max_altitude", limits.max_altitude, wrong, f"up to {at_most(enough)} m")


def _too_low(scenario: Scenario, team: Team, k: int) -> Fault | None:
    """Return the fault of a UAV that could be a scout if it saw the UGV within r_v at every altitude; None: it cannot.

    R(z) is proportional to z - h_m, the height above the marker, up to r_v.
    """
    uav, r_v = scenario.uav[k], scenario.visibility.radius
    limits, seen = altitude_limits(scenario, uav), lowest_sight(scenario, uav)
    spare = _leash_of(scenario, team, uav, r_v) - r_v
    if limits is None or not spare >= 0.0:
        return None
    ugv, roofs = _escorted(scenario, uav), max_building_height(scenario) or 0.0
    hidden = roofs > ugv.marker_height
    if hidden and ugv.building_clearance == 0.0:
        wrong = f"buildings may hide it from {uav.name}, so no scout finds it for certain"
        field = f"ugv.{scenario.ugv.index(ugv)}.building_clearance"
        return Fault(field, ugv.building_clearance, wrong, "more than 0 m")
    # v_g times the time that the leash spares at r_v
    needed = r_v - spare * ugv.max_speed / uav.max_speed
    slope = math.tan(scenario.camera.half_angle)
    if hidden:
        slope = min(slope, ugv.building_clearance / (roofs - ugv.marker_height))
    least = ugv.marker_height + needed / slope
    wrong = f"from the lowest altitude {uav.name} sees the UGV within {seen:.3g} m only, so a scout may return too late"
    enough = math.ceil((least + _ROUNDING) / _PRECISION) * _PRECISION
    return Fault(f"uav.{k}.min_altitude", limits.min_altitude, wrong, f"from {enough:.2f} m")


def _no_leash(scenario: Scenario, team: Team, path: str, uav: Uav) -> Fault:
    """Return the fault of a UAV that cannot even be a scout at r_v."""
    instant, r_v = msgspec.structs.replace(team, silence=0.0), scenario.visibility.radius
    spare = _leash_of(scenario, instant, uav, r_v) - r_v
    if spare > 0.0:
        wrong = f"too long: {uav.name} might return too late from r_v to find the UGV"
        return Fault(
            "team.silence", team.silence, wrong, f"up to {at_most(spare / uav.max_speed, 4)} s"
        )
    wrong = "a scout might return too late from r_v to find the UGV, whatever `silence` is"
    allowed = "a higher speed, a slower UGV, a bounded and smaller measurement error, or no [team]"
    return Fault(f"{path}.max_speed", uav.max_speed, wrong, allowed)
