"""Card of the radio links, with a form that changes them during the run."""

import math
import time

import msgspec
from nicegui import ui
from nicegui.events import GenericEventArguments

from bus.messages.control import Rejection
from bus.messages.links import LinkKind, LinkSettings
from bus.messages.telemetry import Status
from bus.profiles import PROFILES
from outrider_dashboard.controls.link_settings import (
    ALL,
    controls_for,
    describe,
    select_links,
    with_blackout,
    with_field,
)
from outrider_dashboard.controls.widgets import button, card, html, number, row, select, slider
from outrider_dashboard.hub import Hub

OBSERVER = "This page is read-only: changing links requires the operator's credentials."
"""Reason why the form is disabled for an observer."""
RECORDING = "Links cannot be changed in a recorded run."
"""Reason why the form is disabled for a recording."""
_PATIENCE = 2.0
"""Time for which the form shows a user's choice before it shows the simulator's settings again [s]."""
_LEAD = 0.1
"""Maximum wall time for a command to reach the simulator [s].

A blackout starts after it and therefore has its full length.
"""
_CUSTOM = "custom"
"""Shown instead of a profile if the settings match none."""

_SLIDERS = (
    ("delay", "Delay", "s", 3.0, 0.05, 30.0, 1.0, "Delay of each message [s]"),
    (
        "jitter",
        "Jitter",
        "s",
        1.0,
        0.01,
        10.0,
        1.0,
        "Random delay in addition to the constant one [s]",
    ),
    ("loss", "Loss", "%", 100.0, 1.0, 100.0, 0.01, "Share of messages lost [%]"),
    ("burst_length", "Burst length", "s", 3.0, 0.05, 1000.0, 1.0, "Length of a loss burst [s]"),
    (
        "burst_interval",
        "Burst interval",
        "s",
        30.0,
        0.5,
        1000.0,
        1.0,
        "Time between two bursts [s]",
    ),
)
"""Field, label, unit, end of the slider, its step, largest input, value of one unit in the field, tooltip."""


