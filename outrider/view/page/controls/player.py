"""The controls of a recording that is played. What steers a run is shown, and cannot be touched."""

import math
import time
from typing import Any

from nicegui import ui
from nicegui.events import GenericEventArguments

from outrider.view.page.controls.links_card import RECORDING, LinkForm
from outrider.view.page.controls.run_card import choose, factor_of, position_of
from outrider.view.page.hub import Hub
from outrider.view.page.sources.tape import Tape

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
        with ui.element("div").classes("card"):
            ui.html(
                '<span class="title">Replay</span><span id="file" class="muted"></span>',
                sanitize=False,
            ).classes("head")
            self._build_player()
        with ui.element("div").classes("card"):
            ui.html('<span class="title">As it was flown</span>', sanitize=False)
            self._build_settings()
        with ui.element("div").classes("card"):
            ui.html('<span class="title">The wheel</span>', sanitize=False)
            with ui.element("div").classes("row-of"):
                ui.button("Take the wheel", icon="sports_esports").props(
                    "unelevated dense color=accent disable"
                ).classes("grow")
            ui.label("Nobody can drive: this is a recording.").classes("note")
        LinkForm(None, RECORDING)

    def _build_player(self) -> None:
        tape = self._tape
        with ui.element("div").classes("row-of"):
            self._play = (
                ui.button("Pause", icon="pause", on_click=self._toggle)
                .props("unelevated dense")
                .classes("grow")
            )
            self._step = (
                ui.button("Step", icon="skip_next", on_click=self._make_step)
                .props("outline dense")
                .classes("grow")
            )
            self._ticks = (
                ui.number("ticks", value=1, min=1, max=1_000_000, precision=0)
                .props("dense outlined")
                .classes("narrow")
            )
        with ui.element("div").classes("row-of"):
            ui.button(icon="replay", on_click=lambda: self._wind(tape.begin)).props(
                "flat dense round aria-label='to the start'"
            ).classes("small")
            span = max(tape.end - tape.begin, 1e-3)
            self._at = ui.slider(
                min=tape.begin, max=tape.begin + span, step=span / 1000.0, value=tape.begin
            )
            self._at.props("aria-label=time").classes("grow")
            self._at.on("update:model-value", self._seek, throttle=_THROTTLE)
            self._time = ui.label("").classes("readout wide")
        with ui.element("div").classes("row-of"):
            ui.label("speed").classes("muted")
            self._speed = ui.slider(
                min=-1.0, max=2.0, step=0.1, value=position_of(tape.speed)
            ).props("aria-label=speed")
            self._speed.classes("grow").on(
                "update:model-value", self._set_speed, throttle=_THROTTLE
            )
            self._factor = ui.label("").classes("readout")

    def _build_settings(self) -> None:
        with ui.element("div").classes("row-of"):
            self._law = ui.select([], label="law").props("dense outlined disable").classes("grow")
            self._driver = (
                ui.select([], label="driver").props("dense outlined disable").classes("grow")
            )
        with ui.element("div").classes("row-of"):
            self._seed = ui.number("seed").props("dense outlined disable").classes("grow")
            ui.button("Reset", icon="restart_alt").props("outline dense disable")
        ui.label("Law, driver and seed cannot be changed: this is a recording.").classes("note")

    # What people want

    def _toggle(self) -> None:
        if self._tape.playing:
            self._tape.pause()
        else:
            self._tape.play()

    def _make_step(self) -> None:
        self._tape.step(int(self._ticks.value or 1))

    def _wind(self, to: float) -> None:
        self._tape.wind(to)

    def _seek(self, event: GenericEventArguments) -> None:
        self._touched = time.monotonic()
        self._wind(_number(event.args))

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
        choose(self._law, status.law)
        choose(self._driver, ", ".join(sorted(set(status.drivers.values()))))
        self._seed.set_value(status.seed)


def _number(value: Any) -> float:  # noqa: ANN401 - what the browser says
    found = float(value)
    return found if math.isfinite(found) else 0.0
