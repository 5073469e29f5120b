"""`outrider network`: recorded links, and bounds that links satisfy."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from outrider.cli import options
from outrider.cli.options import Json
from outrider_networks.source import Source

if TYPE_CHECKING:
    from sim.scenario.types import Scenario

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
        typer.Argument(
            help="CSV table with sent [s] and delay [s], Mahimahi file, rosbag2 folder, or pcap at the sender."
        ),
    ],
    received: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Read the capture at the receiver, pcap or pcapng."),
    ] = None,
    port: Annotated[
        int | None,
        typer.Option(help="Select the captured messages to this UDP port.", min=1, max=65535),
    ] = None,
    topic: Annotated[
        str, typer.Option(metavar="NAME", help="Select a topic with headers in the bag.")
    ] = "",
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Plot the fit into this PNG.")
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(
            help="Set the message rate over a Mahimahi file [1/s]; default: 20.", min=0.1, max=1000
        ),
    ] = None,
    message_bytes: Annotated[
        int | None,
        typer.Option(
            help="Set the message size over a Mahimahi file [bytes]; default: 1000.",
            min=1,
            max=1_000_000,
        ),
    ] = None,
    save: Annotated[
        str,
        typer.Option(
            metavar="FILE.toml[:NAME]",
            help="Save the fit as a profile for --network; append to a file of profiles.",
        ),
    ] = "",
    table: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write the messages into this CSV, for a link's trace."),
    ] = None,
    json: Json = False,
) -> None:
    """Fit link settings and the nearest profile to a recording.

    The fit covers delay, jitter, its shape and correlation, loss, bursts and random blackouts, and prints the lines for
    a scenario. The factor compares two links by the time until a message, or any later one, has arrived: it is the mean
    ratio of the quantiles of these times, and 1 is a perfect fit. Duplicates do not show in such a file. Delays of a
    bag are receive times minus header stamps, those of captures times at the receiver minus times at the sender: both
    need synchronized clocks, and the extra [networks].

    Example: outrider network fit drive.csv --save drive.toml --out fit.png
    """
    from outrider_networks.fit_work import Written, print_fit  # noqa: PLC0415 - the compiler

    source = Source(file, received, topic, port, rate, message_bytes)
    print_fit(source, Written(out, save, table), json=json)


def _resolved(
    source: str,
    changes: list[str] | None,
    duration: float | None,
    law: str | None,
    network: str,
) -> "Scenario":
    """Return the scenario with the options of a command applied."""
    from outrider.running.resolve import resolve  # noqa: PLC0415 - the compiler

    found, _ = resolve(source, changes=changes, duration=duration, law=law, network=network)
    return found


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
    from outrider_networks.work import print_chances  # noqa: PLC0415 - the compiler

    print_chances(_resolved(scenario, changes, duration, law, network), json=json)


@app.command()
def budget(
    scenario: options.ScenarioName,
    risk: Annotated[
        float, typer.Option(help="Set the probability that a link exceeds its bound in a run.")
    ] = 1e-3,
    changes: options.Set = None,
    duration: options.Duration = None,
    law: options.LawName = None,
    network: options.NetworkName = "",
    json: Json = False,
    child: options.Child = False,
) -> None:
    """Print how much loss, delay and silence a mission can afford.

    The first table compares, for each bound of [certificate], what is declared, what the links need at this risk, and
    the largest value with which sight can still be certified; r_cert is the price: within this distance the law acts
    freely. The second table has the largest loss, burst, delay and blackout of each link, one at a time: with the
    bounds as declared, and with the bound of that link as large as the vehicles tolerate. A delay of commands is
    compared with max_command_delay.

    Example: outrider network budget escort --risk 1e-3
    """
    from outrider_networks.work import print_budget, report_budget  # noqa: PLC0415 - the compiler

    if child:
        report_budget(risk)
        return
    print_budget(_resolved(scenario, changes, duration, law, network), risk, json=json)


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
    from outrider_networks.work import print_bounds  # noqa: PLC0415 - the compiler

    print_bounds(_resolved(scenario, changes, duration, law, network), risk, json=json)


@app.command()
def netem(
    source: Annotated[
        str,
        typer.Argument(metavar="SCENARIO|PROFILE", help="Scenario or profile, by name or file."),
    ],
    changes: options.Set = None,
    network: options.NetworkName = "",
    rate: Annotated[
        float | None,
        typer.Option(
            help="Set the message rate over a profile's link [1/s]; default: 20.", min=0.1, max=1e4
        ),
    ] = None,
    device: Annotated[
        str, typer.Option(metavar="DEVICE", help="Set the network device in the commands.")
    ] = "eth0",
    json: Json = False,
) -> None:
    """Print links as commands for tc-netem.

    Comments name what netem cannot express. A command acts on all packets that leave a device; use one network
    namespace or device for each link.

    Example: outrider network netem wifi-poor --rate 50 --device wlan0
    """
    from outrider_networks.netem_work import print_netem  # noqa: PLC0415 - the compiler

    print_netem(source, changes=changes, network=network, rate=rate, device=device, json=json)
