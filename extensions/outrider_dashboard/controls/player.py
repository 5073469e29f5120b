"""Controls of a recording: playback, and the disabled controls of a run."""

import math
import time
from typing import Any

from nicegui import ui
from nicegui.events import GenericEventArguments

from bus.messages.base import MAX_SEED
from bus.registry import DRIVERS, LAWS
from outrider_dashboard.controls.links_card import RECORDING, LinkForm
from outrider_dashboard.controls.run_card import choose, factor_of, position_of
from outrider_dashboard.controls.widgets import (
    button,
    card,
    number,
    readout,
    row,
    select_row,
    slider,
    ticks,
)
from outrider_dashboard.hub import Hub
from outrider_dashboard.sources.recorded import RecordedRun

_PATIENCE = 1.0
"""Time for which a control shows the user's choice before it shows the playback state again [s]."""
_THROTTLE = 0.1
"""Wall time between two events of a moving slider [s]."""


class Player:
    """Controls of one browser.

    Args:
        hub: State shown by the page.
        recorded: Recorded run to control.
    """

    def __init__(self, hub: Hub, recorded: RecordedRun) -> None:
        self._hub, self._recorded = hub, recorded
        self._touched = -math.inf
        name = '<span id="file" class="muted"></span>'
        with card("Replay", beside=name):
            self._build_player()
        with card("Settings of the run"):
            self._build_settings()
        with card("Operator control"):
            with row():
                take = "unelevated color=accent disable"
                button("Take control", icon="sports_esports", props=take)
            ui.label("Vehicles cannot be driven: this is a recording.").classes("note")
        LinkForm(None, RECORDING)

    def _build_player(self) -> None:
        recorded = self._recorded
        with row():
            self._play = button("Pause", self._toggle, icon="pause", props="unelevated")
            self._step = button("Step", self._make_step, icon="skip_next")
            self._ticks = ticks()
        with row():
            start = "flat round aria-label='Back to the start'"
            button(
                "",
                lambda: recorded.seek(recorded.begin),
                icon="replay",
                props=start,
                classes="small",
            )
            span = max(recorded.end - recorded.begin, 1e-3)
            self._at = slider(
                "Time",
                min=recorded.begin,
                max=recorded.begin + span,
                step=span / 1000.0,
                value=recorded.begin,
            )
            self._at.on("update:model-value", self._seek, throttle=_THROTTLE)
            self._time = readout(
                "Simulated time shown, and end of the recording [s]", classes="wide"
            )
        with row():
            ui.label("Speed").classes("muted")
            self._speed = slider(
                "Speed", min=-1.0, max=2.0, step=0.1, value=position_of(recorded.speed)
            )
            self._speed.on("update:model-value", self._set_speed, throttle=_THROTTLE)
            self._factor = readout("Simulated seconds per second of wall time")

    def _build_settings(self) -> None:
        with row():
            self._law = select_row(LAWS, [], "Law", props="disable")
            self._driver = select_row(DRIVERS, [], "Driver", props="disable")
        with row():
            meaning = "Seed of all random numbers"
            self._seed = number(
                "Seed",
                low=0,
                high=MAX_SEED,
                meaning=meaning,
                needed=False,
                props="disable",
                classes="grow",
            )
            button("Reset", icon="restart_alt", props="outline disable", classes="")
        ui.label("Law, driver and seed cannot be changed: this is a recording.").classes("note")

    # Input

    def _toggle(self) -> None:
        if self._recorded.playing:
            self._recorded.pause()
        else:
            self._recorded.play()

    def _make_step(self) -> None:
        if self._ticks.error is None:
            self._recorded.step(int(self._ticks.value))

    def _seek(self, event: GenericEventArguments) -> None:
        self._touched = time.monotonic()
        self._recorded.seek(_number(event.args))

    def _set_speed(self, event: GenericEventArguments) -> None:
        self._touched = time.monotonic()
        self._recorded.speed = factor_of(_number(event.args))

    # Display

    def show(self) -> None:
        """Show the playback state, unless the user has just changed a control."""
        recorded, playing = self._recorded, self._recorded.state.replay
        if playing is None:
            return
        self._play.set_text("Pause" if playing.playing else "Play")
        self._play.set_icon("pause" if playing.playing else "play_arrow")
        self._time.set_text(f"{playing.at:.1f} of {playing.end:.1f} s")
        self._factor.set_text(f"{playing.speed:g} ×")
        if time.monotonic() - self._touched >= _PATIENCE:
            self._at.set_value(playing.at)
            self._speed.set_value(position_of(recorded.speed))
        status = self._hub.status
        if status is None:
            return
        choose(self._law, status.law if self._hub.history.escorts else None)
        choose(self._driver, ", ".join(sorted(set(status.drivers.values()))))
        self._seed.set_value(status.seed)


def _number(value: Any) -> float:  # noqa: ANN401 - sent by the browser
    found = float(value)
    return found if math.isfinite(found) else 0.0
