"""Checks before a run, and after a change of a link, of the assumptions behind a scenario's certificates.

docs/explanation/proof.md numbers the assumptions: A1 bounds the error of a detection, A2 the age of the newest
one, A5' the time from the start of one plan to the start of the next, and A6' the tracking error. Wind, links and
detector may break them. Below some altitude, nothing can be certified.

A cautious UGV is certified to stay on tiles that it knows to be drivable, see docs/explanation/ground.md. Lost, late
and reordered commands break none of its assumptions: each command carries the stop that follows it.
"""

import functools
import math
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import msgspec

from agents.safety.handover import check_assumptions
from agents.safety.levels import (
    bounds_at,
    bounds_of,
    least_altitude,
    lowest_certified,
    radius_at,
)
from bus.messages.links import LinkKind
from bus.messages.vehicle import UavBriefing
from bus.numbers import above, exact
from bus.registry import CAUTIONS
from bus.ticks import TICK_TOLERANCE
from outrider.running.link_assumptions import (
    RARE,
    Finding,
    Frequency,
    InspectedLink,
    age_findings,
    frequency_of,
    interval_findings,
    percent,
)
from sim.engine.briefing import hiding_fault, monitored_bounds, uav_briefing
from sim.models.detection import error_share
from sim.models.ground import span
from sim.models.hazards import BLOCK, TOUCH
from sim.models.safety import SafetyBounds
from sim.scenario.clearance import report_faults
from sim.scenario.ground_tables import ground_tables
from sim.scenario.safety import largest_tracking_error, noise_range, safety_parameters
from sim.scenario.types import LinkTable, Scenario
from sim.scenario.vehicle_types import Uav, Ugv

GUIDE = "docs/how-to/keep-sight.md"
"""Page that explains the bounds of a certificate and how to choose them."""
_GROUND_GUIDE = "docs/explanation/ground.md"
"""Page that explains the guarantee of a cautious UGV."""
_TIMES = (0.1, 0.2, 0.5, 1.0, 1.5, 2.0, 3.0, 5.0, 8.0, 12.0, 20.0, 30.0)
"""Bounds that are tried as suggestions, from the cheapest on [s]."""
_VERDICTS = {
    Frequency.ALWAYS: "cannot be certified",
    Frequency.THROUGHOUT: "can hardly ever be certified",
    Frequency.CERTAIN: "cannot be certified at known times",
    Frequency.SOMETIMES: "cannot always be certified",
}


class Shortfall(NamedTuple):
    """Assumption that wind, links or detector may break."""

    uav: str
    assumption: str
    """Number in docs/explanation/proof.md, A1 to A9; empty: the declared bounds themselves allow no
    certificate."""
    frequency: Frequency
    what: str
    """Cause, consequence and remedy."""
    by_chance: bool = False
    """True if a declared bound is exceeded at random, so that its exceedance probability covers the shortfall."""

    @property
    def line(self) -> str:
        """Warning in one line."""
        return f"{self.uav}: {self.what}; see {GUIDE}"


def assumption_warnings(scenario: Scenario, links: LinkTable | None = None) -> tuple[str, ...]:
    """Return warnings about the assumptions of the scenario's certificates, one line each.

    Arguments as in `shortfalls`.
    """
    # Unchanged links have the result of the check before the run: the first status costs no time.
    return _assumption_warnings(scenario, None if links == scenario.links else links)


@functools.lru_cache(maxsize=256)
def _assumption_warnings(scenario: Scenario, links: LinkTable | None) -> tuple[str, ...]:
    lines = [found.line for found in shortfalls(scenario, links)]
    return (*lines, *_perfect_detectors(scenario), *ground_warnings(scenario))


def _perfect_detectors(scenario: Scenario) -> Iterator[str]:
    """Warn of each UAV whose certificate relies on detections without any error."""
    for uav in scenario.uav:
        if not scenario.filters(uav):
            continue
        if safety_parameters(scenario, uav.name).max_measurement_error == 0.0:
            source = (
                "certificate.max_measurement_error"
                if scenario.certificate.max_measurement_error == 0.0
                else "detections.noise"
            )
            yield (
                f"{uav.name}: {source} = 0: sight is certified for a detector without any error; for a real detector "
                f"set certificate.max_measurement_error to its largest error [m]; see {GUIDE}"
            )


