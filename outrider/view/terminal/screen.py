"""The screen: a Textual app that shows the link's view and passes keys on."""

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

from outrider.view.terminal.canvas import Canvas
from outrider.view.terminal.palette import BACKGROUND, FAINT, INK, PANEL
from outrider.view.terminal.panel import WIDTH, ErrorCurve, banner, farthest, numbers, title
from outrider.view.terminal.pressed_keys import Heading
from outrider.view.terminal.teleoperation import DriveLink, DriveView
from outrider.view.terminal.topview import Trails, draw

_PERIOD = 0.1
"""Time between two pictures [s]; the map has every second one, for the sake of slow connections."""
_NARROW = WIDTH + 20
"""Below this width the map makes room for the numbers [cells]."""

_HEADINGS = {
    "up,w,W": Heading.NORTH,
    "down,s,S": Heading.SOUTH,
    "left,a,A": Heading.WEST,
    "right,d,D": Heading.EAST,
}
"""The meaning of the keys; with caps lock too."""


class TopView(Widget):
    """The map."""

    canvas: Canvas | None = None

    def render_line(self, y: int) -> Strip:
        """One line of it."""
        if self.canvas is None or y >= self.canvas.height:
            return Strip.blank(self.size.width)
        return Strip(self.canvas.row(y)).adjust_cell_length(self.size.width)


class DriveApp(App[int]):
    """Shows one UGV's drive until it is over.

    Args:
        link: Does the driving.
        run: The run's name.
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
        """The rooms of the screen."""
        yield Static(id="title")
        yield Static(id="banner")
        with Horizontal(id="body"):
            yield Static(id="numbers")
            yield TopView(id="map")
        yield Static(id="keys")

    def on_mount(self) -> None:
        """Begin to draw."""
        self.set_interval(_PERIOD, self.show)
        self.show()

    def on_resize(self, event: events.Resize) -> None:
        """Give the numbers precedence where it is narrow."""
        self.query_one(TopView).display = event.size.width >= _NARROW
        self.call_after_refresh(self.show)

    def show(self) -> None:
        """Draw all that is known now."""
        if self._link.over:
            self.exit(self._code)
            return
        if not self.query(TopView):
            return  # the screen is being taken down, and the clock has ticked once more
        view = self._link.view()
        self._remember(view)
        told = banner(view, self._link.vehicle, leaving=self._link.leaving)
        line = self.query_one("#banner", Static)
        line.update(Text(told.text))
        line.styles.background, line.styles.color = told.ground, told.color
        self.query_one("#title", Static).update(
            title(view, self._run_name, wide=self.size.width >= _NARROW)
        )
        self.query_one("#numbers", Static).update(numbers(view, self._link.vehicle, self._history))
        self.query_one("#keys", Static).update(_keys(view, self.size.width))
        if self._pictures % 2 == 0:
            self._draw_map(view)
        self._pictures += 1

    def _remember(self, view: DriveView) -> None:
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
        """Drive that way for a moment."""
        self._link.press(Heading[name])

    def action_brake(self) -> None:
        """Brake."""
        self._link.brake()

    def action_faster(self, steps: int) -> None:
        """Set the speed."""
        self._link.faster(steps)

    def action_hand_back(self) -> None:
        """Let the driver from before drive on."""
        self._link.hand_back()

    def action_zoom(self) -> None:
        """Show the whole area, or the surroundings."""
        self._wide = not self._wide
        self.show()

    def action_leave(self, code: int) -> None:
        """Hand the wheel back and leave."""
        self._code = code
        self._link.leave()


def _keys(view: DriveView, width: int) -> Text:
    """The keys and what they do, in as many lines as it takes: none is lost where it is narrow."""
    words = (
        ("WASD ←↑↓→", "drive"),
        ("space", "brake"),
        ("+-", f"{view.speed:.2f} m/s"),
        ("h", "hand back"),
        ("z", "zoom"),
        ("q", "leave"),
    )
    text, used = Text(), 0
    for key, word in words:
        entry = Text.assemble(f" {key}", f" {word} ", style=FAINT)
        entry.stylize(f"bold {INK}", 1, 1 + len(key))
        if used and used + len(entry) > width:
            text.append("\n")
            used = 0
        text.append_text(entry)
        used += len(entry)
    return text
