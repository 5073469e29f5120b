"""Layout of the page: header, tiles, map, charts and controls, filled in by the files in `static`."""

from collections.abc import Callable

from nicegui import ui
from starlette.requests import Request

from outrider_dashboard.budget_page import ADDRESS, build_budget_page
from outrider_dashboard.controls.links_card import OBSERVER, LinkForm
from outrider_dashboard.controls.widgets import card, html
from outrider_dashboard.hub import Hub
from outrider_dashboard.page_guard import PREFIX_HEADER
from outrider_dashboard.space_view import PERIOD as SPACE_PERIOD
from outrider_dashboard.space_view import SpaceView
from sim.scene import colors as scene_colors
from sim.scene.model import LABELS

BuildControls = Callable[[], Callable[[], None]]
"""Function that builds the controls of one browser and returns the function that refreshes them."""
_PERIOD = 0.25
"""Wall time between two refreshes of the controls [s]."""

_HEADER = f"""<div class="brand"><b>Outrider</b><span id="scenario"></span></div><div id="chips"></div>
<div class="tools"><a href="{ADDRESS}" title="How much loss, delay and silence the run can afford">Network budget</a>
<button type="button" id="theme"></button></div><div id="banner" role="alert" hidden></div>
<details id="promise" hidden><summary></summary><div></div></details>"""
_MAP = f"""<div class="map-place"><canvas id="map" role="img" aria-label="Map of the run"></canvas>
<div class="map-tools" role="group" aria-label="View of the map">
<button type="button" id="map-closer" title="Zoom in (mouse wheel, or spread two fingers)">+</button>
<button type="button" id="map-wider" title="Zoom out">&minus;</button>
<button type="button" id="map-all" title="Show the whole area">All</button>
<button type="button" id="map-follow" aria-pressed="false" title="Keep the vehicle in the center">Follow</button>
<button type="button" id="map-legend" aria-pressed="false" title="Legend">?</button>
<select id="map-vehicle" aria-label="Vehicle to show and follow" hidden
title="Vehicle to follow and show in the close-up; you can also click it on the map"></select></div></div>
<div class="legend"><div id="legend-vehicles"></div>
<span><i class="line limit"></i><em>{LABELS["r_v"]} r<sub>v</sub></em></span>
<span class="legend-rs"><i class="line limit dashed"></i><em>{LABELS["r_s"]} r<sub>s</sub></em></span>
<span><i class="line uav thin"></i>{LABELS["r"]} r</span>
<span><i class="line sight thin"></i>UAV to its UGV</span>
<span class="team"><i class="line uav guard"></i>guard</span>
<span class="team"><i class="line uav scout"></i>scout</span>
<span class="team"><i class="line uav dashed"></i>relief</span>
<span class="team endurance"><i class="line uav away"></i>away</span>
<span class="team"><i class="line cell thin"></i>cell of a UAV</span>
<span class="building-key" hidden><i class="area building"></i>building, height [m] (faint: unknown)</span>
<span><i class="dot start"></i>start</span><span id="legend-goal"><i class="cross">×</i>goal</span>
<span><i class="line guess"></i>estimate, 2σ</span><span><i class="dot detection"></i>detections</span>
<span class="ground"><i class="line ugv dashed thin"></i>planned route</span>
<span class="ground"><i class="area block"></i>blocked (faint: unknown)</span>
<span class="ground"><i class="area hit"></i>hit</span><span class="ground"><i class="area rough"></i>rough</span>
<span class="ground"><i class="star">★</i>find (hollow: not found yet)</span>
<span class="ground"><i class="area veil"></i>unknown to the UGV</span>
<span class="bar" title="Coverage as a share of the desired coverage C*">0<i id="coverage-bar"></i>1
coverage C/C*</span></div>"""
_CHARTS = f"""<div class="charts-head"><span class="title">Over time</span>
<div class="spans" role="group" aria-label="Time span">
<button type="button" data-span="0" class="on">Whole run</button><button type="button" data-span="60">Last 60 s</button>
</div></div><div class="legend"><div id="chart-legend"></div>
<span><i class="line limit"></i><em>{LABELS["r_v"]} r<sub>v</sub></em></span>
<span class="legend-rs"><i class="line limit dashed"></i><em>{LABELS["r_s"]} r<sub>s</sub></em></span>
<span><i class="area dark"></i>blackout</span><span><i class="strip"></i>detections lost</span></div>""" + "".join(
    f'<canvas class="chart" id="chart-{name}" role="img" aria-label="{label}" title="{label}"></canvas>'
    for name, label in (
        ("distance", "Distance between each UAV and its UGV over time"),
        ("error", "Coverage error over time"),
        ("estimate", "Estimation error over time"),
        ("age", "Age of the newest detection and share of lost detections over time"),
        ("factor", "Simulated seconds per second of wall time, over time"),
    )
)


def _head(prefix: str) -> str:
    """Return the links to our files; `prefix` is the path under which a proxy serves the page."""
    return f"""<link rel="stylesheet" href="{prefix}/static/colors.css">
<link rel="stylesheet" href="{prefix}/static/dashboard.css">
<script type="module" src="{prefix}/static/main.js"></script>"""


def build_page(hub: Hub, controls: BuildControls | None) -> None:
    """Register the page with NiceGUI; each browser gets its own instance.

    Args:
        hub: State of the run.
        controls: Builds the controls, including the card of the links; None: a page without controls.
    """
    build_budget_page(hub.budget)

    @ui.page("/", title="Outrider")
    def show(request: Request) -> None:
        ui.add_head_html(_head(request.headers.get(PREFIX_HEADER, "")))  # checked by the guard
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
            html("", "tiles team")
            html(_MAP, "card map-card")
            ui.timer(SPACE_PERIOD, SpaceView(hub).show)
            html(_CHARTS, "card charts")
            with ui.element("div").classes("side"):
                if controls is not None:
                    ui.timer(_PERIOD, controls())
                else:
                    LinkForm(None, OBSERVER)
                with card("Processes"):
                    html('<div id="processes"></div>')
                with card("Changes"):
                    html('<div id="changes">None yet</div>')
