"""Claims of the paper's figures, each checked with simulated flights."""

import itertools
import math
from collections.abc import Sequence

import msgspec
import numpy as np

from agents.control.weighting import check_weighting
from bus.errors import ScenarioError
from bus.law_parameters import law_parameters
from outrider.experiments.traces import (
    PEAK,
    WINDOW,
    crossings,
    distance,
    error,
    peaks,
    rise,
    searching,
    stop_row,
    turns,
    until,
    velocity_errors,
    weighting_of,
)
from outrider.running.summary import switching_radius_of
from sim.scenario.types import Scenario
from sim.server.flight import Flight

GONE = 1e-3
"""Share of e(0) below which e(t) counts as zero."""
SLIDING = 10
"""Number of rises to r_s from which on a distance counts as sliding along r_s."""
BESIDE = 40.0
"""Time for which the UGV of scenario 2 drives beside covered ground [s]."""


class Claim(msgspec.Struct, frozen=True, kw_only=True):
    """Row of the table of claims."""

    figure: str
    """Figure and sub-figure of the paper; `anchor`: comparison with a reference value."""
    claim: str
    value: str
    """Measured value, with unit."""
    number: float
    """Measured value as one number, in SI units."""
    holds: bool


def _farthest(*flights: Flight) -> list[float]:
    return [float(distance(flight).max()) for flight in flights]


def claims_1(low: Flight, high: Flight, bounded: Flight) -> list[Claim]:
    """Check figure 1: coverage alone, eq. (11), with a low and a high k_v, and with a high k_v and bounded input."""
    flights = {"low k_v": low, "high k_v": high, "high k_v, bounded": bounded}
    r_v, far = low.scenario.visibility.radius, _farthest(low, high, bounded)
    return [
        Claim(
            figure="1a",
            claim="coverage alone leaves the circle of radius r_v around the UGV",
            value=f"{', '.join(f'{name}: {d:.2f} m' for name, d in zip(flights, far, strict=True))}; r_v = {r_v:g} m",
            number=min(far),
            holds=min(far) > r_v,
        ),
        *_claims_1b(low, high),
        *(_claim_vanishing(name, flight) for name, flight in flights.items()),
        _claim_rising(list(flights.values())),
    ]


def _claims_1b(low: Flight, high: Flight) -> list[Claim]:
    (e_low, w_low), (e_high, w_high) = velocity_errors(low), velocity_errors(high)
    n_low, n_high = np.linalg.norm(e_low, axis=1), np.linalg.norm(e_high, axis=1)
    searches = searching(w_high)
    off_low, off_high = n_low[searching(w_low)], n_high[searches]
    rms_low, rms_high = (float(np.sqrt((n**2).mean())) for n in (off_low, off_high))
    mean_low, mean_high = float(off_low.mean()), float(off_high.mean())
    k_low, k_high = (law_parameters(one.scenario.law).speed_gain for one in (low, high))
    gains = f"k_v {k_low:g} and {k_high:g}"
    v_ref = float(np.linalg.norm(w_high, axis=1).max())
    found = [
        k
        for k in peaks(n_high, v_ref).tolist()
        if k >= WINDOW and searches[k - WINDOW : k + 1].all()
    ]
    turned = turns(w_high)
    least = math.degrees(min(turned[found], default=0.0))
    usual = math.degrees(float(np.quantile(turned[searches], 0.95)))
    return [
        Claim(
            figure="1b",
            claim="the velocity error falls with a higher k_v",
            value=f"mean {mean_low:.3f} and {mean_high:.3f} m/s, RMS {rms_low:.3f} and {rms_high:.3f} m/s at {gains}",
            number=mean_high / mean_low,
            holds=mean_high < mean_low and rms_high < rms_low,
        ),
        Claim(
            figure="1b",
            claim="at a high k_v, the velocity error peaks only where u_si turns",
            value=f"{len(found)} peaks above {PEAK * v_ref:.2f} m/s while something is uncovered, each after a turn of "
            f"{least:.0f}° or more; 95 % of the ticks turn by less than {usual:.1f}°",
            number=float(len(found)),
            holds=len(found) > 0 and least > 5.0 * usual,
        ),
    ]


