"""Screen of the teleoperation: a Textual app that shows the run and forwards keys."""

import math
from typing import ClassVar

from rich.text import Text
from textual import events
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal
from textual.strip import Strip
from textual.widget import Widget
from textual.widgets import Static

from bus.messages.team import Request
from outrider.view.terminal.canvas import Canvas
from outrider.view.terminal.palette import BACKGROUND, FAINT, INK, PANEL
from outrider.view.terminal.panel import WIDTH, ErrorCurve, banner, farthest, numbers, title
from outrider.view.terminal.pressed_keys import Heading
from outrider.view.terminal.teleoperation import DriveLink, DriveView
from outrider.view.terminal.topview import Trails, draw

_PERIOD = 0.1
"""Time between two updates [s]; the map takes part in every second one, to spare slow connections."""
_NARROW = WIDTH + 20
"""Width below which the map is hidden [cells]."""

_HEADINGS = {
    "up,w,W": Heading.NORTH,
    "down,s,S": Heading.SOUTH,
    "left,a,A": Heading.WEST,
    "right,d,D": Heading.EAST,
}
"""Directions of the keys, with and without caps lock."""


class TopView(Widget):
    """Map widget."""

    canvas: Canvas | None = None

    def render_line(self, y: int) -> Strip:
        """Return one line of the map."""
        if self.canvas is None or y >= self.canvas.height:
            return Strip.blank(self.size.width)
        return Strip(self.canvas.row(y)).adjust_cell_length(self.size.width)


class DriveApp(App[int]):
    """App that shows one UGV until the operator quits.

    Args:
        link: Link to the bus.
        run: Name of the run.
    """

    ENABLE_COMMAND_PALETTE = False
    CSS = f"""
    Screen {{ background: {BACKGROUND}; color: {INK}; layout: vertical; overflow: hidden; }}
    #title {{ height: 1; background: {PANEL}; }}
    #keys {{ height: auto; background: {PANEL}; }}
    #banner {{ height: auto; text-align: center; text-style: bold; }}
    #body {{ height: 1fr; }}
    #numbers {{ width: {WIDTH}; height: 100%; padding: 1 2 0 2; background: {PANEL}; }}
    #map {{ width: 1fr; height: 100%; }}
    """
    BINDINGS: ClassVar[list[BindingType]] = [
        *(
            Binding(keys, f"press('{heading.name}')", show=False)
            for keys, heading in _HEADINGS.items()
        ),
        Binding("space", "brake", show=False),
        Binding("plus,equals_sign", "faster(1)", show=False),
        Binding("minus", "faster(-1)", show=False),
        Binding("h,H", "hand_back", show=False),
        Binding("z,Z", "zoom", show=False),
        Binding("r,R", "request('RELIEF')", show=False),
        Binding("c,C", "request('GUARD')", show=False),
        Binding("q,Q,ctrl+q", "leave(0)", show=False, priority=True),
        Binding("ctrl+c", "leave(130)", show=False, priority=True),
    ]

    def __init__(self, link: DriveLink, run: str) -> None:
        super().__init__()
        self._link, self._run_name = link, run
        self._trails, self._history = Trails(), ErrorCurve()
        self._wide = False
        self._code = 0
        self._pictures = 0

    def compose(self) -> ComposeResult:
        """Lay out the screen."""
        yield Static(id="title")
        yield Static(id="banner")
        with Horizontal(id="body"):
            yield Static(id="numbers")
            yield TopView(id="map")
        yield Static(id="keys")

    def on_mount(self) -> None:
        """Start the updates."""
        self.set_interval(_PERIOD, self.show)
        self.show()

    def on_resize(self, event: events.Resize) -> None:
        """Hide the map on a narrow screen."""
        self.query_one(TopView).display = event.size.width >= _NARROW
        self.call_after_refresh(self.show)

    def show(self) -> None:
        """Update the screen."""
        if self._link.over:
            self.exit(self._code)
            return
        if not self.query(TopView):
            return  # a last timer event while the screen closes
        view = self._link.view()
        self._store(view)
        message = banner(view, self._link.vehicle, leaving=self._link.leaving)
        line = self.query_one("#banner", Static)
        line.update(Text(message.text))
        line.styles.background, line.styles.color = message.ground, message.color
        self.query_one("#title", Static).update(
            title(view, self._run_name, wide=self.size.width >= _NARROW)
        )
        self.query_one("#numbers", Static).update(numbers(view, self._link.vehicle, self._history))
        self.query_one("#keys", Static).update(_keys(view, self.size.width))
        if self._pictures % 2 == 0:
            self._draw_map(view)
        self._pictures += 1

    def _store(self, view: DriveView) -> None:
        if view.truth is not None:
            self._trails.follow(view.truth)
            escort = farthest(view, self._link.vehicle)
            if escort is not None and math.isfinite(escort.coverage_error):
                self._history.add(view.truth.time, escort.coverage_error)

    def _draw_map(self, view: DriveView) -> None:
        widget = self.query_one(TopView)
        width, height = widget.size
        if widget.display and width and height:
            widget.canvas = draw(
                view, self._link.vehicle, self._trails, width=width, height=height, wide=self._wide
            )
            widget.refresh()

    def action_press(self, name: str) -> None:
        """Drive in a direction for a moment."""
        self._link.press(Heading[name])

    def action_brake(self) -> None:
        """Brake."""
        self._link.brake()

    def action_faster(self, steps: int) -> None:
        """Change the speed by a number of steps."""
        self._link.faster(steps)

    def action_hand_back(self) -> None:
        """Return control to the previous driver."""
        self._link.hand_back()

    def action_request(self, name: str) -> None:
        """Call or relieve a UAV of the UGV's team."""
        self._link.request(Request[name])

    def action_zoom(self) -> None:
        """Toggle between the whole area and the UGV's surroundings."""
        self._wide = not self._wide
        self.show()

    def action_leave(self, code: int) -> None:
        """Return control and quit."""
        self._code = code
        self._link.leave()


def _has_team(view: DriveView) -> bool:
    return view.status is not None and view.status.team is not None


def _keys(view: DriveView, width: int) -> Text:
    """Return the list of keys, wrapped to the width of the screen."""
    keys = (
        ("WASD ←↑↓→", "drive"),
        ("space", "brake"),
        ("+-", f"{view.speed:.2f} m/s"),
        ("h", "return control"),
        ("z", "zoom"),
        *((("r", "relieve the guard"), ("c", "call a scout")) if _has_team(view) else ()),
        ("q", "quit"),
    )
    text, used = Text(), 0
    for key, action in keys:
        entry = Text.assemble(f" {key}", f" {action} ", style=FAINT)
        entry.stylize(f"bold {INK}", 1, 1 + len(key))
        if used and used + len(entry) > width:
            text.append("\n")
            used = 0
        text.append_text(entry)
        used += len(entry)
    return text
