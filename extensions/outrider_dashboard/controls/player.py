"""The controls of a recording that is played. What steers a run is shown, and cannot be touched."""

import math
import time
from typing import Any

from nicegui import ui
from nicegui.events import GenericEventArguments

from bus.registry import DRIVERS, LAWS
from outrider_dashboard.controls.links_card import RECORDING, LinkForm
from outrider_dashboard.controls.run_card import HIGHEST_SEED, choose, factor_of, position_of
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
from outrider_dashboard.sources.tape import Tape

_PATIENCE = 1.0
"""So long a control shows what was chosen before it shows what is [s]."""
_THROTTLE = 0.1
"""Wall time between two words of a slider that is moved [s]."""


class Player:
    """The controls of one browser.

    Args:
        hub: What is shown.
        tape: What is played.
    """

    def __init__(self, hub: Hub, tape: Tape) -> None:
        self._hub, self._tape = hub, tape
        self._touched = -math.inf
        name = '<span id="file" class="muted"></span>'
        with card("Replay", beside=name):
            self._build_player()
        with card("As it was flown"):
            self._build_settings()
        with card("The wheel"):
            with row():
                take = "unelevated color=accent disable"
                button("Take the wheel", icon="sports_esports", props=take)
            ui.label("Nobody can drive: this is a recording.").classes("note")
        LinkForm(None, RECORDING)

    def _build_player(self) -> None:
        tape = self._tape
        with row():
            self._play = button("Pause", self._toggle, icon="pause", props="unelevated")
            self._step = button("Step", self._make_step, icon="skip_next")
            self._ticks = ticks()
        with row():
            start = "flat round aria-label='to the start'"
            button("", lambda: tape.wind(tape.begin), icon="replay", props=start, classes="small")
            span = max(tape.end - tape.begin, 1e-3)
            self._at = slider(
                "time",
                min=tape.begin,
                max=tape.begin + span,
                step=span / 1000.0,
                value=tape.begin,
            )
            self._at.on("update:model-value", self._seek, throttle=_THROTTLE)
            self._time = readout("Simulated time that is shown, and the end [s]", classes="wide")
        with row():
            ui.label("speed").classes("muted")
            self._speed = slider(
                "speed", min=-1.0, max=2.0, step=0.1, value=position_of(tape.speed)
            )
            self._speed.on("update:model-value", self._set_speed, throttle=_THROTTLE)
            self._factor = readout("Simulated seconds per second of wall time")

    def _build_settings(self) -> None:
        with row():
            self._law = select_row(LAWS, [], "law", props="disable")
            self._driver = select_row(DRIVERS, [], "driver", props="disable")
        with row():
            meaning = "Seed of all random numbers"
            self._seed = number(
                "seed",
                low=0,
                high=HIGHEST_SEED,
                meaning=meaning,
                needed=False,
                props="disable",
                classes="grow",
            )
            button("Reset", icon="restart_alt", props="outline disable", classes="")
        ui.label("Law, driver and seed cannot be changed: this is a recording.").classes("note")

    # What people want

    def _toggle(self) -> None:
        if self._tape.playing:
            self._tape.pause()
        else:
            self._tape.play()

    def _make_step(self) -> None:
        if self._ticks.error is None:
            self._tape.step(int(self._ticks.value))

    def _seek(self, event: GenericEventArguments) -> None:
        self._touched = time.monotonic()
        self._tape.wind(_number(event.args))

    def _set_speed(self, event: GenericEventArguments) -> None:
        self._touched = time.monotonic()
        self._tape.speed = factor_of(_number(event.args))

    # What is

    def show(self) -> None:
        """Let the controls show how the recording is played, unless somebody has just touched them."""
        tape, playing = self._tape, self._tape.standing.replay
        if playing is None:
            return
        self._play.set_text("Pause" if playing.playing else "Play")
        self._play.set_icon("pause" if playing.playing else "play_arrow")
        self._time.set_text(f"{playing.at:.1f} of {playing.end:.1f} s")
        self._factor.set_text(f"{playing.speed:g} ×")
        if time.monotonic() - self._touched >= _PATIENCE:
            self._at.set_value(playing.at)
            self._speed.set_value(position_of(tape.speed))
        status = self._hub.status
        if status is None:
            return
        choose(self._law, status.law if self._hub.history.escorts else None)
        choose(self._driver, ", ".join(sorted(set(status.drivers.values()))))
        self._seed.set_value(status.seed)


def _number(value: Any) -> float:  # noqa: ANN401 - what the browser says
    found = float(value)
    return found if math.isfinite(found) else 0.0