def _claim_vanishing(name: str, flight: Flight) -> Claim:
    e, stop = error(flight), stop_row(flight)
    gone = np.flatnonzero(e[stop:] < GONE * e[0])
    wait = float(gone[0]) * flight.scenario.dt if gone.size else math.inf
    return Claim(
        figure="1c",
        claim=f"e(t) falls to zero after the UGV has stopped: {name}",
        value=f"below {GONE:.1%} of e(0) {wait:.1f} s after the stop, {e[-1]:.3g} m² at the end",
        number=float(e[-1]),
        holds=bool(gone.size) and bool((np.diff(e[stop:]) <= 0.0).all()),
    )


def _claim_rising(flights: Sequence[Flight]) -> Claim:
    rises = [rise(error(flight)[: stop_row(flight) + 1]) for flight in flights]
    return Claim(
        figure="1c",
        claim="e(t) can rise while the UGV moves",
        value=f"rises add up to {min(rises):.0f} m² or more",
        number=min(rises),
        holds=min(rises) > 0.0,
    )


def claims_2(scenarios: Sequence[Scenario]) -> list[Claim]:
    """Check figure 2: the weighting functions satisfy the conditions of Proposition 2."""
    return [_claim_weighting(scenario) for scenario in scenarios]


def _claim_weighting(scenario: Scenario) -> Claim:
    weighting, r_s = weighting_of(scenario)
    try:
        check_weighting(weighting, r_s)
        fault = ""
    except ScenarioError as found:
        fault = str(found)
    betas = [weighting(d, r_s)[1] for d in np.linspace(0.0, 2.0 * r_s, 2001).tolist()]
    falling = all(later <= earlier for earlier, later in itertools.pairwise(betas))
    return Claim(
        figure="2",
        claim=f"{scenario.law.name} weights: α = 1, β = 0 from r_s on (Proposition 2); β never rises with distance",
        value=fault
        or f"r_s = {r_s:.3f} m; β = {betas[0]:g} at 0 m, {betas[500]:.3g} at r_s/2, {max(betas[1000:]):g} beyond r_s",
        number=r_s,
        holds=not fault and falling,
    )


def claims_3(linear: Flight, switching: Flight, logarithmic: Flight) -> list[Claim]:
    """Check figure 3: the distance under the three weightings."""
    flights = {"linear": linear, "switching": switching, "logarithmic": logarithmic}
    r_v, r_s = linear.scenario.visibility.radius, switching_radius_of(linear) or math.nan
    far, rises = _farthest(*flights.values()), [crossings(flight) for flight in flights.values()]
    mean = [float(distance(flight).mean()) for flight in flights.values()]
    kept = [
        Claim(
            figure="3",
            claim=f"{name}: ‖p_Δ‖ < r_v",
            value=f"{d:.3f} m of {r_v:g} m",
            number=d,
            holds=d < r_v,
        )
        for name, d in zip(flights, far, strict=True)
    ]
    return [
        *kept,
        Claim(
            figure="3",
            claim="linear is conservative: it stays closest, well inside r_s",
            value=f"largest {far[0]:.2f} m, {far[0] / r_s:.0%} of r_s = {r_s:.3f} m; mean {mean[0]:.2f} m",
            number=far[0] / r_s,
            holds=far[0] < min(r_s, far[1], far[2]) and rises[0] == 0,
        ),
        Claim(
            figure="3",
            claim="switching slides on r_s",
            value=f"rises to r_s {rises[1]} times, {(distance(switching) >= r_s).mean():.0%} of the time beyond it",
            number=float(rises[1]),
            holds=rises[1] >= SLIDING,
        ),
        Claim(
            figure="3",
            claim="logarithmic goes farther out than linear, without sliding",
            value=f"largest {far[2]:.2f} m, mean {mean[2]:.2f} m; rises to r_s {rises[2]} times",
            number=mean[2] - mean[0],
            holds=far[2] > far[0] and mean[2] > mean[0] and rises[2] == 0,
        ),
    ]


