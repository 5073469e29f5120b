"""Page of the run's network budget: what its vehicles tolerate beside what its links do."""

from collections.abc import Sequence
from html import escape

from fastapi import Request
from nicegui import ui

from outrider.running.network_budget import Budget, Table, bound_table, link_table, room
from outrider_dashboard.budget_job import BudgetJob
from outrider_dashboard.controls.widgets import button, card, html, number, row
from outrider_dashboard.page_guard import PREFIX_HEADER

ADDRESS = "budget"
"""Address of the page, relative to the page of the run."""
_PERIOD = 0.25
"""Wall time between two refreshes [s]."""
_RISK = 1e-3
_HEADER = """<div class="brand"><b>Outrider</b><span>Network budget</span></div><div></div>
<div class="tools"><a href="./">Back to the run</a><button type="button" id="theme"></button></div>"""
_ABOUT = (
    "How much loss, delay and silence can this run afford? For the scenario as it was started: changes of law and "
    "links during the run are not included. The command outrider network budget prints the same."
)
_BOUNDS = (
    "Needed: what the links keep at this risk. Largest: what still lets sight be certified, the other bounds "
    "unchanged. Its price is r_cert: nearer than this the law acts freely. Bar: declared, as a share of the largest; "
    "mark: needed."
)
_LINKS = (
    "Each may grow this far with the bounds as declared, and with the link's own bound at its largest. Bar: now; mark: "
    "with the declared bounds; end: with the largest bound."
)


def build_budget_page(job: BudgetJob) -> None:
    """Register the page with NiceGUI.

    Args:
        job: Computation, shared by all browsers.
    """

    @ui.page(f"/{ADDRESS}", title="Outrider: network budget")
    def show(request: Request) -> None:
        prefix = request.headers.get(PREFIX_HEADER, "")  # checked by the guard
        ui.add_head_html(
            f'<link rel="stylesheet" href="{prefix}/static/colors.css">'
            f'<link rel="stylesheet" href="{prefix}/static/dashboard.css">'
            f'<script type="module" src="{prefix}/static/budget.js"></script>'
        )
        with ui.element("div").classes("budget"):
            html(_HEADER, "top")
            ui.timer(_PERIOD, _View(job).show)


class _View:
    """Contents of the page in one browser."""

    def __init__(self, job: BudgetJob) -> None:
        self._job = job
        self._shown: Budget | None = None
        with card("Computation"):
            ui.label(_ABOUT).classes("note")
            with row():
                self._risk = number(
                    "Risk",
                    low=1e-9,
                    high=0.999,
                    meaning="Probability that a link exceeds its bound within a run",
                    value=_RISK,
                    format="%g",
                    classes="risk",
                )
                self._start = button("Compute", self._compute, icon="calculate", props="unelevated")
                self._cancel = button("Cancel", job.cancel, icon="close")
            self._bar = ui.linear_progress(0.0, show_value=False).props("instant-feedback rounded")
            self._line = ui.label().classes("note").props("role=status")
        self._tables = ui.element("div").classes("budget-tables")
        self.show()

    def _compute(self) -> None:
        if self._risk.error is None and self._risk.value is not None:
            self._job.start(float(self._risk.value))
            self.show()

    def show(self) -> None:
        """Show progress and result."""
        job = self._job
        job.update()
        self._start.set_enabled(not job.running and not job.missing)
        self._cancel.set_visibility(job.running)
        self._bar.set_visibility(job.running)
        self._bar.set_value(round(job.report.share, 3))
        self._line.set_text(self._text())
        self._line.classes(**{"add" if job.fault or job.missing else "remove": "refused"})
        if job.budget is not self._shown and job.budget is not None:
            self._shown = job.budget
            self._tables.clear()
            with self._tables:
                self._show_budget(job.budget)

    def _text(self) -> str:
        job = self._job
        if job.running:
            return f"{100.0 * job.report.share:.0f} %: {job.report.step}"
        if job.missing or job.fault:
            return job.missing or job.fault
        return "" if job.budget is not None else "Not computed yet; it takes about half a minute."

    @staticmethod
    def _show_budget(found: Budget) -> None:
        rooms = " · ".join(f"{uav}: {room(radius)}" for uav, radius in found.r_cert.items())
        with card(
            "What the vehicles tolerate", beside=f'<span class="muted">{escape(rooms)}</span>'
        ):
            shares = [(one.declared, one.needed, one.largest) for one in found.bounds]
            _show_table(bound_table(found), _BOUNDS, shares)
        with card("What the links do"):
            links = [(one.now, one.as_declared, one.at_most) for one in found.links]
            _show_table(link_table(found), _LINKS, links)
        for note in found.notes:
            ui.label(note).classes("note")


def _show_table(
    table: Table, about: str, shares: Sequence[tuple[float, float | None, float | None]]
) -> None:
    """Show a table, with a bar at the end of each row.

    Args:
        table: The table.
        about: Explanation below its title.
        shares: Value of the bar, of the mark, and of the end, by row.
    """
    ui.label(f"{table.title}. {about}").classes("note")
    heads = "".join(f"<th>{escape(head)}</th>" for head in table.headings)
    lines = []
    for cells, is_exceeded, share in zip(table.rows, table.exceeded, shares, strict=True):
        columns = "".join(
            f'<td data-head="{escape(head)}">{escape(cell)}</td>'
            for head, cell in zip(table.headings, cells, strict=True)
        )
        kind = ' class="exceeded"' if is_exceeded else ""
        lines.append(f"<tr{kind}>{columns}<td class='share'>{_bar(*share)}</td></tr>")
    html(
        f"<table><thead><tr>{heads}<th></th></tr></thead><tbody>{''.join(lines)}</tbody></table>",
        "budget-table",
    )


def _bar(value: float, mark: float | None, end: float | None) -> str:
    """Return a bar up to a value with a mark; both as shares of the end."""
    if not end:
        return ""
    filled = f"<b style='width:{100.0 * min(1.0, value / end):.1f}%'></b>"
    marked = "" if mark is None else f"<u style='left:{100.0 * min(1.0, mark / end):.1f}%'></u>"
    return f"<i class='share-bar'>{filled}{marked}</i>"