def how_certifiable(scenario: Scenario) -> str | None:
    """Return how often sight can be certified, as far as known in advance.

    Returns:
        `always`, `not always`, `hardly ever` or `never` (for each UAV with a safety filter); None if none has one.
    """
    if not scenario.uav or not scenario.filtered:
        return None
    found, filters = shortfalls(scenario), sum(map(scenario.filters, scenario.uav))
    if len({one.uav for one in found if one.frequency is Frequency.ALWAYS}) == filters:
        return "never"
    broken = {one.frequency for one in found}
    if broken & {Frequency.ALWAYS, Frequency.THROUGHOUT}:
        return "hardly ever"
    return "not always" if broken else "always"


def shortfalls(scenario: Scenario, links: LinkTable | None = None) -> tuple[Shortfall, ...]:
    """Return the assumptions that a scenario's UAVs cannot rely on, and how often each is broken.

    Args:
        scenario: Scenario to fly; the UAVs' bounds follow from it.
        links: Links as an operator has changed them; None: the scenario's.

    Returns:
        Empty for UAVs without a safety filter. Shortfalls expected less than once in a million runs are left out.
    """
    table, found = links or scenario.links, list[Shortfall]()
    for uav in filter(scenario.filters, scenario.uav):
        brief = uav_briefing(scenario, uav.name, scenario.seed)
        bounds, fault = bounds_of(brief), altitude_fault(scenario, uav, brief)
        if fault:
            what = f"sight cannot be certified: {fault}"
            found.append(Shortfall(uav.name, "", Frequency.ALWAYS, what))
            continue
        start = low_start(scenario, uav, brief)
        if start:
            what = f"sight cannot be certified at the start: {start}"
            found.append(Shortfall(uav.name, "", Frequency.CERTAIN, what))
        found += [
            Shortfall(uav.name, "", Frequency.ALWAYS, f"sight cannot be certified: {fault}")
            for fault in check_assumptions(bounds)
        ]
        for assumption, one in _findings(scenario, table, uav, bounds):
            remedy = one.remedy or _remedy(scenario, table, uav, assumption, one)
            by_chance = assumption == "A1" or (
                assumption in ("A2", "A5'") and one.frequency is not Frequency.CERTAIN
            )
            what = (
                f"{one.cause}: sight {_VERDICTS[one.frequency]} with {_declared(bounds, one.field)} ({assumption}); "
                f"{remedy}"
            )
            found.append(Shortfall(uav.name, assumption, one.frequency, what, by_chance))
    return tuple(found)


def _findings(
    scenario: Scenario, table: LinkTable, uav: Uav, bounds: SafetyBounds
) -> Iterator[tuple[str, Finding]]:
    """Yield each broken assumption of a UAV, with its number."""
    if math.isfinite(bounds.placed_error):
        for finding in _measurement_errors(scenario, uav, bounds.max_measurement_error):
            yield "A1", finding
        for finding in _tracking_errors(scenario, uav, bounds):
            yield "A6'", finding
    for kind, assumption, check in (
        (LinkKind.DETECTIONS, "A2", age_findings),
        (LinkKind.COMMANDS, "A5'", interval_findings),
    ):
        for finding in check(InspectedLink(scenario, table, uav.name, kind), bounds):
            yield assumption, finding


def _declared(bounds: SafetyBounds, field: str) -> str:
    """Return a declared bound as the scenario writes it."""
    values = {
        "max_measurement_error": f"{exact(bounds.max_measurement_error)} m",
        "max_tracking_error": f"{exact(bounds.max_tracking_error)} m",
        "max_measurement_age": f"{exact(bounds.max_measurement_age)} s",
        "max_command_delay": f"{bounds.delay_ticks * bounds.dt:.9g} s",
        "max_command_interval": f"{bounds.interval_ticks * bounds.dt:.9g} s",
    }
    return f"certificate.{field} = {values[field]}"


