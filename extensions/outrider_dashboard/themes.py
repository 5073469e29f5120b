"""Colors of the page for its light and dark themes."""

from typing import Any

from outrider.view.terminal import palette as dark
from sim.scene import colors

_DARK_UAV = ("#5b9df5", "#8fd6ff", "#a58bff", "#b9c6ff")
_DARK_UGV = ("#f28c38", "#ffc27d", "#c9742a", "#ffe08a")
_DARK_COVERED = ("#171b21", "#1f3b2f", "#2f6d50")
_DARK_BUILDINGS = ("#5a626e", "#9aa3af")
_DARK_TILES = (
    (dark.FAINT, 0.22),
    ("#000000", 0.0),
    (dark.HAZARDS["rough"], 0.35),
    (dark.HAZARDS["block"], 0.4),
    (dark.HAZARDS["find"], 0.35),
    (dark.FAINT, 0.12),
)


def palettes() -> dict[str, dict[str, Any]]:
    """Return the colors of the canvas drawings, by theme."""
    return {
        "light": {
            "uav": colors.UAV,
            "ugv": colors.UGV,
            "guess": colors.ESTIMATE,
            "limit": colors.LIMIT,
            "good": colors.GOOD,
            "ink": colors.INK,
            "muted": colors.MUTED,
            "rule": colors.RULE,
            "edge": "#b9bec6",
            "paper": "#ffffff",
            "box": "#fffffff0",
            "halo": "#ffffffd0",
            "hazards": colors.HAZARDS,
            "buildings": colors.BUILDINGS,
            "faint": colors.FAINT,
            "tiles": colors.TILES,
            "covered": _shades(colors.COVERED),
        },
        "dark": {
            "uav": _DARK_UAV,
            "ugv": _DARK_UGV,
            "guess": dark.INK,
            "limit": dark.LIMIT,
            "good": dark.GOOD,
            "ink": dark.INK,
            "muted": dark.FAINT,
            "rule": "#2a303a",
            "edge": dark.EDGE,
            "paper": dark.BACKGROUND,
            "box": f"{dark.PANEL}f0",
            "halo": f"{dark.BACKGROUND}d0",
            "hazards": dark.HAZARDS,
            "buildings": _DARK_BUILDINGS,
            "faint": colors.FAINT,
            "tiles": _DARK_TILES,
            "covered": _shades(_DARK_COVERED),
        },
    }


def _shades(stops: tuple[str, ...]) -> list[str]:
    """Return the colors of a coverage map, one for each value of its cells, 0 to 255."""
    return [colors.covered(k / 255.0, stops) for k in range(256)]


def style() -> str:
    """Return the colors as CSS variables of the light and the dark theme."""
    light, dim = (_variables(palette) for palette in palettes().values())
    light |= {
        "uav-ink": "#ffffff",
        "page": "#f3f4f6",
        "card": "#ffffff",
        "field": "#d4d8de",
        "soft": "#e7effa",
        "soft-ink": colors.UAV[2],
        "alarm": "#fdeef0",
        "warn-ink": "#9a4a00",
        "covered": _gradient(colors.COVERED),
    }
    dim |= {
        "uav-ink": dark.BACKGROUND,
        "page": "#0d1014",
        "card": dark.PANEL,
        "field": dark.EDGE,
        "soft": "#22304a",
        "soft-ink": "#cfe0ff",
        "alarm": "#43212a",
        "warn-ink": "#ffb37a",
        "covered": _gradient(_DARK_COVERED),
    }
    return f"body{{{_css(light)}}}body.body--dark{{{_css(dim)}color-scheme:dark;}}"


def _variables(palette: dict[str, Any]) -> dict[str, str]:
    lowest, highest = palette["buildings"]
    single = {name: value for name, value in palette.items() if isinstance(value, str)}
    return {
        **single,
        "uav": palette["uav"][0],
        "ugv": palette["ugv"][0],
        "seen": palette["uav"][1],
        **palette["hazards"],
        "building": colors.mixed(lowest, highest, 0.5),
    }


def _css(variables: dict[str, str]) -> str:
    return "".join(f"--{name}:{value};" for name, value in variables.items())


def _gradient(stops: tuple[str, ...]) -> str:
    return f"linear-gradient(90deg,{', '.join(stops)})"
