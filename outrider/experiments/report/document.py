"""Report as a self-contained HTML page, and its tables as Markdown."""

import base64
from collections.abc import Iterator
from html import escape
from importlib.resources import files
from pathlib import Path
from statistics import fmean, median

from outrider.experiments.intervals import wilson_interval
from outrider.experiments.report.labels import number, tick_of, value_of
from outrider.experiments.report.plots import CAPTIONS
from outrider.experiments.report.results import Cell, Material, Panel
from outrider.style import law_color

COLUMNS = (
    "law",
    "runs",
    "lost the UGV",
    "95 % interval",
    "worst margin [m]",
    "median margin [m]",
    "mean e(t) [m²]",
    "age of detections [s]",
    "detections arrived",
    "commands arrived",
    "certified",
    "certified while lost",
    "certificate broken",
)


MISSION_COLUMNS = (
    "at the goals",
    "mission time [s]",
    "hits per run",
    "warning time [s]",
    "path reported ahead",
)
"""Additional columns for ground with hazards."""
_FAULTS = tuple(
    (*COLUMNS, *MISSION_COLUMNS).index(name) - 1
    for name in ("lost the UGV", "certified while lost", "certificate broken", "hits per run")
)
"""Columns in which a value other than 0 is bad, counted after the law's column."""
_UNCERTIFIED = ", where it is not certified"


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %"


def _mean(values: list[float], digits: int = 3) -> str:
    return number(fmean(values), digits) if values else "-"


def _count(values: list[float]) -> str:
    """Return the sum over all runs; `-` for a sweep of an older version without the column."""
    return f"{int(sum(values)):,}" if values else "-"


def cells_of(law: str, cell: Cell) -> list[str]:
    """Return a row of the table: the texts of `COLUMNS`."""
    runs = f"{len(cell.flown)}" + (f" (+{cell.failed} failed)" if cell.failed else "")
    rate, found = cell.rate(), cell.numbers("margin")
    certified = cell.numbers("certified_share")
    arrived = [cell.numbers(f"{kind}_delivery_ratio") for kind in ("detections", "commands")]
    return [
        law,
        runs,
        "-" if rate is None else f"{cell.violated} ({_percent(rate[0])})",
        "-" if rate is None else f"{_percent(rate[1])} to {_percent(rate[2])}",
        f"{min(found):.2f}" if found else "-",
        f"{median(found):.2f}" if found else "-",
        _mean(cell.numbers("mean_error")),
        _mean(cell.numbers("detections_mean_age"), 2),
        *(_percent(fmean(shares)) if shares else "-" for shares in arrived),
        f"{100.0 * fmean(certified):.4g} %" if certified else "-",
        *(
            _count(cell.numbers(name)) if certified else "-"
            for name in ("certified_while_lost", "certificate_broken")
        ),
    ]


def mission_cells(cell: Cell) -> list[str]:
    """Return the texts of `MISSION_COLUMNS`."""
    arrived, hits = cell.numbers("arrived"), cell.numbers("hazards_hit")
    ahead = cell.numbers("reported_share")
    return [
        f"{int(sum(arrived))} ({_percent(fmean(arrived))})" if arrived else "-",
        _mean(cell.numbers("mission_time")),
        f"{fmean(hits):.2g}" if hits else "-",
        _mean(cell.numbers("mean_warning_time"), 2),
        _percent(fmean(ahead)) if ahead else "-",
    ]


def columns_of(panel: Panel) -> tuple[str, ...]:
    """Return the columns of a panel's table; with `MISSION_COLUMNS` only if it has hazards."""
    has = any(cell.numbers("hazards_hit") for cell in panel.cells.values())
    return (*COLUMNS, *MISSION_COLUMNS) if has else COLUMNS


def certified_runs(material: Material) -> str:
    """Return a sentence on the runs that were certified at every tick; empty if there are none."""
    runs = [row for cell in material.cells for row in cell.certified]
    if not runs:
        return ""
    lost = sum(row["violated"] for row in runs)
    return (
        f"{len(runs):,} runs were certified at every tick; {lost:,} of them lost sight of the UGV."
    )