def _remedy(
    scenario: Scenario, table: LinkTable, uav: Uav, assumption: str, finding: Finding
) -> str:
    """Return the smallest bound that removes a finding and can be certified, as an option of the command line."""
    field, last = f"certificate.{finding.field}", 0.0
    for value in finding.values or _longer_times(scenario, uav, finding.field):
        tried = msgspec.structs.replace(
            scenario,
            certificate=msgspec.structs.replace(scenario.certificate, **{finding.field: value}),
        )
        found = _findings(tried, table, uav, monitored_bounds(tried, uav.name))
        if any(assumption == other for other, _ in found):
            last = value
            continue
        if check_assumptions(bounds_of(uav_briefing(tried, uav.name, tried.seed))):
            cause = f"{field} = {exact(value)} would cover this, but allows no certificate"
            return f"{cause}; improve the link, the detector or the UAV"
        return f"try --set {field}={exact(value)}"
    if last == 0.0:
        return "improve the link or the detector"
    unit = "m" if finding.field in ("max_measurement_error", "max_tracking_error") else "s"
    return f"even {field} = {exact(last)} {unit} is exceeded; improve the link or the detector"


def _longer_times(scenario: Scenario, uav: Uav, field: str) -> Iterable[float]:
    """Return the times that exceed a declared bound [s]."""
    declared: float = getattr(safety_parameters(scenario, uav.name), field)
    return [time for time in _TIMES if time > declared * (1.0 + TICK_TOLERANCE)]


def _measurement_errors(scenario: Scenario, uav: Uav, bound: float) -> Iterator[Finding]:
    """Find detections whose error exceeds the bound [m], for the largest noise of the UAV."""
    (least, most), cut = noise_range(scenario, uav), scenario.detections.truncation
    share = error_share(most, cut, bound)
    if share * scenario.ticks / scenario.detection_period <= RARE:
        return
    noise, up_to = f"detections.noise = {exact(scenario.detections.noise)} m", ""
    if most > least:
        limits = "sensor.range and max_altitude"
        noise, up_to = f"{noise}, which grows to {most:.3g} m at {limits}", "up to "
    cause = f"{noise}: {up_to}{percent(share)} of the detections have a larger error"
    frequency, field = frequency_of(error_share(least, cut, bound)), "max_measurement_error"
    if math.isinf(cut):
        error = exact(_rounded_up(3.0 * most))
        remedy = f"try --set detections.truncation=3 and certificate.{field}={error} or more"
        yield Finding(frequency, f"detections.truncation = inf, {cause}", field, remedy=remedy)
        return
    yield Finding(frequency, cause, field, values=(_rounded_up(most * cut),))


def _tracking_errors(scenario: Scenario, uav: Uav, bounds: SafetyBounds) -> Iterator[Finding]:
    """Find a tracking error that wind and position error allow beyond the bound."""
    largest = largest_tracking_error(scenario, uav)
    if math.isinf(largest):
        return  # unknown: the run counts each excess
    if largest > bounds.max_tracking_error * (1.0 + TICK_TOLERANCE):
        shown = above(largest, bounds.max_tracking_error, 3)
        yield Finding(
            Frequency.SOMETIMES,
            f"wind and uav.position_error allow a tracking error of {shown} m",
            "max_tracking_error",
            values=(_rounded_up(largest),),
        )


def _rounded_up(value: float) -> float:
    """Return a value rounded up to three significant digits."""
    if not (0.0 < value < math.inf):
        return value
    step = 10.0 ** (math.floor(math.log10(value)) - 2)
    return float(f"{math.ceil(value / step * (1.0 - TICK_TOLERANCE)) * step:.3g}")


def certified_from(briefing: UavBriefing) -> str:
    """Return the lowest certified altitude and its cause in one clause; empty in the plane, or if there is none."""
    lowest = lowest_certified(briefing)
    if lowest is None:
        return ""
    return f"sight can be certified at {_up(lowest)} m or higher{_cause(briefing, lowest)}"


def _up(altitude: float) -> str:
    """Return an altitude, rounded up to a centimetre, as text."""
    return f"{math.ceil(100.0 * altitude) / 100.0:.2f}"


