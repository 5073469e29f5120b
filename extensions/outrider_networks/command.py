"""`outrider network`: recorded links, and bounds that links satisfy."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec
import typer

from bus.errors import ScenarioError
from bus.numbers import exact
from outrider.cli import options
from outrider.cli.options import Json

if TYPE_CHECKING:
    from outrider_networks.fitting import Fit

app = typer.Typer(invoke_without_command=True, add_completion=False, rich_markup_mode=None)


@app.callback()
def command(context: typer.Context) -> None:
    """Fit links to recordings, and compute their bounds.

    Example: outrider network bounds escort --network wifi --risk 1e-3
    """
    options.help_without_command(context)


@app.command()
def fit(
    file: Annotated[
        Path,
        typer.Argument(help="Mahimahi file, or CSV table with columns sent [s], delay [s]."),
    ],
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Plot the fit into this PNG.")
    ] = None,
    rate: Annotated[
        float,
        typer.Option(help="Set the message rate over a Mahimahi file [1/s].", min=0.1, max=1000),
    ] = 20.0,
    message_bytes: Annotated[
        int,
        typer.Option(
            help="Set the message size over a Mahimahi file [bytes].", min=1, max=1_000_000
        ),
    ] = 1000,
    json: Json = False,
) -> None:
    """Fit link settings and the nearest profile to a recording.

    The fit covers delay, jitter and its shape, loss, bursts and random blackouts, and prints the lines for a scenario.
    The factor compares two links by the time until a message, or any later one, has arrived: it is the mean ratio of
    the quantiles of these times, and 1 is a perfect fit. Duplicates do not show in such a file.

    Example: outrider network fit drive.csv --out fit.png
    """
    from outrider.cli.console import ERR, OUT, print_json
    from outrider_networks.fitting import fit_link
    from sim.input.faults import one_line
    from sim.scenario.recordings import read_link

    if out is not None and out.suffix.lower() != ".png":
        raise ScenarioError(f"--out {out}: not a PNG file; allowed: FILE.png")
    recorded = msgspec.structs.replace(read_link(str(file), one_line(str(file))), name=file.name)
    with ERR.status("fitting"):
        found, samples = fit_link(recorded, rate=rate, message_bytes=message_bytes)
    if out is not None:
        from outrider_networks.picture import draw_fit

        draw_fit(found, samples, out)
    if json:
        print_json(found)
        return
    _print(found)
    if out is not None:
        OUT.tell(str(out))


@app.command()
def chances(
    scenario: options.ScenarioName,
    changes: options.Set = None,
    duration: options.Duration = None,
    law: options.LawName = None,
    network: options.NetworkName = "",
    json: Json = False,
) -> None:
    """Print the probabilities that a run exceeds the declared bounds.

    Also print the probability of losing certified visibility, which is at most their sum. The bounds are the fields of
    [certificate], on which the law certified relies.

    Example: outrider network chances escort --network jammed --set certificate.max_measurement_age=5
    """
    from outrider.cli.console import OUT, print_json, print_table
    from outrider.running.resolve import resolve
    from outrider_networks.scenario_bounds import exceedance, in_runs

    loaded, _ = resolve(scenario, changes=changes, duration=duration, law=law, network=network)
    found = exceedance(loaded)
    if json:
        print_json(found)
        return
    rows = [
        (name, "unknown" if value is None else in_runs(value))
        for name, value in found.exceedance_probability.items()
    ]
    print_table(("bound", "exceeded"), rows, title=f"{found.scenario}: declared bounds")
    lost = found.loss_probability
    kept = "is not guaranteed" if lost is None else f"is lost {in_runs(lost)}"
    OUT.tell(f"\ncertified visibility {kept}")


@app.command()
def bounds(
    scenario: options.ScenarioName,
    risk: Annotated[
        float, typer.Option(help="Set the probability that a run exceeds any bound.")
    ] = 1e-3,
    changes: options.Set = None,
    duration: options.Duration = None,
    law: options.LawName = None,
    network: options.NetworkName = "",
    json: Json = False,
) -> None:
    """Print the smallest bounds for a given risk.

    A run exceeds any of them with at most this probability. Each line is an option of `outrider run`: --set with a
    field of [certificate].

    Example: outrider network bounds escort --risk 1e-3
    """
    from outrider.cli.console import OUT, print_json
    from outrider.running.resolve import resolve
    from outrider_networks.scenario_bounds import bounds_for

    if not 0.0 < risk < 1.0:
        raise ScenarioError(f"--risk {exact(risk)}: out of range; allowed: above 0 and below 1")
    loaded, _ = resolve(scenario, changes=changes, duration=duration, law=law, network=network)
    found = bounds_for(loaded, risk)
    if json:
        print_json(found)
        return
    for field, value in found.set.items():
        OUT.tell(f"--set {field}={value!r}")


def _print(found: "Fit") -> None:
    from rich.text import Text

    from outrider.cli.console import OUT, print_table, print_warnings

    delays = ", ".join(f"{name} {1000.0 * value:.3g} ms" for name, value in found.delay.items())
    OUT.tell(
        f"{found.file}: {found.messages:,} messages, one every {found.interval:g} s\n"
        f"delay: {delays}\n"
        f"lost: {100.0 * found.lost:.3g} %, at most {found.longest_burst:g} s in a row\n"
    )
    fitted = Text("fitted", style="bold"), Text(f"{found.factor:.2f}", style="bold")
    profiles = [(f"profile {name}", f"{factor:.2f}") for name, factor in found.profiles.items()]
    title = "Time until a message or a later one arrives: mean ratio, 1 is a perfect fit"
    print_table(("link", "factor"), [fitted, *profiles], title=title, right=("factor",))
    OUT.tell(f"\n{found.toml}")
    print_warnings(found.notes)