def _claims_lower(figure: str, coverage: Flight, circle: Flight) -> list[Claim]:
    e, e_circle = error(coverage), error(circle)
    share, ratio = float((e < e_circle).mean()), float(e.mean() / e_circle.mean())
    far = _farthest(coverage, circle)
    r_v = coverage.scenario.visibility.radius
    return [
        Claim(
            figure=f"{figure}c",
            claim="e(t) is lower for coverage than for the circle, most of the time",
            value=f"{share:.0%} of the time",
            number=share,
            holds=share > 0.5,
        ),
        Claim(
            figure=f"{figure}c",
            claim="e(t) is lower for coverage on average",
            value=f"mean {e.mean():.1f} m², circle {e_circle.mean():.1f} m²",
            number=ratio,
            holds=ratio < 1.0,
        ),
        Claim(
            figure=f"{figure}ab",
            claim="both keep the UGV in sight",
            value=f"largest distance {far[0]:.2f} m, circle {far[1]:.2f} m; r_v = {r_v:g} m",
            number=max(far),
            holds=max(far) < r_v,
        ),
    ]


def claims_4(coverage: Flight, circle: Flight) -> list[Claim]:
    """Check figure 4: coverage against the circle, on uncovered ground."""
    return _claims_lower("4", coverage, circle)


def claims_5(
    open_coverage: Flight, open_circle: Flight, coverage: Flight, circle: Flight
) -> list[Claim]:
    """Check figure 5: coverage against the circle beside covered ground, compared with the open ground of figure 4."""
    near = until(coverage, BESIDE)
    e, e_circle = error(coverage)[near], error(circle)[near]
    ratio = float(e.mean() / e_circle.mean())
    ratio_open = float(error(open_coverage)[near].mean() / error(open_circle)[near].mean())
    return [
        *_claims_lower("5", coverage, circle),
        Claim(
            figure="5c",
            claim=f"beside covered ground (0 to {BESIDE:g} s) the difference is larger",
            value=f"mean {e.mean():.1f} m² is {ratio:.0%} of {e_circle.mean():.1f} m² (circle); on open ground "
            f"{ratio_open:.0%}",
            number=ratio,
            holds=ratio < ratio_open,
        ),
        Claim(
            figure="5c",
            claim="e(t) is steadier",
            value=f"standard deviation {e.std():.1f} m², rises by {rise(e):.0f} m² in all; circle "
            f"{e_circle.std():.1f} m², "
            f"{rise(e_circle):.0f} m²",
            number=float(e.std() / e_circle.std()),
            holds=bool(e.std() < e_circle.std()) and rise(e) < rise(e_circle),
        ),
    ]


def claim_collapse(too_fast: Flight) -> Claim:
    """Check that the paper's omega_pv = 1 rad/s exceeds the abilities of its vehicle (Remark 3)."""
    mean, law = float(distance(too_fast).mean()), too_fast.scenario.law
    return Claim(
        figure="4b",
        claim=f"a circle at {law_parameters(law).circle_rate:g} rad/s cannot be flown and collapses (Remark 3)",
        value=f"mean distance {mean:.2f} m where r_s = {switching_radius_of(too_fast) or math.nan:.2f} m is asked for",
        number=mean,
        holds=mean < 1.0,
    )


def claim_anchor(what: str, found: float, known: float, unit: str, tolerance: float) -> Claim:
    """Compare a measured value with a reference value, from a formula or an independent program.

    Args:
        what: Name of the value.
        found: Measured value.
        known: Reference value.
        unit: Unit of both, with a leading space; empty for a count.
        tolerance: Largest difference, in the same unit.
    """
    return Claim(
        figure="anchor",
        claim=what,
        value=f"{found:.5g}{unit}, known {known:g} ± {tolerance:g}{unit}",
        number=found,
        holds=abs(found - known) <= tolerance,
    )
