"""Work of `outrider quadrotor`."""

from collections.abc import Callable, Sequence

import typer

from outrider.cli.console import OUT, print_json, print_table, share_progress
from outrider_quadrotor.comparison import Flights, compare
from outrider_quadrotor.measurement import Measurement, measure
from sim.scenario.types import Scenario

_ERRORS = ("UAV", "reference", "flights", "largest [m]", "99.9 % [m]", "median [m]", "vertical [m]")


def print_measurement(
    scenario: Scenario, flights: int, margin: float, *, markdown: bool, json: bool
) -> None:
    """Measure the tracking error, and print it with a proposal."""
    with share_progress("measuring") as tell:
        found = measure(scenario, flights, margin, tell)
    if json:
        print_json(found)
        return
    rows = [
        (
            *(one.uav, one.reference, f"{one.flights:,}"),
            *(f"{value:.3f}" for value in (one.largest, one.q999, one.median)),
            "-" if one.vertical is None else f"{one.vertical:.3f}",
        )
        for one in found.flights
    ]
    _print(_ERRORS, rows, f"{found.scenario}: distance from the reference", markdown=markdown)
    _print_proposal(found)


def _print_proposal(found: Measurement) -> None:
    """Print the bound to declare."""
    error, bound = f"{found.largest:.3f} m", f"{found.max_tracking_error:g}"
    OUT.tell(
        f"largest error {error}, plus {100.0 * found.margin:.0f} %: --set uav.*.body=quadrotor "
        f"--set certificate.max_tracking_error={bound}"
    )


def print_comparison(scenario: Scenario, flights: int, *, markdown: bool, json: bool) -> None:
    """Compare the bodies, and print the results.

    Raises:
        typer.Exit: With 1, if a guarantee was contradicted or the declared bound exceeded.
    """
    with share_progress("flying") as tell:
        found = compare(scenario, flights, tell)
    if json:
        print_json({"scenario": scenario.name, "bodies": found})
    else:
        headings = ("", *(one.body for one in found))
        _print(headings, _lines(found), f"{scenario.name}: bodies", markdown=markdown)
    if any(
        one.certified_while_lost + one.certificate_broken + one.tracking_exceeded for one in found
    ):
        raise typer.Exit(1)


def _lines(found: Sequence[Flights]) -> list[tuple[str, ...]]:
    """Return one line for each quantity, with a column for each body."""

    def line(name: str, text: Callable[[Flights], str]) -> tuple[str, ...]:
        return (name, *map(text, found))

    return [
        line("flights", lambda one: f"{one.flights:,} of {one.seconds:g} s"),
        line("declared tracking error w [m]", lambda one: f"{one.max_tracking_error:.3f}"),
        line("largest tracking error [m]", lambda one: f"{one.largest_tracking_error:.3f}"),
        line("ticks beyond w", lambda one: f"{one.tracking_exceeded:,}"),
        line("ticks certified", lambda one: f"{100.0 * one.certified_share:.2f} %"),
        line("flights certified throughout", lambda one: f"{one.fully_certified:,}"),
        line("ticks out of sight", lambda one: f"{one.out_of_sight:,}"),
        line("mean coverage error e(t) [m²]", lambda one: f"{one.mean_error:.1f}"),
    ]


def _print(
    headings: Sequence[str], rows: Sequence[Sequence[str]], title: str, *, markdown: bool
) -> None:
    """Print a table on stdout, framed or as Markdown."""
    if not markdown:
        left = {"UAV", "reference", ""}
        print_table(headings, rows, title=title, right=set(headings) - left)
        return
    for row in (headings, ["---"] * len(headings), *rows):
        OUT.tell(f"| {' | '.join(row)} |")
