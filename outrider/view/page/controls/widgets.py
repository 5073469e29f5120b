"""NiceGUI's widgets as the page wears them, a call each."""

from collections.abc import Callable
from typing import Any

from nicegui import ui

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
    props: str = "",
    classes: str = "",
    **more: Any,  # noqa: ANN401 - NiceGUI's
) -> ui.number:
    """A field for a number."""
    return ui.number(label, **more).props(f"dense outlined {props}").classes(classes)


def ticks() -> ui.number:
    """A field for a number of ticks."""
    return number("ticks", value=1, min=1, max=1_000_000, precision=0, classes="narrow")


def select(options: Any, label: str, *, props: str = "", **more: Any) -> ui.select:  # noqa: ANN401 - NiceGUI's
    """A field for a choice."""
    return ui.select(options, label=label, **more).props(f"dense outlined {props}").classes("grow")


def slider(label: str, *, props: str = "", **more: Any) -> ui.slider:  # noqa: ANN401 - NiceGUI's
    """A slider that is called so."""
    return ui.slider(**more).props(f"aria-label='{label}' {props}").classes("grow")
