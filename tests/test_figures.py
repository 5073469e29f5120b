"""The paper's figures and their claims: the claims hold, and each could fail."""

import itertools
import math
import struct

import msgspec
import numpy as np
import pytest

import reference_field as reference
from bus.messages.scenario import Law
from flights import DESIRED, DT, R_S, R_V, R
from outrider.experiments import paper_figures
from outrider.experiments.claims import (
    claim_collapse,
    claims_1,
    claims_2,
    claims_3,
    claims_4,
    claims_5,
)
from outrider.experiments.paper_figures import WEIGHTINGS, all_claims, fly_all, make_figures
from outrider.experiments.traces import (
    crossings,
    distance,
    error,
    searching,
    stop_row,
    velocity_errors,
)
from outrider.running.flying import fly
from pages import marked
from sim.scenario.loading import load_scenario
from tabular import rows, words

CELL = 0.25
WIDTHS = {1: (1400, 760), 2: (1400, 480), 3: (1400, 700), 4: (1400, 1100), 5: (1400, 1100)}


@pytest.fixture(scope="module")
def flights():
    return fly_all(lambda what, share: None)


@pytest.fixture(scope="module")
def claims(flights):
    return all_claims(flights)


@pytest.fixture(scope="module")
def made(tmp_path_factory, flights):
    """Return the pictures of these runs, their claims, and the reported progress."""
    out, steps = tmp_path_factory.mktemp("figures") / "a" / "b", []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(paper_figures, "fly_all", lambda report: (report("flown", 1.0), flights)[1])
        claims = make_figures(out, on_progress=lambda what, share: steps.append((what, share)))
    return out, claims, steps


def found(claims, figure, words):
    """Return the one claim of this figure that contains these words."""
    (claim,) = [claim for claim in claims if claim.figure == figure and words in claim.claim]
    return claim


def failing(claims):
    return {(claim.figure, claim.claim) for claim in claims if not claim.holds}


def brute_errors(flight, ticks):
    """Return e(t) at the first ticks by the reference on the whole grid, from the recorded track."""
    coverage = np.zeros((160, 160))
    x, y = reference.centres(coverage, CELL)
    for region in flight.scenario.coverage.covered:
        (x_0, y_0), (x_1, y_1) = region.lower, region.upper
        coverage[(x >= x_0) & (x <= x_1) & (y >= y_0) & (y <= y_1)] = DESIRED
    a, g = flight.world.escorts[0]
    errors = []
    for k in range(ticks):
        p_a, p_g = flight.recorder.states[k, a, :2], flight.recorder.states[k, g, :2]
        if k:
            coverage = reference.accumulate(coverage, *p_a, reference.HILL, 1.0, R, CELL, DT)
        errors.append(reference.coverage_error(coverage, *p_g, R_V + R, DESIRED, CELL))
    return np.array(errors)


def test_five_pictures_are_made_and_progress_rises_to_the_end(made):
    out, _, steps = made
    for number, size in WIDTHS.items():
        data = (out / f"figure-{number}.png").read_bytes()
        assert struct.unpack(">II", data[16:24]) == size
        assert 30_000 < len(data) < 400_000
    assert len(list(out.iterdir())) == len(WIDTHS)
    shares = [share for _, share in steps]
    assert shares == sorted(shares)
    assert (len(shares), shares[-1]) == (7, 1.0)


def test_shown_claims_are_those_of_the_figures(made):
    _, *table = marked("claims", "docs/explanation/paper.md")
    assert [(row[0], row[1], row[-1]) for row in table] == [
        (c.figure, c.claim, "yes" if c.holds else "**no**") for c in made[1]
    ]


def test_every_claim_holds(claims):
    assert failing(claims) == set()
    assert all(math.isfinite(claim.number) and claim.value for claim in claims)


def test_claims_of_figure_3_are_those_of_the_recorded_positions(flights, claims):
    for law in WEIGHTINGS:
        states = flights[law].recorder.states
        far = [math.dist(row[0, :2], row[1, :2]) for row in states]
        often = sum(before < R_S <= now for before, now in itertools.pairwise(far))
        assert found(claims, "3", f"{law}: ‖p_Δ‖").number == pytest.approx(max(far), abs=1e-12)
        rises = found(claims, "anchor", f"rises to r_s, {law}").number
        assert rises == often == crossings(flights[law])


def test_claims_of_figure_5_are_those_of_a_brute_force_integral(flights, claims):
    ours = brute_errors(flights["beside"], 801)
    circle = brute_errors(flights["beside, circle"], 801)
    np.testing.assert_allclose(error(flights["beside"])[:801], ours, rtol=1e-9, atol=1e-9)
    larger, steadier = (found(claims, "5c", part).number for part in ("is larger", "steadier"))
    assert larger == pytest.approx(ours.mean() / circle.mean(), rel=1e-9)
    assert steadier == pytest.approx(ours.std() / circle.std(), rel=1e-9)