def rows_of(panel: Panel) -> Iterator[tuple[str, list[str]]]:
    """Yield the rows of a panel's table: for each value and law, the value and the texts."""
    hazards = len(columns_of(panel)) > len(COLUMNS)
    for value in panel.values:
        for law in panel.laws:
            cell = panel.cell(law, value)
            if cell.rows:
                row = [*cells_of(law, cell), *(mission_cells(cell) if hazards else ())]
                yield (value_of(panel.field, value) if panel.field else ""), row


def holds(panel: Panel, law: str) -> tuple[str, bool]:
    """Return the largest value up to which no run of a law lost sight, as text, and if this covers all values."""
    flown = [value for value in panel.values if panel.cell(law, value).flown]
    if not flown:
        return "-", False
    broken = [value for value in flown if panel.cell(law, value).violated]
    if not broken:
        if not panel.field:
            return "kept", True
        if not panel.ordered:
            return "kept over each value tried", True
        return f"kept up to {value_of(panel.field, flown[-1])}, the largest value tried", True
    cells = [panel.cell(law, value) for value in (broken[:1] if panel.ordered else broken)]
    uncertified = all(
        cell.numbers("certified_share") and not any(row["violated"] for row in cell.certified)
        for cell in cells
    )
    suffix = _UNCERTIFIED if uncertified else ""
    if not panel.field:
        return f"broken{suffix}", False
    if not panel.ordered:
        names = ", ".join(value_of(panel.field, value) for value in broken)
        return f"broken over {names if len(broken) < len(flown) else 'each'}{suffix}", False
    kept = flown[: flown.index(broken[0])]
    until = f"kept up to {value_of(panel.field, kept[-1])}, " if kept else ""
    return f"{until}broken at {value_of(panel.field, broken[0])}{suffix}", False


def markdown(material: Material) -> str:
    """Return the tables as Markdown: the limit of each law, then every value."""
    lines = [
        "| experiment | " + " | ".join(material.law) + " |",
        "|---|" + "---|" * len(material.law),
    ]
    for panel in material.panels:
        limits = [holds(panel, law)[0] for law in material.law]
        lines.append(f"| {_plain(panel.title)} | " + " | ".join(limits) + " |")
    for panel in material.panels:
        lines += ["", f"**{_plain(panel.title)}**", ""]
        lines += [
            f"| {_plain(panel.label) or '-'} | " + " | ".join(columns_of(panel)) + " |",
            "|---" * (len(columns_of(panel)) + 1) + "|",
        ]
        lines += [f"| {_plain(value)} | " + " | ".join(row) + " |" for value, row in rows_of(panel)]
    if certified_runs(material):
        lines += ["", certified_runs(material)]
    return "\n".join(lines) + "\n"


