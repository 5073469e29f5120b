"""The page's shell: places for header, tiles, map, charts and controls, which the files in `static` fill."""

from collections.abc import Callable
from typing import Any

from nicegui import ui

from outrider.view.page.controls.links_card import OBSERVER, LinkForm
from outrider.view.page.controls.widgets import card, html
from sim.scene import colors as scene_colors
from sim.scene.colors import covered
from sim.scene.model import LABELS

BuildControls = Callable[[], Callable[[], None]]
"""Puts the controls of one browser where it is called, and gives what lets them show how things stand."""
_PERIOD = 0.25
"""Wall time between two looks at what the controls should show [s]."""

_HEADER = """<div class="brand"><b>Outrider</b><span id="scenario"></span></div><div id="chips"></div>
<div id="banner" role="alert" hidden></div>
<details id="promise" hidden><summary></summary><div></div></details>"""
_TILES = "".join(
    f'<div class="tile" id="tile-{name}"><label>{label}</label><output>&ndash;</output><small>{unit}</small></div>'
    for name, label, unit in (
        ("time", "time", "s"),
        ("distance", "distance ‖p<sub>Δ</sub>‖", "m"),
        ("margin", "margin to r<sub>v</sub>", "m"),
        ("error", "coverage error e(t)", "m²"),
        ("estimate", "estimate error", "m"),
        ("factor", "real-time factor", "×"),
    )
)
_MISSION = "".join(
    f'<div class="tile" id="tile-{name}"><label>{label}</label><output>&ndash;</output><small></small></div>'
    for name, label in (
        ("arrived", "at the goals"),
        ("hit", "hazards hit"),
        ("way", "hazards on the way"),
        ("ahead", "way seen ahead"),
        ("still", "stood still"),
        ("found", "found"),
    )
)
"""Only where there are hazards."""
_MAP = f"""<div class="map-place"><canvas id="map" role="img" aria-label="map of the run"></canvas>
<div class="map-tools" role="group" aria-label="what the map shows">
<button type="button" id="map-closer" title="closer (or turn the mouse wheel, or spread two fingers)">+</button>
<button type="button" id="map-wider" title="wider">&minus;</button>
<button type="button" id="map-all" title="the whole ground">all</button>
<button type="button" id="map-follow" aria-pressed="false" title="keep the UGV in the middle">follow</button>
<button type="button" id="map-legend" aria-pressed="false" title="what the lines mean">?</button></div></div>
<div class="legend"><span><i class="dot uav"></i>UAV</span><span><i class="square ugv"></i>UGV</span>
<span><i class="line limit"></i><em>{LABELS["r_v"]} r<sub>v</sub></em></span>
<span id="legend-rs"><i class="line limit dashed"></i><em>{LABELS["r_s"]} r<sub>s</sub></em></span>
<span><i class="line uav thin"></i>{LABELS["r"]} r</span>
<span><i class="line guess"></i>estimate, 2σ</span><span><i class="dot detection"></i>detections</span>
<span class="ground"><i class="line ugv dashed thin"></i>planned route</span>
<span class="ground"><i class="area block"></i>blocked, faint: unknown</span>
<span class="ground"><i class="area hit"></i>hit</span><span class="ground"><i class="area rough"></i>rough</span>
<span class="ground"><i class="star">★</i>found, hollow: not yet</span>
<span class="ground"><i class="area veil"></i>unknown to the UGV</span>
<span class="bar">0<i id="coverage-bar"></i>1 coverage C/C*</span></div>"""
_CHARTS = """<div class="charts-head"><span class="title">Over time</span>
<div class="spans" role="group" aria-label="span of time">
<button type="button" data-span="0" class="on">whole run</button><button type="button" data-span="60">last 60 s</button>
</div></div>""" + "".join(
    f'<canvas class="chart" id="chart-{name}" role="img" aria-label="{label}"></canvas>'
    for name, label in (
        ("distance", "distance over time"),
        ("error", "coverage error over time"),
        ("estimate", "error of the estimate over time"),
        ("age", "age of the newest detection over time, and the share of detections lost"),
        ("factor", "real-time factor over time"),
    )
)


def colors() -> dict[str, Any]:
    """The colours of every picture of ours, for those drawn in the browser."""
    return {
        "uav": scene_colors.UAV,
        "ugv": scene_colors.UGV,
        "limit": scene_colors.LIMIT,
        "good": scene_colors.GOOD,
        "ink": scene_colors.INK,
        "muted": scene_colors.MUTED,
        "rule": scene_colors.RULE,
        "hazards": scene_colors.HAZARDS,
        "faint": scene_colors.FAINT,
        "tiles": scene_colors.TILES,
        "covered": [covered(k / 255.0) for k in range(256)],
    }


def _head() -> str:
    c = scene_colors
    named = {"uav": c.UAV[0], "ugv": c.UGV[0], "limit": c.LIMIT, "good": c.GOOD, "ink": c.INK}
    named |= {"muted": c.MUTED, "rule": c.RULE, "guess": c.ESTIMATE, "seen": c.UAV[1]}
    named |= c.HAZARDS
    stops = ", ".join(c.COVERED)
    variables = (
        "".join(f"--{name}:{value};" for name, value in named.items())
        + f"--covered:linear-gradient(90deg,{stops});"
    )
    return (
        f"<style>:root{{{variables}}}</style><link rel='stylesheet' href='/static/dashboard.css'>"
        "<script type='module' src='/static/main.js'></script>"
    )


def build_page(controls: BuildControls | None, welcome: Callable[[], None]) -> None:
    """Make the page known to NiceGUI; each browser gets one of its own.

    Args:
        controls: Builds what can be touched, and the card of the links among it; None: nothing can be.
        welcome: Called at the beginning of each.
    """

    @ui.page("/", title="Outrider")
    def show() -> None:
        welcome()
        ui.add_head_html(_head())
        ui.colors(
            primary=scene_colors.UAV[0],
            accent=scene_colors.UGV[0],
            negative=scene_colors.LIMIT,
            positive=scene_colors.GOOD,
        )
        with ui.element("div").classes("dashboard"):
            html(_HEADER, "top")
            html(_TILES, "tiles")
            html(_MISSION, "tiles mission")
            html(_MAP, "card map-card")
            html(_CHARTS, "card charts")
            with ui.element("div").classes("side"):
                if controls is not None:
                    ui.timer(_PERIOD, controls())
                else:
                    LinkForm(None, OBSERVER)
                with card("Processes"):
                    html('<div id="processes"></div>')
                with card("What has been changed"):
                    html('<div id="changes">nothing yet</div>')
