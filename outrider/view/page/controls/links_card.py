"""The card of the radio links in the page, and the form in it that changes them while the run is flown."""

import math
import time
from typing import Any

import msgspec
from nicegui import ui
from nicegui.events import GenericEventArguments

from bus.messages import LinkKind, LinkSettings, Status
from bus.profiles import PROFILES
from outrider.view.page.controls.network import (
    ALL,
    chosen,
    controls_for,
    darkened,
    with_field,
    words,
)
from outrider.view.page.hub import Hub

OBSERVER = "This page only looks on: changing a link takes the operator's credentials."
RECORDING = "No link can be changed: it has all been flown."
"""Why the form cannot be touched where nobody steers."""
_PATIENCE = 2.0
"""So long the form shows what was chosen before it shows what is [s]."""
_LEAD = 0.1
"""Wall time that a wish takes to the simulator at most [s].

A blackout begins after it, so that none of it is over by then.
"""
_OWN = "own"
"""Shown as the profile where the settings are none's."""

_SLIDERS = (
    ("delay", "delay", "s", 3.0, 0.05, 30.0, 1.0),
    ("jitter", "jitter", "s", 1.0, 0.01, 10.0, 1.0),
    ("loss", "loss", "%", 100.0, 1.0, 100.0, 0.01),
    ("burst_length", "bursts of", "s", 3.0, 0.05, 1000.0, 1.0),
    ("burst_interval", "one every", "s", 30.0, 0.5, 1000.0, 1.0),
)
"""Field, label, unit, end of the slider, its step, the most that can be typed, and what one unit is in the field."""