def _plain(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")


def _law(law: str) -> str:
    return f'<i class="law" style="background:{law_color(law)}"></i>{escape(law)}'


def _overview(material: Material) -> Iterator[str]:
    yield '<div class="scroll"><table><tr><th>experiment</th>'
    yield from (f"<th>{_law(law)}</th>" for law in material.law)
    yield "</tr>"
    for panel in material.panels:
        yield f"<tr><td>{escape(panel.title)}</td>"
        for law in material.law:
            limit, good = holds(panel, law)
            shade = "good" if good else "bad" if "broken" in limit else ""
            yield f'<td class="{shade}">{escape(limit)}</td>'
        yield "</tr>"
    yield "</table></div>"


def _table(panel: Panel) -> Iterator[str]:
    yield f"<details><summary>{escape(panel.title)}</summary>"
    yield (
        f'<div class="scroll"><table><tr><th>{escape(panel.label)}</th>'
        + "".join(f"<th>{name}</th>" for name in columns_of(panel))
        + "</tr>"
    )
    before = None
    for value, (law, *row) in rows_of(panel):
        first = ' class="first"' if before not in (None, value) else ""
        yield f"<tr{first}><td>{escape(value) if value != before else ''}</td><td>{_law(law)}</td>"
        for k, text in enumerate(row):
            bad = " bad" if k in _FAULTS and not text.startswith(("0", "-")) else ""
            yield f'<td class="n{bad}">{escape(text)}</td>'
        yield "</tr>"
        before = value
    yield "</table></div></details>"


def _facts(material: Material) -> Iterator[str]:
    violated = sum(cell.violated for cell in material.cells)
    seeds = sorted({head.sweep.seeds for head in material.heads})
    yield '<div class="facts">'
    for fact, what in (
        (f"{material.rows:,}", "runs"),
        (f"{violated:,}", "lost sight of the UGV"),
        (f"{material.failed:,}", "failed"),
        (" and ".join(str(count) for count in seeds), "seeds per point"),
        (", ".join(sorted({head.sweep.scenario for head in material.heads})), "scenario"),
        (", ".join(sorted({head.outrider for head in material.heads})), "version of Outrider"),
    ):
        yield f"<div><b>{escape(fact)}</b><span>{escape(what)}</span></div>"
    yield "</div>"


def _settings(material: Material) -> Iterator[str]:
    for head in material.heads:
        changes = {f"Changed in all runs of {head.sweep.scenario}": head.sweep.set}
        changes |= {f"In “{block.name}”": block.set for block in head.sweep.block}
        for where, fixed in changes.items():
            fields = ", ".join(f"{name} = {tick_of('', value)}" for name, value in fixed.items())
            if fields:
                yield f"<p>{escape(where)}: {escape(fields)}.</p>"


def _caution(material: Material) -> str:
    """Return a sentence with the largest rate that zero violations at a point still allow."""
    fewest = min((len(cell.flown) for cell in material.cells if cell.flown), default=0)
    if not fewest:
        return "No run is complete."
    rate = _percent(wilson_interval(0, fewest)[1])
    return (
        f"No violation in {fewest} runs, the smallest number at a value, still allows a rate of up to {rate} (95 %); "
        "the intervals are below."
    )


def page(material: Material, pictures: dict[str, Path], command: str) -> str:
    """Return the page as HTML, with the pictures inside.

    Args:
        material: Results of the report.
        pictures: Picture files by name.
        command: Command line that makes this report.
    """
    css = (files("outrider.experiments.report") / "page.css").read_text("utf-8")
    title = " · ".join(
        dict.fromkeys(head.sweep.title or head.sweep.scenario for head in material.heads)
    )
    parts = [
        f'<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>{escape(title)}</title><style>{css}</style>",
        f"<h1>{escape(title)}</h1>",
        '<p class="muted">Robustness of visibility, ‖p_a − p_g‖ &lt; r_v, to network degradation.</p>',
        *_facts(material),
    ]
    if material.missing:
        parts.append(
            f"<p><b>Not finished:</b> {material.missing:,} runs are missing; run the same command to resume.</p>"
        )
    parts += [
        "<h2>Limits of each law</h2>",
        f"<p>Largest value up to which no run lost sight of the UGV. {_caution(material)} "
        f"{certified_runs(material)}</p>",
        *_overview(material),
    ]
    for name, path in pictures.items():
        image = base64.b64encode(path.read_bytes()).decode()
        caption = CAPTIONS[name]
        parts.append(
            f'<figure><img alt="{name}" '
            f'src="data:image/png;base64,{image}"><figcaption>{escape(caption)}</figcaption></figure>'
        )
    parts += [
        "<h2>All numbers</h2>",
        *(line for panel in material.panels for line in _table(panel)),
    ]
    commands = "\n".join([*(head.command for head in material.heads), command])
    parts += [
        "<h2>Commands and settings</h2>",
        *_settings(material),
        f"<pre>{escape(commands)}</pre></html>",
    ]
    return "\n".join(parts) + "\n"
