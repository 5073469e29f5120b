"""The page: where everything stands, and the controls. What moves on it is drawn by the files in `static`."""

import math
import time
from typing import Any

from matplotlib.colors import to_hex
from nicegui import ui

from bus.messages import Action, Control, Law, Status
from outrider import style
from outrider.dashboard.hub import Hub
from outrider.dashboard.wheel import TELEOP
from sim.scenario_checks import DRIVER_NAMES, LAW_NAMES

_OWN = ("weighted", "path", "policy", "external")
"""Laws and drivers that a page does not offer: they need a function or a process of the user's own."""
_PERIOD = 0.25
"""Wall time between two looks at what the controls should show [s]."""
_PATIENCE = 2.0
"""So long a control shows what was chosen before it shows what is [s]."""

_HEADER = """<div class="brand"><b>Outrider</b><span id="scenario"></span></div><div id="chips"></div>
<div id="banner" role="alert" hidden></div>"""
_TILES = "".join(
    f'<div class="tile" id="tile-{name}"><label>{label}</label><output>&ndash;</output><small>{unit}</small></div>'
    for name, label, unit in (
        ("time", "time", "s"),
        ("distance", "distance ‖p<sub>Δ</sub>‖", "m"),
        ("margin", "margin to r<sub>v</sub>", "m"),
        ("error", "coverage error e(t)", "m²"),
        ("estimate", "estimate error", "m"),
        ("factor", "real-time factor", "×"),
    )
)
_MAP = """<canvas id="map" role="img" aria-label="map of the run"></canvas>
<div class="legend"><span><i class="dot uav"></i>UAV</span><span><i class="square ugv"></i>UGV</span>
<span><i class="line limit"></i><em>limit of sight r<sub>v</sub></em></span>
<span id="legend-rs"><i class="line limit dashed"></i><em>only tracking, r<sub>s</sub></em></span>
<span><i class="line uav thin"></i>range of the sensor</span>
<span><i class="line guess"></i>estimate, 2σ</span><span><i class="dot detection"></i>detections</span>
<span class="bar">0<i id="coverage-bar"></i>1 coverage C/C*</span></div>"""
_CHARTS = """<div class="charts-head"><span class="title">Over time</span>
<div class="spans" role="group" aria-label="span of time">
<button type="button" data-span="0" class="on">whole run</button><button type="button" data-span="60">last 60 s</button>
</div></div>""" + "".join(
    f'<canvas class="chart" id="chart-{name}" role="img" aria-label="{label}"></canvas>'
    for name, label in (
        ("distance", "distance over time"),
        ("error", "coverage error over time"),
        ("estimate", "error of the estimate over time"),
        ("factor", "real-time factor over time"),
    )
)
_STICK = """<div id="stick" aria-label="joystick" role="slider" aria-valuetext="centred"><i></i></div><div class="hints">
<div id="who"></div><div><kbd>&larr;</kbd><kbd>&uarr;</kbd><kbd>&darr;</kbd><kbd>&rarr;</kbd> or
<kbd>W</kbd><kbd>A</kbd><kbd>S</kbd><kbd>D</kbd></div><div><kbd>space</kbd> brakes</div><div id="pad">no gamepad</div></div>"""


def colors() -> dict[str, Any]:
    """The colours of every picture of ours, for those drawn in the browser."""
    return {
        "uav": style.UAV,
        "ugv": style.UGV,
        "limit": style.LIMIT,
        "good": style.GOOD,
        "ink": style.INK,
        "muted": style.MUTED,
        "rule": style.RULE,
        "covered": [to_hex(style.COVERED(k)) for k in range(256)],
    }


def _head() -> str:
    named = {"uav": style.UAV[0], "ugv": style.UGV[0], "limit": style.LIMIT, "good": style.GOOD, "ink": style.INK}
    named |= {"muted": style.MUTED, "rule": style.RULE, "guess": style.UAV[2], "seen": style.UAV[1]}
    stops = ", ".join(to_hex(style.COVERED(k)) for k in (0, 128, 255))
    variables = "".join(f"--{name}:{value};" for name, value in named.items()) + f"--covered:linear-gradient(90deg,{stops});"
    return (
        f"<style>:root{{{variables}}}</style><link rel='stylesheet' href='/static/dashboard.css'>"
        "<script type='module' src='/static/main.js'></script>"
    )