class LinkForm:
    """The card of the links, with its form, in one browser.

    Args:
        hub: What is shown and changed; None: nothing can be changed.
        reason: Why nothing can be changed.
    """

    def __init__(self, hub: Hub | None, reason: str = "") -> None:
        self._hub = hub
        self._touched = -math.inf
        self._shows = False  # while it shows what is, a change in it is nobody's wish
        self._said: dict[str, LinkSettings] = {}  # what was wished for and is not yet in a status
        self._refusals: tuple[str, ...] = ()
        self._off = "" if hub is not None else " disable"
        with ui.element("div").classes("card links-card").props("id=links-card hidden"):
            ui.html(
                '<span class="title">Links</span><span class="muted">got through · age now</span>',
                sanitize=False,
            ).classes("head")
            ui.html(
                '<div id="links"></div><div id="link-refusal" class="refused" role="alert"></div>',
                sanitize=False,
            )
            self._build(reason)
        if hub is not None:
            ui.on("choose_link", self._choose)

    def _build(self, reason: str) -> None:
        if reason:
            ui.label(reason).classes("note reason")
        with ui.element("div").classes("row-of form-head"):
            self._kind = self._select(
                "link", {ALL: "all", **{str(kind): str(kind) for kind in LinkKind}}, ALL
            )
            self._vehicle = self._select("of", {ALL: "all"}, ALL)
        with ui.element("div").classes("row-of"):
            self._profile = self._select("profile", [*PROFILES, _OWN], None)
            ui.button("Perfect", on_click=self._perfect).props("outline dense" + self._off)
        self._kind.on_value_change(self._turn)
        self._vehicle.on_value_change(self._turn)
        self._profile.on_value_change(self._set_profile)
        # Where nothing can be changed they would only show numbers that are none of the links'.
        self._sliders = {row[0]: self._slider(*row) for row in _SLIDERS if not reason}
        with ui.element("div").classes("row-of"):
            self._dark = ui.button("Blackout for 5 s", on_click=self._blackout).props(
                "unelevated dense color=negative" + self._off
            )
            self._dark.classes("grow")
            self._length = ui.number(
                value=5, min=0.1, max=3600, step=1, suffix="s", on_change=self._name_blackout
            )
            self._length.props(
                "dense outlined aria-label='length of the blackout [s]'" + self._off
            ).classes("value")
        self._note = ui.label(
            "The chosen links differ; what you move is set for all of them, the rest stays."
        ).classes("note")
        self._note.set_visibility(False)

    def _select(self, label: str, options: Any, value: str | None) -> ui.select:  # noqa: ANN401 - a list or a dictionary
        return (
            ui.select(options, label=label, value=value)
            .props("dense outlined" + self._off)
            .classes("grow")
        )

    def _slider(
        self, field: str, label: str, unit: str, end: float, step: float, most: float, one: float
    ) -> tuple[ui.slider, ui.number, float]:
        with ui.element("div").classes("row-of slider-row"):
            ui.label(label).classes("slider-label")
            slider = ui.slider(min=0.0, max=end, step=step, value=0.0).props(
                f"aria-label='{label} [{unit}]'"
            )
            slider.classes("grow")
            number = ui.number(value=0, min=0.0, max=most, step=step, suffix=unit)
            number.props(f"dense outlined aria-label='{label}, number [{unit}]'").classes("value")

        def follow() -> None:
            if not self._shows:
                self._touched = time.monotonic()
                number.set_value(round(slider.value, 3))

        def typed() -> None:
            if number.value is not None and not self._shows:
                self._set(field, number.value * one)

        def released(event: GenericEventArguments) -> None:
            self._set(field, float(event.args) * one)

        slider.on_value_change(follow)
        slider.on("change", released)  # when it is let go
        number.on("blur", typed).on("keydown.enter", js_handler="(event) => event.target.blur()")
        number.on("focus", self._touch).on("keydown", self._touch)
        return slider, number, one

    # What people want

    def _touch(self) -> None:
        self._touched = time.monotonic()

    def _turn(self) -> None:
        """Other links are chosen: show theirs."""
        if not self._shows:
            self._touched = -math.inf
            self.show()

    def _choose(self, event: GenericEventArguments) -> None:
        """A row was touched."""
        owner, _, kind = str(event.args).partition("/")
        if kind in self._kind.options and str(event.args) in self._names:
            self._kind.set_value(kind)
            self._offer()
            self._vehicle.set_value(owner)

    def _set(self, field: str, value: float) -> None:
        names = self._chosen
        if math.isfinite(value) and any(
            not math.isclose(getattr(self._settings(name), field), value) for name in names
        ):
            self._send(
                {name: with_field(self._settings(name), field, round(value, 6)) for name in names}
            )

    def _set_profile(self) -> None:
        name = self._profile.value
        if not self._shows and name in PROFILES:
            profile = PROFILES[name]
            planned = {link: self._settings(link).blackouts for link in self._chosen}
            self._send(
                {
                    link: msgspec.structs.replace(profile, blackouts=rows)
                    for link, rows in planned.items()
                }
            )

    def _perfect(self) -> None:
        self._send(dict.fromkeys(self._chosen, LinkSettings()))

    def _name_blackout(self) -> None:
        self._dark.set_text(f"Blackout for {self._length.value or 0:g} s")

    def _blackout(self) -> None:
        hub, length = self._hub, self._length.value
        if hub is not None and length:
            now = (hub.history.newest[0] if hub.history.newest else 0.0) or 0.0
            now += hub.source.factor * _LEAD
            self._send(
                {name: darkened(self._settings(name), now, float(length)) for name in self._chosen}
            )

    def _send(self, wanted: dict[str, LinkSettings]) -> None:
        if self._hub is None:
            return
        self._touch()
        for control in controls_for(wanted, self._names):
            if not self._hub.source.control(control):
                ui.notify("That could not be said: the bus does not take it now.", type="negative")
                return
        self._said |= wanted

    # What is

    @property
    def _names(self) -> list[str]:
        status = None if self._hub is None else self._hub.status
        return [] if status is None else list(status.links)

    @property
    def _chosen(self) -> list[str]:
        return chosen(self._names, self._kind.value, self._vehicle.value)

    def _settings(self, name: str) -> LinkSettings:
        """What a link is set to, or was asked to be."""
        status = None if self._hub is None else self._hub.status
        if name in self._said or status is None:
            return self._said.get(name, LinkSettings())
        return status.links[name].settings or LinkSettings()

    def _offer(self) -> None:
        """Offer the vehicles that have such a link."""
        owners = sorted({name.split("/")[0] for name in chosen(self._names, self._kind.value, ALL)})
        options = {ALL: "all", **{name: name for name in owners}}
        if self._vehicle.options != options:
            self._vehicle.set_options(
                options, value=self._vehicle.value if self._vehicle.value in options else ALL
            )

    def show(self) -> None:
        """Let the form show how the chosen links are set, unless somebody has just touched it."""
        status = None if self._hub is None else self._hub.status
        if status is None or time.monotonic() - self._touched < _PATIENCE:
            self._forget(status)
            return
        self._said.clear()
        self._shows = True
        try:
            self._offer()
            names = self._chosen
            if names:
                self._show(
                    self._settings(names[0]),
                    len({words(self._settings(name)) for name in names}) > 1,
                )
        finally:
            self._shows = False

    def _forget(self, status: Status | None) -> None:
        """Drop the wishes that have come true, and all of them where one was refused."""
        if status is None:
            return
        if status.refusals != self._refusals:
            self._refusals, self._said, self._touched = status.refusals, {}, -math.inf
        done = [
            name
            for name, settings in self._said.items()
            if name in status.links and status.links[name].settings == settings
        ]
        for name in done:
            del self._said[name]

    def _show(self, settings: LinkSettings, differ: bool) -> None:
        said = words(settings)
        self._profile.set_value(said if said in PROFILES and not differ else _OWN)
        for field, (slider, number, one) in self._sliders.items():
            value = round(getattr(settings, field) / one, 3)
            slider.set_value(min(value, slider.props["max"]))
            number.set_value(value)
        self._note.set_visibility(differ)
