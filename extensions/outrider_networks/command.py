"""`outrider network`: recorded links, and the bounds that links keep."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec
import typer

from bus.errors import ScenarioError
from outrider.cli import options
from outrider.cli.options import Json

if TYPE_CHECKING:
    from outrider_networks.fitting import Fit

app = typer.Typer(invoke_without_command=True, add_completion=False, rich_markup_mode=None)


@app.callback()
def command(context: typer.Context) -> None:
    """Fit links to recordings, and find the bounds that links keep.

    Example: outrider network bounds escort --network wifi --risk 1e-3
    """
    options.help_without_command(context)


@app.command()
def fit(
    file: Annotated[
        Path,
        typer.Argument(
            help="A Mahimahi file, or a CSV table with the columns sent [s] and delay [s]."
        ),
    ],
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="Draw how well it fits.")] = None,
    rate: Annotated[
        float,
        typer.Option(
            help="Messages a second that are sent over a Mahimahi file.", min=0.1, max=1000
        ),
    ] = 20.0,
    message_bytes: Annotated[
        int, typer.Option(help="Their size, in bytes.", min=1, max=1_000_000)
    ] = 1000,
    json: Json = False,
) -> None:
    """Find the settings that come nearest to a recorded link.

    And the shipped profile that does. Fitted are delay, jitter and its shape, loss, bursts and random blackouts; the
    lines that a scenario needs are printed. A link's waits are the times until a message or a later one is there: the
    factor tells by how much those of two links differ, on average over their quantiles. Duplicates cannot be seen in
    such a file.

    Example: outrider network fit drive.csv --out fit.png
    """
    from outrider.cli.console import ERR, OUT, print_json
    from outrider_networks.fitting import fit_link
    from sim.input.faults import one_line
    from sim.scenario.recordings import read_link

    if out is not None and out.suffix.lower() != ".png":
        raise ScenarioError(f"--out {out}: needs a file that ends in .png")
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

    And the probability that certified visibility is lost, which is at most their sum. Bounds are those of the
    scenario's table [certificate], on which the law certified relies.

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
        (name, "not known" if value is None else in_runs(value))
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
        float, typer.Option(help="Probability that a run exceeds any of the bounds.")
    ] = 1e-3,
    changes: options.Set = None,
    duration: options.Duration = None,
    law: options.LawName = None,
    network: options.NetworkName = "",
    json: Json = False,
) -> None:
    """Print the smallest bounds for a given risk.

    A run exceeds them with at most this probability. Each line is an option of `outrider run`: a --set of a field of
    the table [certificate].

    Example: outrider network bounds escort --risk 1e-3
    """
    from outrider.cli.console import OUT, print_json
    from outrider.running.resolve import resolve
    from outrider_networks.scenario_bounds import bounds_for

    if not 0.0 < risk < 1.0:
        raise ScenarioError(f"--risk {risk:g}: no probability; allowed: above 0 and below 1")
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

    told = ", ".join(f"{name} {1000.0 * value:.3g} ms" for name, value in found.delay.items())
    OUT.tell(
        f"{found.file}: {found.messages:,} messages, one every {found.interval:g} s\n"
        f"delay: {told}\n"
        f"lost: {100.0 * found.lost:.3g} %, at most {found.longest_burst:g} s in a row\n"
    )
    fitted = Text("fitted", style="bold"), Text(f"{found.factor:.2f}", style="bold")
    profiles = [(f"profile {name}", f"{factor:.2f}") for name, factor in found.profiles.items()]
    title = "Waits differ by this factor"
    print_table(("link", "factor"), [fitted, *profiles], title=title, right=("factor",))
    OUT.tell(f"\n{found.toml}")
    print_warnings(found.notes)
