"""NiceGUI widgets in the style of the page."""

import json
from collections.abc import Callable, Mapping
from typing import Any

from nicegui import ui

from bus.rows import DriverRow, LawRow

_Action = Callable[..., object]


def html(text: str, classes: str = "") -> ui.html:
    """Return an element with trusted HTML."""
    return ui.html(text, sanitize=False).classes(classes)


def card(title: str, *, beside: str = "", classes: str = "", props: str = "") -> ui.element:
    """Return a card with a title, to be filled in a `with` block.

    Args:
        title: Title of the card.
        beside: HTML to the right of the title.
        classes: CSS classes.
        props: Quasar's properties.
    """
    frame = ui.element("div").classes(f"card {classes}").props(props)
    with frame:
        html(f'<span class="title">{title}</span>{beside}', "head" if beside else "")
    return frame


def row(classes: str = "") -> ui.element:
    """Return a row of widgets, to be filled in a `with` block."""
    return ui.element("div").classes(f"row-of {classes}")


def button(
    text: str,
    on_click: _Action | None = None,
    *,
    icon: str | None = None,
    props: str = "outline",
    classes: str = "grow",
) -> ui.button:
    """Return a button."""
    made = ui.button(text, icon=icon, on_click=on_click)
    return made.props(f"dense {props}").classes(classes)


def number(
    label: str | None = None,
    *,
    low: float,
    high: float,
    meaning: str,
    whole: bool = False,
    needed: bool = True,
    props: str = "",
    classes: str = "",
    **more: Any,  # noqa: ANN401 - NiceGUI's
) -> ui.number:
    """Return an input field for a number; it shows an error message, and `error` is set, for an invalid value.

    Args:
        label: Label of the field.
        low: Smallest allowed value.
        high: Largest allowed value.
        meaning: Description of the value, for the tooltip.
        whole: True to allow whole numbers only.
        needed: False to allow an empty field.
        props: Quasar's properties.
        classes: CSS classes.
        more: Further arguments of NiceGUI's widget.
    """
    allowed = f"{'a whole number ' if whole else ''}from {low:,g} to {high:,.16g}"

    def problem(value: float | None) -> str | None:
        if value is None:
            return f"A value is required; allowed: {allowed}" if needed else None
        fits = low <= value <= high and not (whole and value % 1.0)
        return None if fits else f"{value:,.16g} is invalid; allowed: {allowed}"

    made = ui.number(label, validation=problem, **more)
    tip = f'title="{meaning}: {allowed}"'
    return made.props(f"dense outlined hide-bottom-space no-error-icon {tip} {props}").classes(
        classes
    )


def ticks() -> ui.number:
    """Return an input field for a number of ticks."""
    meaning = "Number of ticks to step"
    return number(
        "Ticks", value=1, low=1, high=1_000_000, meaning=meaning, whole=True, classes="narrow"
    )


def select(options: Any, label: str, *, props: str = "", **more: Any) -> ui.select:  # noqa: ANN401 - NiceGUI's
    """Return a selection field."""
    return ui.select(options, label=label, **more).props(f"dense outlined {props}").classes("grow")


_OPTION = """<q-item v-bind="props.itemProps"><q-item-section><q-item-label>{{{{ props.opt.label }}}}</q-item-label>
<q-item-label caption>{{{{ ({meanings})[props.opt.label] }}}}</q-item-label></q-item-section></q-item>"""
"""Vue template of an option in the list."""


def select_row(
    rows: Mapping[str, LawRow] | Mapping[str, DriverRow],
    offered: list[str],
    label: str,
    *,
    props: str = "",
    **more: Any,  # noqa: ANN401 - NiceGUI's
) -> ui.select:
    """Return a selection field for a law or driver; list and tooltip describe the choices."""
    meanings = {name: row.about for name, row in rows.items()}
    made = select(offered, label, props=f"popup-content-class=meanings {props}", **more)
    made.add_slot("option", _OPTION.format(meanings=json.dumps(meanings)))

    def explain() -> None:
        about = meanings.get(made.value or "", "")
        made.props["title"] = f"{label} {made.value}: {about}" if about else label

    made.on_value_change(explain)
    explain()
    return made


def readout(meaning: str, *, classes: str = "") -> ui.label:
    """Return a number beside a control, with a tooltip."""
    return ui.label("").classes(f"readout {classes}").props(f'title="{meaning}"')


def slider(label: str, *, props: str = "", **more: Any) -> ui.slider:  # noqa: ANN401 - NiceGUI's
    """Return a slider with an accessible label."""
    return ui.slider(**more).props(f"aria-label='{label}' {props}").classes("grow")
