"""Reproduction of the paper's figures 1 to 5, and the table of their claims."""

from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from bus.law_parameters import law_parameters
from bus.messages.scenario import Region
from outrider import style
from outrider.experiments.claims import (
    BESIDE,
    Claim,
    claim_anchor,
    claim_collapse,
    claims_1,
    claims_2,
    claims_3,
    claims_4,
    claims_5,
)
from outrider.experiments.traces import (
    crossings,
    distance,
    error,
    stop_row,
    velocity_errors,
    weighting_of,
)
from outrider.running.flying import fly
from outrider.view.flight_picture import draw_map, times
from sim.env.rewards import full_error
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario
from sim.scene.drawing import Track, draw_ring, ground, legend_of
from sim.scene.known import scene_of
from sim.server.flight import Flight
from sim.world import World

Flights = dict[str, Flight]

GAINS = ("low", "high", "bounded")
"""Flights of figure 1."""
WEIGHTINGS = ("linear", "switching", "logarithmic")
"""Flights of figure 3."""


def make_figures(
    out: Path, *, on_progress: Callable[[str, float], None] | None = None
) -> list[Claim]:
    """Fly the paper's experiments, draw figure-1.png to figure-5.png, and check the claims.

    Args:
        out: Folder for the pictures; created if missing.
        on_progress: Called with the current step and the share done.

    Returns:
        The claims, figure by figure, then comparisons with reference values.

    Raises:
        OSError: If a picture cannot be written.
    """
    report = on_progress or (lambda _what, _share: None)
    out.mkdir(parents=True, exist_ok=True)
    flights = fly_all(lambda what, share: report(what, 0.6 * share))
    for number, draw in enumerate((figure_1, figure_2, figure_3, figure_4, figure_5), start=1):
        report(f"drawing figure {number}", 0.6 + 0.08 * (number - 1))
        with style.plot_style():
            style.save(draw(flights), out / f"figure-{number}.png")
    claims = all_claims(flights)
    report("done", 1.0)
    return claims


def experiments() -> dict[str, Scenario]:
    """Return the scenarios of the figures by a short name."""
    first, second = load_scenario("scenario-1"), load_scenario("scenario-2")
    return {
        "low": load_scenario("figure-1-low-gain"),
        "high": load_scenario("figure-1-high-gain"),
        "bounded": load_scenario("figure-1-bounded"),
        **{law: load_scenario(f"figure-3-{law}") for law in WEIGHTINGS},
        "circle": load_scenario("circle"),
        "too fast": load_scenario("circle-too-fast"),
        "open": first,
        "open, circle": _by_circle(first),
        "beside": second,
        "beside, circle": _by_circle(second),
    }


def _by_circle(scenario: Scenario) -> Scenario:
    circle = msgspec.structs.replace(scenario.law, name="circle")
    return msgspec.structs.replace(scenario, law=circle)


def fly_all(on_progress: Callable[[str, float], None]) -> Flights:
    """Fly every experiment."""
    flights: Flights = {}
    planned = experiments()
    for number, (name, scenario) in enumerate(planned.items()):
        on_progress(f"flying {scenario.name}", number / len(planned))
        flights[name] = fly(scenario, scenario.seed)[0]
    return flights


def all_claims(flights: Flights) -> list[Claim]:
    """Return the claims of the five figures, then comparisons with reference values."""
    return [
        *claims_1(*(flights[name] for name in GAINS)),
        *claims_2([flights[law].scenario for law in WEIGHTINGS]),
        *claims_3(*(flights[law] for law in WEIGHTINGS)),
        *claims_4(flights["open"], flights["open, circle"]),
        claim_collapse(flights["too fast"]),
        *claims_5(
            *(flights[name] for name in ("open", "open, circle", "beside", "beside, circle"))
        ),
        *_anchors(flights),
    ]


def _anchors(flights: Flights) -> Iterator[Claim]:
    """Compare with an independent program, for a UGV on a straight line, and with the error of uncovered ground."""
    scenario = flights["open"].scenario
    middle = (0.5 * scenario.area.width, 0.5 * scenario.area.height)
    ugvs = tuple(msgspec.structs.replace(ugv, position=middle) for ugv in scenario.ugv)
    world = World(msgspec.structs.replace(scenario, ugv=ugvs), 0)
    bare, c = float(world.measure()[0, 1]), world.parameters
    yield claim_anchor("e(0) over uncovered ground", bare, full_error(c.r_o, c.desired), " m²", 0.1)
    far = {name: float(distance(flight).max()) for name, flight in flights.items()}
    yield claim_anchor("largest distance, coverage alone", far["bounded"], 9.4, " m", 0.1)
    # Sliding is chaotic: a start 1 mm away changes the switching law's largest distance by 2 cm and its count by
    # 3; 1 cm, by 8.
    for law, known, slack in zip(WEIGHTINGS, (3.12, 4.14, 3.65), (0.02, 0.15, 0.02), strict=True):
        yield claim_anchor(f"largest distance, {law}", far[law], known, " m", slack)
    for law, often, slack in zip(WEIGHTINGS, (0.0, 25.0, 0.0), (0.0, 12.0, 0.0), strict=True):
        rises = float(crossings(flights[law]))
        yield claim_anchor(f"rises to r_s, {law}", rises, often, "", slack)
    for name, known in (("logarithmic", 147.0), ("circle", 254.0)):
        mean = float(error(flights[name]).mean())
        yield claim_anchor(f"mean e(t) on the straight line, {name}", mean, known, " m²", 3.0)