def _cause(briefing: UavBriefing, lowest: float) -> str:
    """Return why sight can be certified from an altitude [m] on, as the end of a sentence."""
    limits, camera = briefing.altitude, briefing.camera
    if limits is None or camera is None:
        return ""
    if lowest <= limits.min_altitude:
        return ", from the lowest altitude of the UAV on"
    if lowest <= least_altitude(briefing):
        return (
            f", that is {exact(limits.vertical_clearance)} m above the highest building "
            f"({exact(briefing.max_building_height or 0.0)} m)"
        )
    seen = (lowest - briefing.marker_height) * math.tan(camera.half_angle)
    if radius_at(briefing, lowest) >= seen - 1e-6:
        return f"; there, the camera sees a UGV within {seen:.2f} m"
    return (
        f"; there, buildings up to {exact(briefing.max_building_height or 0.0)} m high cannot hide a UGV that is "
        f"within {radius_at(briefing, lowest):.2f} m and at least {exact(briefing.guaranteed_clearance)} m from them"
    )


def altitude_fault(scenario: Scenario, uav: Uav, briefing: UavBriefing) -> str:
    """Return why the altitudes or buildings of a scenario prevent certificates; empty if they do not.

    Args:
        scenario: The scenario.
        uav: The UAV.
        briefing: Its briefing.
    """
    if briefing.altitude is None:
        return ""
    (escorted,) = (ugv for ugv in scenario.ugv if ugv.name == uav.escorts)
    fault = hiding_fault(scenario, escorted)
    if fault:
        return f"{uav.escorts} guarantees no distance from buildings, which may hide it: {fault}"
    lowest = lowest_certified(briefing)
    if lowest is None:
        highest = briefing.altitude.max_altitude
        floor = least_altitude(briefing)
        if floor > highest:
            needed = f"the {above(floor, highest)} m that clear the highest building"
            return f"max_altitude = {exact(highest)} m: lower than {needed}"
        if bounds_at(briefing).valid:
            return (
                f"even at max_altitude = {exact(highest)} m the UGV is visible within "
                f"{radius_at(briefing, highest):.2f} m only; raise max_altitude, camera.half_angle or "
                "ugv.building_clearance"
            )
    return ""


def low_start(scenario: Scenario, uav: Uav, briefing: UavBriefing) -> str:
    """Return why sight is not certified before the safety filter has climbed; empty if it need not climb.

    Arguments as in `altitude_fault`.
    """
    if briefing.altitude is None or scenario.altitude.law != "fixed":
        return ""
    lowest, start = lowest_certified(briefing), briefing.altitude.initial_altitude
    if lowest is None or start >= lowest:
        return ""
    return f"initial_altitude = {exact(start)} m: too low, so the safety filter climbs; {certified_from(briefing)}"


def ground_warnings(scenario: Scenario) -> Iterator[str]:
    """Warn of each cautious UGV that navigates without the guarantee, and name the broken assumption."""
    if not scenario.has_ground:
        return
    for k, ugv in enumerate(scenario.ugv):
        if ugv.driver == "navigate" and ugv.caution == CAUTIONS[0]:
            reports = () if scenario.only_known_buildings else report_faults(scenario, ugv)
            for reason in (*_start_faults(scenario, k, ugv), *reports):
                yield f"{ugv.name}: not certified to stay on known tiles: {reason}; see {_GROUND_GUIDE}"


def _start_faults(scenario: Scenario, k: int, ugv: Ugv) -> Iterator[str]:
    """Yield the faults of a start: the UGV must be at rest, and all tiles that it touches drivable."""
    if ugv.velocity != (0.0, 0.0):
        yield f"ugv.{k}.velocity = {list(ugv.velocity)}: the UGV starts moving; allowed: 0"
    tiles, tile = ground_tables(scenario).tiles, scenario.ground.tile
    rows, columns = tiles.shape
    x, y = ugv.position
    around = tiles[
        slice(*span(y - TOUCH, y + TOUCH, tile, rows)),
        slice(*span(x - TOUCH, x + TOUCH, tile, columns)),
    ]
    if (around == BLOCK).any():
        yield f"ugv.{k}.position = {list(ugv.position)}: the UGV touches a blocked tile; move it"