def test_velocity_error_times_k_v_is_what_the_unbounded_uav_flew(flights):
    for name, k_v in (("low", 1.0), ("high", 10.0)):
        flight = flights[name]
        a = flight.world.escorts[0, 0]
        flown = flight.recorder.states[:-1, a, 4:6]
        p = flight.recorder.states[:-1, a, :2]
        # at the border of Q the coverage term is limited
        inside = ((p > 0.0) & (p < 40.0)).all(axis=1)
        errors, wanted = velocity_errors(flight)
        np.testing.assert_allclose(flown[inside], k_v * errors[inside], rtol=0.0, atol=1e-12)
        speeds = np.linalg.norm(wanted, axis=1)
        np.testing.assert_allclose(speeds[searching(wanted)], 0.6, atol=1e-12)
        np.testing.assert_allclose(speeds[~searching(wanted)], 0.0, atol=1e-12)


def test_velocity_error_includes_ground_covered_initially():
    free = words("law.name=coverage law.parameters.reference_speed=0.6 uav.0.max_speed=inf")
    free += words("uav.0.max_acceleration=inf duration=20.0")
    flight, _ = fly(load_scenario("scenario-2", overrides=free), 0)
    flown = flight.recorder.states[:-1, flight.world.escorts[0, 0], 4:6]
    np.testing.assert_allclose(flown, 10.0 * velocity_errors(flight)[0], rtol=0.0, atol=1e-12)


def test_ugv_stands_still_from_its_stop_on(flights):
    flight = flights["high"]
    g, stop = flight.world.escorts[0, 1], stop_row(flight)
    assert 140.0 < stop * DT < 150.0
    np.testing.assert_allclose(flight.recorder.states[stop:, g, :2] - [34.0, 20.0], 0.0, atol=0.06)
    assert np.linalg.norm(flight.recorder.states[stop - 1, g, 2:4]) > 0.0


@pytest.fixture(scope="module")
def others(flights):
    """Return the flights, and others that must break claims."""
    changed = {
        "coverage alone": ("figure-3-logarithmic", "law.name=coverage"),
        "too short": ("figure-1-high-gain", "duration=100.0"),
        "open, coverage alone": ("scenario-1", "law.name=coverage"),
    }
    return flights | {
        name: fly(load_scenario(scenario, overrides=[change]), 0)[0]
        for name, (scenario, change) in changed.items()
    }


@pytest.mark.parametrize(
    ("flown", "figure", "claim"),
    rows("""
low; high; logarithmic | 1a | coverage alone leaves the circle of radius r_v around the UGV
high; low; bounded | 1b | the velocity error falls with a higher k_v
low; linear; bounded | 1b | at a high k_v, the velocity error peaks only where u_si turns
low; too short; bounded | 1c | e(t) falls to zero after the UGV has stopped: high k_v
linear; logarithmic; switching | 3 | switching slides on r_s
linear; logarithmic; switching | 3 | logarithmic goes farther out than linear, without sliding
linear; switching; coverage alone | 3 | logarithmic goes farther out than linear, without sliding
linear; switching; coverage alone | 3 | logarithmic: ‖p_Δ‖ < r_v
switching; linear; logarithmic | 3 | linear is conservative: it stays closest, well inside r_s
open, coverage alone; open, circle | 4ab | both keep the UGV in sight
open; open, circle; beside, circle; beside | 5c | beside covered ground (0 to 40 s) the difference is larger
open; open, circle; beside, circle; beside | 5c | e(t) is steadier
"""),
)
def test_wrong_flights_break_the_claims(others, flown, figure, claim):
    make = {"1": claims_1, "3": claims_3, "4": claims_4, "5": claims_5}[figure[0]]
    assert (figure, claim) in failing(make(*(others[name] for name in flown.split("; "))))


def test_swapped_flights_break_only_the_lower_errors_of_figure_4(flights):
    wrong = failing(claims_4(flights["open, circle"], flights["open"]))
    assert {claim for _, claim in wrong} == {
        "e(t) is lower for coverage than for the circle, most of the time",
        "e(t) is lower for coverage on average",
    }


def test_a_weighting_without_tracking_breaks_figure_2():
    scenario = load_scenario("figure-3-linear")
    (claim,) = claims_2([msgspec.structs.replace(scenario, law=Law(name="coverage"))])
    assert not claim.holds
    assert "Proposition 2 asks for alpha = 1" in claim.value


def test_a_circle_that_can_be_flown_does_not_collapse(flights):
    assert claim_collapse(flights["too fast"]).holds
    assert not claim_collapse(flights["circle"]).holds
    assert distance(flights["circle"]).mean() > 3.0


def test_error_over_bare_ground_is_the_formula_s(claims):
    assert found(claims, "anchor", "e(0)").number == pytest.approx(
        8.0 * math.pi * 9.75**2 * (0.5 - 2.0 / math.pi**2), abs=0.01
    )