def figure_1(flights: Flights) -> Figure:
    """Draw coverage alone: tracks, velocity error and e(t) for two gains, and with bounded input."""
    figure = style.new_figure(1400, 760)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.05, 1.0))
    gains = {name: law_parameters(flights[name].scenario.law).speed_gain for name in GAINS}
    labels = {name: f"$k_v$ = {gain:g}" for name, gain in gains.items()}
    labels["bounded"] += ", bounded"
    _draw_departure(figure.add_subplot(grid[:, 0]), flights, labels)
    speed, rest = figure.add_subplot(grid[0, 1]), figure.add_subplot(grid[1, 1])
    for name in GAINS:
        flight, color, dash = flights[name], style.GAIN[name], "--" if name == "bounded" else "-"
        if name != "bounded":
            size = np.linalg.norm(velocity_errors(flight)[0], axis=1)
            speed.plot(times(flight)[: len(size)], size, dash, color=color, label=labels[name])
        rest.plot(times(flight), error(flight), dash, color=color, label=labels[name])
    end = flights["high"].scenario.duration
    for axes, letter, title, label in (
        (speed, "b", "Velocity error", r"$\|e_{vel}\|$ [m/s]"),
        (rest, "c", "Coverage error", "e(t) [m²]"),
    ):
        style.over_time(axes, end, label)
        style.panel(axes, letter, title)
        axes.legend(loc="upper right")
    _mark_stop(rest, flights["high"])
    return figure


def _mark_stop(axes: Axes, flight: Flight) -> None:
    when = stop_row(flight) * flight.scenario.dt
    axes.axvline(when, color=style.UGV[0], linewidth=1.2, linestyle=":")
    axes.annotate(
        "UGV stops ",
        (when, 0.93),
        xycoords=("data", "axes fraction"),
        color=style.UGV[0],
        ha="right",
        va="top",
    )


def _draw_departure(axes: Axes, flights: Flights, labels: dict[str, str]) -> None:
    """Draw the tracks of figure 1, and the largest distance of the UAV outside the circle r_v."""
    one = flights["bounded"]
    ground(axes, one.scenario.area.width, one.scenario.area.height)
    a, g = one.world.escorts[0].tolist()
    Track(axes, style.UGV[0], flies=False, label="UGV").move(one.recorder.states[:, g, :2])
    for name in GAINS:
        line = "--" if name == "bounded" else "-"
        track = Track(axes, style.GAIN[name], flies=True, line=line, label=labels[name])
        track.move(flights[name].recorder.states[:, a, :2])
    k = int(distance(one).argmax())
    p_a, p_g = one.recorder.states[k, a, :2], one.recorder.states[k, g, :2]
    (limit,) = scene_of(one.scenario).with_rings("r_v").rings
    draw_ring(axes, limit, (p_g[0], p_g[1]))
    axes.plot(
        *zip(p_a, p_g, strict=True),
        color=style.LIMIT,
        linewidth=1.0,
        linestyle=":",
        marker=".",
        zorder=8,
    )
    when, apart = f"t = {k * one.scenario.dt:.0f} s", f"{distance(one)[k]:.1f} m apart"
    text = f"{when}: {apart}, $r_v$ = {limit.radius:g} m"
    axes.text(0.025, 0.77, text, color=style.LIMIT, transform=axes.transAxes)
    axes.legend(loc="upper left", ncols=2)
    style.panel(axes, "a", "Coverage alone leaves the circle $r_v$")


