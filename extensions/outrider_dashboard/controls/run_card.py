"""Controls of a live run."""

import math
import time

import msgspec
from nicegui import ui

from bus.messages.base import MAX_SEED
from bus.messages.control import Action, Control
from bus.messages.scenario import Law
from bus.messages.telemetry import Status
from bus.registry import DRIVERS, LAWS
from outrider_dashboard.controls.links_card import LinkForm
from outrider_dashboard.controls.widgets import (
    button,
    card,
    html,
    number,
    readout,
    row,
    select_row,
    slider,
    ticks,
)
from outrider_dashboard.hub import Hub

_PATIENCE = 2.0
"""Time for which a control shows the user's choice before it shows the simulator's state again [s]."""

_STICK = """<div id="stick" aria-label="Joystick" role="slider" aria-valuetext="centered"><i></i></div>
<div class="hints">
<div id="who"></div><div><kbd>&larr;</kbd><kbd>&uarr;</kbd><kbd>&darr;</kbd><kbd>&rarr;</kbd> or
<kbd>W</kbd><kbd>A</kbd><kbd>S</kbd><kbd>D</kbd></div><div><kbd>Space</kbd> to brake</div><div id="pad">No
gamepad</div></div>"""


class Controls:
    """Controls of one browser, updated from the simulator's status."""

    def __init__(self, hub: Hub) -> None:
        self._hub = hub
        self._touched = -math.inf
        self._requested = ("", "")
        self._refreshing = False  # True: a changed widget is not a command of the user
        with card("Run"):
            self._build_run()
            self._build_laws()
        with card("Operator control", classes="wheel-card", props="id=wheel-card"):
            self._build_teleoperation()
        self._links = LinkForm(hub)

    def _build_run(self) -> None:
        with row():
            self._pause = button("Pause", self._toggle_pause, icon="pause", props="unelevated")
            self._step = button("Step", self._make_step, icon="skip_next")
            self._ticks = ticks()
        with row():
            self._lockstep = ui.switch("Lockstep", value=True, on_change=self._set_speed)
            self._lockstep.props("dense")
            self._speed = slider("Speed", min=-1.0, max=2.0, step=0.1, value=0.0)
            self._speed.on("change", self._set_speed)
            self._factor = readout("Target speed: simulated seconds per second of wall time")
            self._factor.bind_text_from(self._speed, "value", lambda x: f"{factor_of(x):g} ×")
            self._speed.bind_enabled_from(self._lockstep, "value", lambda lockstep: not lockstep)
        with row():
            self._seed = number(
                "Seed",
                low=0,
                high=MAX_SEED,
                whole=True,
                needed=False,
                meaning="Seed of the run after a reset; empty: the same seed",
                placeholder="same",
                classes="grow",
            )
            button("Reset", self._reset, icon="restart_alt", classes="")

    def _build_teleoperation(self) -> None:
        with row():
            html(
                '<select id="wheel-vehicle" aria-label="UGV to control"></select>', "vehicle-place"
            )
            take = "unelevated color=accent id=take"
            button("Take control", icon="sports_esports", props=take, classes="grow take").on(
                "click", js_handler="() => window.outrider.take()"
            )
            button("Return control", props="outline color=accent id=back", classes="grow back").on(
                "click", js_handler="() => window.outrider.back()"
            )
        html(_STICK, "stick-row")
        with row():
            ui.label("Full speed").classes("muted")
            share = self._hub.teleoperation.speed_share
            self._full = slider(
                "Full speed", min=0.05, max=1.0, step=0.05, value=share, props="color=accent"
            )
            self._full.on("change", self._set_full)
            self._top = readout("Speed at full deflection")
            self._full.on_value_change(self._show_full)
            self._show_full()

    def _build_laws(self) -> None:
        laws = [law.name for law in LAWS.values() if not law.own]  # a page cannot supply a function
        drivers = [
            driver.name
            for driver in DRIVERS.values()
            if not (driver.own or driver.outside or driver.operated)
        ]
        with row():
            self._law = select_row(LAWS, laws, "Law", on_change=self._set_law)
            self._driver = select_row(DRIVERS, drivers, "Driver", on_change=self._set_driver)

    # Input

    def _send(self, control: Control) -> None:
        self._touched = time.monotonic()
        if self._hub.status is not None and self._hub.status.over:
            ui.notify("The run is over: it can no longer be controlled.", type="warning")
            return
        if not self._hub.source.control(control):
            ui.notify("The command could not be sent. Try again.", type="negative")

    def _toggle_pause(self) -> None:
        status = self._hub.status
        paused = status is not None and status.paused
        self._send(Control(action=Action.RESUME if paused else Action.PAUSE))

    def _make_step(self) -> None:
        if self._ticks.error is None:
            self._send(Control(action=Action.STEP, ticks=int(self._ticks.value)))

    def _set_speed(self) -> None:
        if not self._refreshing:
            factor = None if self._lockstep.value else factor_of(self._speed.value)
            self._send(Control(action=Action.SPEED, factor=factor))

    def _reset(self) -> None:
        if self._seed.error is not None:
            return
        self._send(
            Control(
                action=Action.RESET,
                seed=None if self._seed.value is None else int(self._seed.value),
            )
        )

    def _set_law(self) -> None:
        if not self._refreshing and self._law.value:
            name, known = self._law.value, self._hub.law
            law = Law(name=name) if known is None else msgspec.structs.replace(known, name=name)
            self._send(Control(action=Action.LAW, law=law))
            self._requested = ("law", name)
            if known is None:
                ui.notify(
                    f"{name} uses its default gains: the gains of the previous law are unknown.",
                    type="warning",
                )

    def _set_driver(self) -> None:
        if not self._refreshing and self._driver.value:
            self._send(Control(action=Action.DRIVER, driver=self._driver.value))
            self._requested = ("driver", self._driver.value)

    def _set_full(self) -> None:
        self._hub.teleoperation.speed_share = float(self._full.value)

    def _show_full(self) -> None:
        """Show the speed at full deflection of the controlled UGV, or of the fastest one."""
        teleoperation = self._hub.teleoperation
        vehicles = [teleoperation.vehicle] if teleoperation.holder else self._hub.drivers
        speeds = [teleoperation.max_speed(name) for name in vehicles]
        fastest = max(speeds, default=teleoperation.max_speed(""))
        self._top.set_text(f"{self._full.value * fastest:.2f} m/s")

    # Display

    def show(self) -> None:
        """Show the state of the run, unless the user has just changed a control."""
        status = self._hub.status
        if status is None:
            return
        self._links.show()
        self._show_full()
        self._pause.set_text("Resume" if status.paused else "Pause")
        self._pause.set_icon("play_arrow" if status.paused else "pause")
        if time.monotonic() - self._touched < _PATIENCE:
            return
        self._report_rejection(status)
        self._refreshing = True
        try:
            self._full.set_value(self._hub.teleoperation.speed_share)
            self._lockstep.set_value(status.target_factor is None)
            if status.target_factor:
                self._speed.set_value(position_of(status.target_factor))
            choose(self._law, status.law if self._hub.history.escorts else None)
            drivers = set(self._hub.drivers.values())
            choose(self._driver, drivers.pop() if len(drivers) == 1 else None)
        finally:
            self._refreshing = False

    def _report_rejection(self, status: Status) -> None:
        """Notify the user if a requested law or driver has not taken effect."""
        (what, wanted), self._requested = self._requested, ("", "")
        done = {
            "": True,
            "law": status.law == wanted,
            "driver": wanted in self._hub.drivers.values(),
        }
        if not (done[what] or status.paused):
            reasons = [one.reason for one in status.rejections if one.action == what]
            why = f": {reasons[-1]}" if reasons else " yet"
            ui.notify(f"The {what} {wanted} has not taken effect{why}.", type="negative")


def factor_of(position: float) -> float:
    """Return the factor at a position of the logarithmic slider, rounded to two digits."""
    return float(f"{10.0**position:.2g}")


def position_of(factor: float) -> float:
    """Return the position of the slider for a factor."""
    return min(max(math.log10(factor), -1.0), 2.0)


def choose(select: ui.select, value: str | None) -> None:
    """Show a value, adding it to the options if necessary."""
    if value and value not in select.options:
        select.set_options([*select.options, value], value=value)
    elif select.value != (value or None):
        select.set_value(value or None)