def build_page(hub: Hub) -> None:
    """Make the page known to NiceGUI; each browser gets one of its own."""

    @ui.page("/", title="Outrider")
    def show() -> None:
        ui.add_head_html(_head())
        ui.colors(primary=style.UAV[0], accent=style.UGV[0], negative=style.LIMIT, positive=style.GOOD)
        with ui.element("div").classes("dashboard"):
            ui.html(_HEADER, sanitize=False).classes("top")
            ui.html(_TILES, sanitize=False).classes("tiles")
            ui.html(_MAP, sanitize=False).classes("card map-card")
            ui.html(_CHARTS, sanitize=False).classes("card charts")
            with ui.element("div").classes("side"):
                if hub.may_steer:
                    controls = _Controls(hub)
                    ui.timer(_PERIOD, controls.show)
                with ui.element("div").classes("card"):
                    ui.html('<span class="title">Processes and links</span><div id="processes"></div>', sanitize=False)
                with ui.element("div").classes("card"):
                    ui.html('<span class="title">What has been changed</span><div id="changes">nothing yet</div>', sanitize=False)


class _Controls:
    """The controls of one browser; what they show follows the simulator."""

    def __init__(self, hub: Hub) -> None:
        self._hub = hub
        self._touched = -math.inf
        self._wanted = ("", "")
        self._shows = False  # while it shows what is, a control's change is nobody's wish
        with ui.element("div").classes("card"):
            ui.html('<span class="title">Run</span>', sanitize=False)
            self._build_run()
            self._build_laws()
        with ui.element("div").classes("card wheel-card").props("id=wheel-card"):
            ui.html('<span class="title">The wheel</span>', sanitize=False)
            self._build_wheel()

    def _build_run(self) -> None:
        with ui.element("div").classes("row-of"):
            self._pause = ui.button("Pause", icon="pause", on_click=self._toggle_pause).props("unelevated dense").classes("grow")
            self._step = ui.button("Step", icon="skip_next", on_click=self._make_step).props("outline dense").classes("grow")
            self._ticks = ui.number("ticks", value=1, min=1, max=1_000_000, precision=0).props("dense outlined").classes("narrow")
        with ui.element("div").classes("row-of"):
            self._lockstep = ui.switch("lockstep", value=True, on_change=self._set_speed).props("dense")
            self._speed = ui.slider(min=-1.0, max=2.0, step=0.1, value=0.0).props("aria-label=speed").classes("grow")
            self._speed.on("change", self._set_speed)
            self._factor = (
                ui.label("").classes("readout").bind_text_from(self._speed, "value", lambda value: f"{_factor_of(value):g} ×")
            )
            self._speed.bind_enabled_from(self._lockstep, "value", lambda lockstep: not lockstep)
        with ui.element("div").classes("row-of"):
            self._seed = (
                ui.number("seed", min=0, max=2**53 - 1, precision=0, placeholder="the same")
                .props("dense outlined")
                .classes("grow")
            )
            ui.button("Reset", icon="restart_alt", on_click=self._reset).props("outline dense")

    def _build_wheel(self) -> None:
        with ui.element("div").classes("row-of"):
            ui.html('<select id="wheel-vehicle" aria-label="which UGV"></select>', sanitize=False).classes("vehicle-place")
            ui.button("Take the wheel", icon="sports_esports").props("unelevated dense color=accent id=take").classes(
                "grow take"
            ).on("click", js_handler="() => window.outrider.take()")
            ui.button("Hand back").props("outline dense color=accent id=back").classes("grow back").on(
                "click", js_handler="() => window.outrider.back()"
            )
        ui.html(_STICK, sanitize=False).classes("stick-row")
        with ui.element("div").classes("row-of"):
            ui.label("full speed").classes("muted")
            self._full = (
                ui.slider(min=0.05, max=2.0, step=0.05, value=self._hub.wheel.full)
                .props("aria-label='full speed' color=accent")
                .classes("grow")
            )
            self._full.on("change", self._set_full)
            ui.label().classes("readout").bind_text_from(self._full, "value", lambda value: f"{value:.2f} m/s")

    def _build_laws(self) -> None:
        laws = [name for name in LAW_NAMES if name not in _OWN]
        drivers = [name for name in DRIVER_NAMES if name not in (TELEOP, *_OWN)]
        with ui.element("div").classes("row-of"):
            self._law = ui.select(laws, label="law", on_change=self._set_law).props("dense outlined").classes("grow")
            self._driver = ui.select(drivers, label="driver", on_change=self._set_driver).props("dense outlined").classes("grow")

    # What people want

    def _say(self, control: Control) -> None:
        self._touched = time.monotonic()
        if not self._hub.control(control):
            ui.notify("That could not be said: the bus does not take it now.", type="negative")

    def _toggle_pause(self) -> None:
        status = self._hub.status
        paused = status is not None and status.paused
        self._say(Control(action=Action.RESUME if paused else Action.PAUSE))

    def _make_step(self) -> None:
        self._say(Control(action=Action.STEP, ticks=int(self._ticks.value or 1)))

    def _set_speed(self) -> None:
        if not self._shows:
            factor = None if self._lockstep.value else _factor_of(self._speed.value)
            self._say(Control(action=Action.SPEED, factor=factor))

    def _reset(self) -> None:
        self._say(Control(action=Action.RESET, seed=None if self._seed.value is None else int(self._seed.value)))

    def _set_law(self) -> None:
        if not self._shows and self._law.value:
            self._say(Control(action=Action.LAW, law=Law(name=self._law.value)))
            self._wanted = ("law", self._law.value)

    def _set_driver(self) -> None:
        if not self._shows and self._driver.value:
            self._say(Control(action=Action.DRIVER, driver=self._driver.value))
            self._wanted = ("driver", self._driver.value)

    def _set_full(self) -> None:
        self._hub.wheel.full = float(self._full.value)

    # What is

    def show(self) -> None:
        """Let the controls show how the run stands, unless somebody has just touched them."""
        status = self._hub.status
        if status is None:
            return
        self._pause.set_text("Resume" if status.paused else "Pause")
        self._pause.set_icon("play_arrow" if status.paused else "pause")
        if time.monotonic() - self._touched < _PATIENCE:
            return
        self._tell_refusal(status)
        self._shows = True
        try:
            self._full.set_value(self._hub.wheel.full)
            self._lockstep.set_value(status.wanted_factor is None)
            if status.wanted_factor:
                self._speed.set_value(_position_of(status.wanted_factor))
            _choose(self._law, status.law)
            drivers = set(self._hub.drivers.values())
            _choose(self._driver, drivers.pop() if len(drivers) == 1 else None)
        finally:
            self._shows = False

    def _tell_refusal(self, status: Status) -> None:
        """Say so if what was chosen here is not what the simulator does."""
        (what, wanted), self._wanted = self._wanted, ("", "")
        done = {"": True, "law": status.law == wanted, "driver": wanted in self._hub.drivers.values()}
        if not (done[what] or status.paused):
            ui.notify(f"The simulator has refused the {what} {wanted}: the scenario does not allow it.", type="negative")


def _factor_of(position: float) -> float:
    """The factor at a place of the slider, which is its logarithm, rounded to what one would say."""
    return float(f"{10.0**position:.2g}")


def _position_of(factor: float) -> float:
    return min(max(math.log10(factor), -1.0), 2.0)


def _choose(select: ui.select, value: str | None) -> None:
    """Show a value, also one that cannot be chosen here."""
    if value and value not in select.options:
        select.set_options([*select.options, value], value=value)
    elif select.value != (value or None):
        select.set_value(value or None)
