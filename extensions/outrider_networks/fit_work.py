"""Work of `outrider network fit`."""

from pathlib import Path
from typing import NamedTuple

import msgspec
from rich.text import Text

from bus.errors import ScenarioError
from bus.files import write_whole
from outrider.cli.console import ERR, OUT, print_json, print_table, print_warnings
from outrider_networks.fitting import Fit, fit_link
from outrider_networks.nearest import MOST_LOSS_RATIO
from outrider_networks.profile_file import check_target, save_profile
from outrider_networks.recordings import read_source
from outrider_networks.source import Source
from sim.channel.recorded import unpack
from sim.input.faults import one_line


class Written(NamedTuple):
    """Files that the command writes."""

    picture: Path | None = None
    profile: str = ""
    """`FILE.toml` or `FILE.toml:NAME`."""
    table: Path | None = None
    """CSV table of a bag's or a capture's messages."""


def print_fit(source: Source, written: Written, *, json: bool) -> None:
    """Fit a recorded link, print the result, save it as a profile and draw it."""
    if written.picture is not None and written.picture.suffix.lower() != ".png":
        raise ScenarioError(f"--out {written.picture}: not a PNG file; allowed: FILE.png")
    if written.table is not None and written.table.suffix.lower() != ".csv":
        raise ScenarioError(f"--table {written.table}: not a CSV file; allowed: FILE.csv")
    if written.profile:
        check_target(written.profile)
    with ERR.status("reading"):
        recorded, notes = read_source(source)
    if written.table is not None:
        write_whole(written.table, unpack(recorded, where=recorded.name))
    with ERR.status("fitting"):
        found, samples = fit_link(
            recorded, rate=source.rate or 20.0, message_bytes=source.message_bytes or 1000
        )
    found = msgspec.structs.replace(found, notes=[*notes, *found.notes])
    if written.picture is not None:
        from outrider_networks.picture import draw_fit  # noqa: PLC0415 - matplotlib

        draw_fit(found, samples, written.picture)
    saved = ""
    if written.profile:
        about = f"fitted to {found.file}: {found.messages:,} messages, factor {found.factor:.2f}"
        saved = save_profile(written.profile, found.settings, about)
    if json:
        print_json(found)
        return
    _print(found)
    if saved:
        OUT.tell(f"--network {saved}")
    for file in (written.table, written.picture):
        if file is not None:
            OUT.tell(one_line(str(file)))


def _print(found: Fit) -> None:
    delays = ", ".join(f"{name} {1000.0 * value:.3g} ms" for name, value in found.delay.items())
    OUT.tell(
        f"{found.file}: {found.messages:,} messages, one every {found.interval:g} s\n"
        f"delay: {delays}\n"
        f"lost: {100.0 * found.lost:.3g} %, at most {found.longest_burst:g} s in a row\n"
    )
    fitted = Text("fitted", style="bold"), Text(f"{found.factor:.2f}", style="bold"), ""
    profiles = [
        (f"profile {name}", f"{factor:.2f}", f"{100.0 * found.losses[name]:.2g} %")
        for name, factor in found.profiles.items()
    ]
    title = "Time until a message or a later one arrives: mean ratio, 1 is a perfect fit"
    columns = ("link", "factor", "lost")
    print_table(columns, [fitted, *profiles], title=title, right=("factor", "lost"))
    OUT.tell(
        f"nearest profile with a loss within a factor of {MOST_LOSS_RATIO:g}: {found.nearest}"
        if found.nearest
        else f"no profile fits: the loss of each differs by a factor of {MOST_LOSS_RATIO:g} or more"
    )
    OUT.tell(f"\n{found.toml}")
    print_warnings(found.notes)
