"""The card of the radio links in the page, and the form in it that changes them while the run is flown."""

import math
import time

import msgspec
from nicegui import ui
from nicegui.events import GenericEventArguments

from bus.messages.links import LinkKind, LinkSettings
from bus.messages.telemetry import Status
from bus.profiles import PROFILES
from outrider_dashboard.controls.link_words import (
    ALL,
    chosen,
    controls_for,
    darkened,
    with_field,
    words,
)
from outrider_dashboard.controls.widgets import button, card, html, number, row, select, slider
from outrider_dashboard.hub import Hub

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
    ("delay", "delay", "s", 3.0, 0.05, 30.0, 1.0, "Time that each message takes [s]"),
    ("jitter", "jitter", "s", 1.0, 0.01, 10.0, 1.0, "Random time in addition to the delay [s]"),
    ("loss", "loss", "%", 100.0, 1.0, 100.0, 0.01, "Share of messages that are lost [%]"),
    ("burst_length", "bursts of", "s", 3.0, 0.05, 1000.0, 1.0, "Length of a burst of losses [s]"),
    ("burst_interval", "one every", "s", 30.0, 0.5, 1000.0, 1.0, "Time between two bursts [s]"),
)
"""Field, label, unit, end of the slider, its step, the most that can be typed, one unit in the field, and meaning."""


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
        head = '<span class="muted">got through · age now</span>'
        with card("Links", beside=head, classes="links-card", props="id=links-card hidden"):
            html('<div id="links"></div><div id="link-refusal" class="refused" role="alert"></div>')
            self._build(reason)
        if hub is not None:
            ui.on("choose_link", self._choose)

    def _build(self, reason: str) -> None:
        if reason:
            ui.label(reason).classes("note reason")
        kinds = {ALL: "all", **{str(kind): str(kind) for kind in LinkKind}}
        with row("form-head"):
            self._kind = select(kinds, "link", value=ALL, props=self._off)
            self._vehicle = select({ALL: "all"}, "of", value=ALL, props=self._off)
        with row():
            self._profile = select([*PROFILES, _OWN], "profile", value=None, props=self._off)
            button("Perfect", self._perfect, props="outline" + self._off, classes="")
        self._kind.on_value_change(self._turn)
        self._vehicle.on_value_change(self._turn)
        self._profile.on_value_change(self._set_profile)
        # Where nothing can be changed they would only show numbers that are none of the links'.
        self._sliders = {of[0]: self._slider(*of) for of in _SLIDERS if not reason}
        with row():
            red = "unelevated color=negative" + self._off
            self._dark = button("Blackout for 5 s", self._blackout, props=red)
            self._length = number(
                value=5,
                low=0.1,
                high=3600,
                meaning="Length of the blackout [s]",
                step=1,
                suffix="s",
                on_change=self._name_blackout,
                props="aria-label='length of the blackout [s]'" + self._off,
                classes="value",
            )
        self._note = ui.label(
            "The chosen links differ; what you move is set for all of them, the rest stays."
        ).classes("note")
        self._note.set_visibility(False)

    def _slider(
        self,
        field: str,
        label: str,
        unit: str,
        end: float,
        step: float,
        most: float,
        one: float,
        meaning: str,
    ) -> tuple[ui.slider, ui.number, float]:
        with row("slider-row"):
            ui.label(label).classes("slider-label")
            moved = slider(f"{label} [{unit}]", min=0.0, max=end, step=step, value=0.0)
            typed_in = number(
                value=0,
                low=0.0,
                high=most,
                meaning=meaning,
                step=step,
                suffix=unit,
                props=f"aria-label='{label}, number [{unit}]'",
                classes="value",
            )

        def follow() -> None:
            if not self._shows:
                self._touched = time.monotonic()
                typed_in.set_value(round(moved.value, 3))

        def typed() -> None:
            if typed_in.value is not None and typed_in.error is None and not self._shows:
                self._set(field, typed_in.value * one)

        def released(event: GenericEventArguments) -> None:
            self._set(field, float(event.args) * one)

        moved.on_value_change(follow)
        moved.on("change", released)  # when it is let go
        typed_in.on("blur", typed).on("keydown.enter", js_handler="(event) => event.target.blur()")
        typed_in.on("focus", self._touch).on("keydown", self._touch)
        return moved, typed_in, one

    # What people want

    def _touch(self) -> None:
        self._touched = time.monotonic()

    def _turn(self) -> None:
        """Other links are chosen: show theirs."""
        if not self._shows:
            self._touched = -math.inf
            for _, typed_in, _ in self._sliders.values():
                typed_in.error = None
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
        if hub is not None and self._length.error is None:
            now = (hub.history.newest[0] if hub.history.newest else 0.0) or 0.0
            now += hub.source.factor * _LEAD
            self._send(
                {name: darkened(self._settings(name), now, float(length)) for name in self._chosen}
            )

    def _send(self, wanted: dict[str, LinkSettings]) -> None:
        if self._hub is None:
            return
        if self._hub.status is not None and self._hub.status.over:
            ui.notify("The run is over: no link can be changed any more.", type="warning")
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
        """The settings of a link, or those that were asked for."""
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
        for field, (moved, typed_in, one) in self._sliders.items():
            value = round(getattr(settings, field) / one, 3)
            moved.set_value(min(value, moved.props["max"]))
            if typed_in.error is None:  # what is refused stays to be seen
                typed_in.set_value(value)
        self._note.set_visibility(differ)