class LinkForm:
    """Card of the links, with its form, in one browser.

    Args:
        hub: Run to show and change; None: the form is disabled.
        reason: Reason why the form is disabled.
    """

    def __init__(self, hub: Hub | None, reason: str = "") -> None:
        self._hub = hub
        self._touched = -math.inf
        self._refreshing = False  # True: a changed widget is not a command of the user
        self._requested: dict[str, LinkSettings] = {}  # sent, but not yet in a status
        self._rejections: tuple[Rejection, ...] = ()
        self._off = "" if hub is not None else " disable"
        head = '<span class="muted">delivered · age</span>'
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
            self._kind = select(kinds, "Link", value=ALL, props=self._off)
            self._vehicle = select({ALL: "all"}, "Vehicle", value=ALL, props=self._off)
        with row():
            self._profile = select([*PROFILES, _CUSTOM], "Profile", value=None, props=self._off)
            button("Perfect", self._perfect, props="outline" + self._off, classes="")
        self._kind.on_value_change(self._change_selection)
        self._vehicle.on_value_change(self._change_selection)
        self._profile.on_value_change(self._set_profile)
        # In a disabled form the sliders would show values of no link.
        self._sliders = {of[0]: self._slider(*of) for of in _SLIDERS if not reason}
        with row():
            red = "unelevated color=negative" + self._off
            self._blackout_button = button("Blackout for 5 s", self._blackout, props=red)
            self._length = number(
                value=5,
                low=0.1,
                high=3600,
                meaning="Length of the blackout [s]",
                step=1,
                suffix="s",
                on_change=self._name_blackout,
                props="aria-label='Length of the blackout [s]'" + self._off,
                classes="value",
            )
        self._note = ui.label(
            "The selected links have different settings; a change applies to all of them."
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
            if not self._refreshing:
                self._touched = time.monotonic()
                typed_in.set_value(round(moved.value, 3))

        def typed() -> None:
            if typed_in.value is not None and typed_in.error is None and not self._refreshing:
                self._set(field, typed_in.value * one)

        def released(event: GenericEventArguments) -> None:
            self._set(field, float(event.args) * one)

        moved.on_value_change(follow)
        moved.on("change", released)  # on release
        typed_in.on("blur", typed).on("keydown.enter", js_handler="(event) => event.target.blur()")
        typed_in.on("focus", self._touch).on("keydown", self._touch)
        return moved, typed_in, one

    # Input

    def _touch(self) -> None:
        self._touched = time.monotonic()

    def _change_selection(self) -> None:
        """Show the settings of the newly selected links."""
        if not self._refreshing:
            self._touched = -math.inf
            for _, typed_in, _ in self._sliders.values():
                typed_in.error = None
            self.show()

    def _choose(self, event: GenericEventArguments) -> None:
        """Select the link of a clicked row."""
        owner, _, kind = str(event.args).partition("/")
        if kind in self._kind.options and str(event.args) in self._names:
            self._kind.set_value(kind)
            self._list_vehicles()
            self._vehicle.set_value(owner)

    def _set(self, field: str, value: float) -> None:
        names = self._selected
        if math.isfinite(value) and any(
            not math.isclose(getattr(self._settings(name), field), value) for name in names
        ):
            self._send(
                {name: with_field(self._settings(name), field, round(value, 6)) for name in names}
            )

    def _set_profile(self) -> None:
        name = self._profile.value
        if not self._refreshing and name in PROFILES:
            profile = PROFILES[name]
            planned = {link: self._settings(link).blackouts for link in self._selected}
            self._send(
                {
                    link: msgspec.structs.replace(profile, blackouts=rows)
                    for link, rows in planned.items()
                }
            )

    def _perfect(self) -> None:
        self._send(dict.fromkeys(self._selected, LinkSettings()))

    def _name_blackout(self) -> None:
        self._blackout_button.set_text(f"Blackout for {self._length.value or 0:g} s")

    def _blackout(self) -> None:
        hub, length = self._hub, self._length.value
        if hub is not None and self._length.error is None:
            now = (hub.history.newest[0] if hub.history.newest else 0.0) or 0.0
            now += hub.source.factor * _LEAD
            self._send(
                {
                    name: with_blackout(self._settings(name), now, float(length))
                    for name in self._selected
                }
            )

    def _send(self, wanted: dict[str, LinkSettings]) -> None:
        if self._hub is None:
            return
        if self._hub.status is not None and self._hub.status.over:
            ui.notify("The run is over: links can no longer be changed.", type="warning")
            return
        self._touch()
        for control in controls_for(wanted, self._names):
            if not self._hub.source.control(control):
                ui.notify("The command could not be sent. Try again.", type="negative")
                return
        self._requested |= wanted

    # Display

    @property
    def _names(self) -> list[str]:
        status = None if self._hub is None else self._hub.status
        return [] if status is None else list(status.links)

    @property
    def _selected(self) -> list[str]:
        return select_links(self._names, self._kind.value, self._vehicle.value)

    def _settings(self, name: str) -> LinkSettings:
        """Return the requested settings of a link, or else its current ones."""
        status = None if self._hub is None else self._hub.status
        if name in self._requested or status is None:
            return self._requested.get(name, LinkSettings())
        return status.links[name].settings or LinkSettings()

    def _list_vehicles(self) -> None:
        """List the vehicles that have a link of the selected kind."""
        owners = sorted(
            {name.split("/")[0] for name in select_links(self._names, self._kind.value, ALL)}
        )
        options = {ALL: "all", **{name: name for name in owners}}
        if self._vehicle.options != options:
            self._vehicle.set_options(
                options, value=self._vehicle.value if self._vehicle.value in options else ALL
            )

    def show(self) -> None:
        """Show the settings of the selected links, unless the user has just changed the form."""
        status = None if self._hub is None else self._hub.status
        if status is None or time.monotonic() - self._touched < _PATIENCE:
            self._drop_requests(status)
            return
        self._requested.clear()
        self._refreshing = True
        try:
            self._list_vehicles()
            names = self._selected
            if names:
                self._show(
                    self._settings(names[0]),
                    len({describe(self._settings(name)) for name in names}) > 1,
                )
        finally:
            self._refreshing = False

    def _drop_requests(self, status: Status | None) -> None:
        """Drop the requests that took effect, or all of them after a rejection."""
        if status is None:
            return
        if status.rejections != self._rejections:
            self._rejections, self._requested, self._touched = status.rejections, {}, -math.inf
        done = [
            name
            for name, settings in self._requested.items()
            if name in status.links and status.links[name].settings == settings
        ]
        for name in done:
            del self._requested[name]

    def _show(self, settings: LinkSettings, differ: bool) -> None:
        name = describe(settings)
        self._profile.set_value(name if name in PROFILES and not differ else _CUSTOM)
        for field, (moved, typed_in, one) in self._sliders.items():
            value = round(getattr(settings, field) / one, 3)
            moved.set_value(min(value, moved.props["max"]))
            if typed_in.error is None:  # keep an invalid input visible
                typed_in.set_value(value)
        self._note.set_visibility(differ)
