"""NiceGUI's widgets as the page wears them, a call each."""

import json
from collections.abc import Callable, Mapping
from typing import Any

from nicegui import ui

from bus.rows import DriverRow, LawRow

_Action = Callable[..., object]


def html(text: str, classes: str = "") -> ui.html:
    """HTML of our own."""
    return ui.html(text, sanitize=False).classes(classes)


def card(title: str, *, beside: str = "", classes: str = "", props: str = "") -> ui.element:
    """A card with its title, to be filled in a `with`.

    Args:
        title: Of the card.
        beside: HTML to the right of the title.
        classes: CSS classes.
        props: Quasar's properties.
    """
    frame = ui.element("div").classes(f"card {classes}").props(props)
    with frame:
        html(f'<span class="title">{title}</span>{beside}', "head" if beside else "")
    return frame


def row(classes: str = "") -> ui.element:
    """Widgets side by side, to be filled in a `with`."""
    return ui.element("div").classes(f"row-of {classes}")


def button(
    text: str,
    on_click: _Action | None = None,
    *,
    icon: str | None = None,
    props: str = "outline",
    classes: str = "grow",
) -> ui.button:
    """A button."""
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
    """A field for a number from `low` to `high`; another one is refused beside it, and its `error` is not None.

    Args:
        label: Of the field.
        low: The least value.
        high: The greatest.
        meaning: What the number is, for a tooltip.
        whole: True if it must be a whole number.
        needed: False if the field may be empty.
        props: Quasar's properties.
        classes: CSS classes.
        more: NiceGUI's arguments.
    """
    allowed = f"{'a whole number ' if whole else ''}from {low:,g} to {high:,.16g}"

    def refusal(value: float | None) -> str | None:
        if value is None:
            return f"nothing is entered; allowed: {allowed}" if needed else None
        fits = low <= value <= high and not (whole and value % 1.0)
        return None if fits else f"{value:,.16g} is refused; allowed: {allowed}"

    made = ui.number(label, validation=refusal, **more)
    tip = f'title="{meaning}: {allowed}"'
    return made.props(f"dense outlined hide-bottom-space no-error-icon {tip} {props}").classes(
        classes
    )


def ticks() -> ui.number:
    """A field for a number of ticks."""
    meaning = "Ticks that Step flies"
    return number(
        "ticks", value=1, low=1, high=1_000_000, meaning=meaning, whole=True, classes="narrow"
    )


def select(options: Any, label: str, *, props: str = "", **more: Any) -> ui.select:  # noqa: ANN401 - NiceGUI's
    """A field for a choice."""
    return ui.select(options, label=label, **more).props(f"dense outlined {props}").classes("grow")


_OPTION = """<q-item v-bind="props.itemProps"><q-item-section><q-item-label>{{{{ props.opt.label }}}}</q-item-label>
<q-item-label caption>{{{{ ({meanings})[props.opt.label] }}}}</q-item-label></q-item-section></q-item>"""
"""Vue's template of an option of a list."""


def select_row(
    rows: Mapping[str, LawRow] | Mapping[str, DriverRow],
    offered: list[str],
    label: str,
    *,
    props: str = "",
    **more: Any,  # noqa: ANN401 - NiceGUI's
) -> ui.select:
    """A field for the choice of a law or driver; its list tells what each does, and its tooltip what is chosen."""
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
    """A number beside a control, with its meaning as a tooltip."""
    return ui.label("").classes(f"readout {classes}").props(f'title="{meaning}"')


def slider(label: str, *, props: str = "", **more: Any) -> ui.slider:  # noqa: ANN401 - NiceGUI's
    """A slider that is called so."""
    return ui.slider(**more).props(f"aria-label='{label}' {props}").classes("grow")