def figure_2(flights: Flights) -> Figure:
    """Draw the three weightings over distance."""
    figure = style.new_figure(1400, 480)
    axes = figure.subplots(1, 3)
    r_s, r_v = 0.0, flights["linear"].scenario.visibility.radius
    for law in WEIGHTINGS:
        weighting, r_s = weighting_of(flights[law].scenario)
        d = np.linspace(0.0, r_v + 0.25, 2001)
        alpha, beta = np.array([weighting(x, r_s) for x in d.tolist()]).T
        for panel, values in zip(axes, (alpha, beta, beta / (alpha + beta)), strict=True):
            panel.plot(d, values, color=style.law_color(law), label=law)
    titles = (
        (r"Weight of tracking", r"$\alpha$"),
        ("Weight of coverage", r"$\beta$"),
        ("Share of coverage", r"$\beta/(\alpha+\beta)$"),
    )
    for panel, letter, (title, label) in zip(axes, "abc", titles, strict=True):
        for radius, name, line in ((r_s, "$r_s$", style.DASHED), (r_v, "$r_v$", "-")):
            panel.axvline(radius, color=style.LIMIT, linewidth=1.2, linestyle=line, zorder=1.5)
            panel.text(
                radius,
                1.015,
                name,
                color=style.LIMIT,
                ha="center",
                transform=panel.get_xaxis_transform(),
            )
        panel.set(xlim=(0.0, d[-1]), xlabel=r"distance $\|p_\Delta\|$ [m]", ylabel=label)
        style.panel(panel, letter, title)
    axes[1].set_yscale("symlog", linthresh=1.0)
    axes[1].set(
        ylim=(0.0, 130.0), yticks=(0.0, 1.0, 10.0, 100.0), yticklabels=("0", "1", "10", "100")
    )
    axes[0].legend(loc="upper left", bbox_to_anchor=(0.02, 0.92))
    return figure


def figure_3(flights: Flights) -> Figure:
    """Draw the distance under the three weightings, with a detail near r_s."""
    figure = style.new_figure(1400, 700)
    whole, close = figure.subplots(2, 1, sharex=True, height_ratios=(1.3, 1.0))
    one = flights["linear"]
    for law in WEIGHTINGS:
        for axes in (whole, close):
            axes.plot(
                times(flights[law]), distance(flights[law]), color=style.law_color(law), label=law
            )
    for axes, letter, title in (
        (whole, "a", "Distance under the three weightings"),
        (close, "b", "Detail near $r_s$"),
    ):
        style.over_time(axes, one.scenario.duration, r"$\|p_\Delta\|$ [m]")
        style.panel(axes, letter, title)
    r_v, r_s = one.scenario.visibility.radius, weighting_of(one.scenario)[1]
    style.limits_of_sight(whole, r_v, r_s)
    style.limits_of_sight(close, None, r_s)
    whole.set_xlabel("")
    whole.set_ylim(0.0, 1.1 * r_v)
    close.set_ylim(r_s - 0.75, r_s + 0.5)
    style.legend_above(whole)
    return figure


def figure_4(flights: Flights) -> Figure:
    """Draw coverage against the circle on uncovered ground."""
    return _comparison(flights["open"], flights["open, circle"], "")


def figure_5(flights: Flights) -> Figure:
    """Draw coverage against the circle beside covered ground."""
    figure = _comparison(flights["beside"], flights["beside, circle"], "covered before")
    figure.axes[2].axvspan(
        0.0, BESIDE, color=style.COVERAGE(0.6), alpha=0.35, linewidth=0.0, zorder=0.5
    )
    figure.axes[2].text(
        0.5 * BESIDE,
        0.94,
        "beside covered ground",
        transform=figure.axes[2].get_xaxis_transform(),
        ha="center",
        va="top",
    )
    return figure


def _comparison(coverage: Flight, circle: Flight, known: str) -> Figure:
    figure = style.new_figure(1400, 1100)
    grid = figure.add_gridspec(2, 2, height_ratios=(2.1, 1.0))
    for k, (letter, title, flight) in enumerate(
        (("a", "Coverage and tracking", coverage), ("b", "Circle", circle))
    ):
        axes = figure.add_subplot(grid[0, k])
        scene = scene_of(flight.scenario).with_rings("r_v")
        image = draw_map(axes, flight, scene)
        for region in flight.scenario.coverage.covered:
            _outline(axes, region, known)
        style.panel(axes, letter, title)
    below = figure.add_subplot(grid[1, :])
    for law, label, flight in (
        ("logarithmic", "coverage and tracking", coverage),
        ("circle", "circle", circle),
    ):
        below.plot(
            times(flight),
            error(flight),
            color=style.law_color(law),
            label=f"{label}, mean {error(flight).mean():.0f} m²",
        )
    style.over_time(below, coverage.scenario.duration, "e(t) [m²]")
    style.panel(below, "c", "Coverage error")
    below.legend(loc="upper right")
    style.coverage_bar(figure, image, figure.axes[:2])
    figure.axes[0].legend(handles=legend_of(scene), loc="upper left", ncols=4)
    return figure


def _outline(axes: Axes, region: Region, known: str) -> None:
    (west, south), (east, north) = region.lower, region.upper
    axes.add_patch(
        Rectangle(
            region.lower,
            east - west,
            north - south,
            fill=False,
            edgecolor="#5f9a7b",
            hatch="///",
            linewidth=0.8,
            alpha=0.6,
        )
    )
    middle = 0.5 * (west + east), 0.5 * (south + north)
    axes.text(*middle, known, ha="center", va="center", color=style.INK)
