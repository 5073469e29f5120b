"""The page's shell: places for header, tiles, map, charts and controls, which the files in `static` fill."""

from collections.abc import Callable

from nicegui import ui

from outrider_dashboard.controls.links_card import OBSERVER, LinkForm
from outrider_dashboard.controls.widgets import card, html
from sim.scene import colors as scene_colors
from sim.scene.model import LABELS

BuildControls = Callable[[], Callable[[], None]]
"""Puts the controls of one browser where it is called, and gives what lets them show how things stand."""
_PERIOD = 0.25
"""Wall time between two looks at what the controls should show [s]."""

_HEADER = """<div class="brand"><b>Outrider</b><span id="scenario"></span></div><div id="chips"></div>
<button type="button" id="theme"></button><div id="banner" role="alert" hidden></div>
<details id="promise" hidden><summary></summary><div></div></details>"""
_MAP = f"""<div class="map-place"><canvas id="map" role="img" aria-label="map of the run"></canvas>
<div class="map-tools" role="group" aria-label="what the map shows">
<button type="button" id="map-closer" title="closer (or turn the mouse wheel, or spread two fingers)">+</button>
<button type="button" id="map-wider" title="wider">&minus;</button>
<button type="button" id="map-all" title="the whole ground">all</button>
<button type="button" id="map-follow" aria-pressed="false" title="keep the vehicle in the middle">follow</button>
<button type="button" id="map-legend" aria-pressed="false" title="what the lines mean">?</button>
<select id="map-vehicle" aria-label="vehicle of close-up and follow" hidden
title="vehicle that close-up and follow show; or point at one on the map"></select></div></div>
<div class="legend"><div id="legend-vehicles"></div>
<span><i class="line limit"></i><em>{LABELS["r_v"]} r<sub>v</sub></em></span>
<span class="legend-rs"><i class="line limit dashed"></i><em>{LABELS["r_s"]} r<sub>s</sub></em></span>
<span><i class="line uav thin"></i>{LABELS["r"]} r</span>
<span><i class="line sight thin"></i>UAV to its UGV</span>
<span><i class="dot start"></i>start</span><span id="legend-goal"><i class="cross">×</i>goal</span>
<span><i class="line guess"></i>estimate, 2σ</span><span><i class="dot detection"></i>detections</span>
<span class="ground"><i class="line ugv dashed thin"></i>planned route</span>
<span class="ground"><i class="area block"></i>blocked, faint: unknown</span>
<span class="ground"><i class="area hit"></i>hit</span><span class="ground"><i class="area rough"></i>rough</span>
<span class="ground"><i class="star">★</i>found, hollow: not yet</span>
<span class="ground"><i class="area veil"></i>unknown to the UGV</span>
<span class="bar" title="Coverage of the ground, as a share of the coverage that is wanted">0<i id="coverage-bar"></i>1
coverage C/C*</span></div>"""
_CHARTS = f"""<div class="charts-head"><span class="title">Over time</span>
<div class="spans" role="group" aria-label="span of time">
<button type="button" data-span="0" class="on">whole run</button><button type="button" data-span="60">last 60 s</button>
</div></div><div class="legend"><div id="chart-legend"></div>
<span><i class="line limit"></i><em>{LABELS["r_v"]} r<sub>v</sub></em></span>
<span class="legend-rs"><i class="line limit dashed"></i><em>{LABELS["r_s"]} r<sub>s</sub></em></span>
<span><i class="area dark"></i>blackout</span><span><i class="strip"></i>detections lost</span></div>""" + "".join(
    f'<canvas class="chart" id="chart-{name}" role="img" aria-label="{label}" title="{label}"></canvas>'
    for name, label in (
        ("distance", "distance of each UAV from its UGV over time"),
        ("error", "coverage error over time"),
        ("estimate", "error of the estimate over time"),
        ("age", "age of the newest detection over time, and the share of detections lost"),
        ("factor", "simulated seconds per second of wall time, over time"),
    )
)


_HEAD = """<link rel="stylesheet" href="/static/colors.css"><link rel="stylesheet" href="/static/dashboard.css">
<script type="module" src="/static/main.js"></script>"""


def build_page(controls: BuildControls | None) -> None:
    """Make the page known to NiceGUI; each browser gets one of its own.

    Args:
        controls: Builds what can be touched, and the card of the links among it; None: nothing can be.
    """

    @ui.page("/", title="Outrider")
    def show() -> None:
        ui.add_head_html(_HEAD)
        ui.colors(
            primary=scene_colors.UAV[0],
            accent=scene_colors.UGV[0],
            negative=scene_colors.LIMIT,
            positive=scene_colors.GOOD,
        )
        with ui.element("div").classes("dashboard"):
            html(_HEADER, "top")
            html("", "tiles")
            html("", "tiles mission")
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
