"""View of the page in three dimensions, and the numbers of runs with altitudes."""

import math
from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip("nicegui", reason="the extra [dashboard] is not installed")

from nicegui import Client, ui
from nicegui.elements.scene.objects.cylinder import Cylinder
from nicegui.elements.scene.objects.extrusion import Extrusion
from nicegui.elements.scene.objects.sphere import Sphere
from nicegui.page import page

from bus.messages.base import Message
from bus.messages.buildings import Building
from bus.messages.telemetry import Status, Truth
from outrider_dashboard.hub import Hub
from outrider_dashboard.space_view import SpaceView
from sim.scenario.loading import load_scenario
from sim.scene.colors import GOOD, LIMIT, UAV
from sim.scene.known import geometry_of
from statuses import a_status, a_truth, a_vehicle

HOUSES = tuple(
    Building(polygon=((x, 5.0), (x + 3.0, 5.0), (x + 3.0, 9.0)), height=4.0) for x in (10.0, 20.0)
)


class Given:
    """A source with these messages."""

    may_steer, factor = False, 1.0

    def __init__(self) -> None:
        self.messages: list[Message] = []

    def news(self) -> Iterator[Message]:
        while self.messages:
            yield self.messages.pop(0)

    control = drive = close = lambda self, *_: True


def status(scenario: str = "town") -> Status:
    geometry = geometry_of(load_scenario(scenario), HOUSES if scenario == "town" else ())
    return a_status(scenario=scenario, geometry=geometry)


def truth(time: float, altitude: float | None, sight_radius: float | None) -> Truth:
    uav = a_vehicle((3.0, 4.0), altitude=altitude)
    return a_truth(time, uav, a_vehicle((6.0, 8.0)), distance=5.0, sight_radius=sight_radius)


@pytest.fixture(name="shown")
def a_page() -> Iterator[Any]:
    source = Given()
    hub = Hub(source)  # type: ignore[arg-type]
    client = Client(page(""))
    with client:
        view = SpaceView(hub)

    def show(*messages: Message) -> ui.scene | None:
        source.messages += messages
        hub.update()
        view.show()
        return next((one for one in client.elements.values() if isinstance(one, ui.scene)), None)

    yield hub, show
    client.delete()


def test_a_run_with_altitudes_is_shown_in_three_dimensions(shown: Any) -> None:
    town = load_scenario("town")
    hub, show = shown
    scene = show(status(), truth(1.0, 9.0, 5.5))
    kinds = [type(one) for one in scene.objects.values()]
    assert kinds.count(Extrusion) == 2 * len(HOUSES)  # bodies and edges
    (uav,) = (one for one in scene.objects.values() if isinstance(one, Sphere))
    assert (uav.x, uav.y, uav.z, uav.color) == (3.0, 4.0, 9.0, UAV[0])
    lines = [
        one for one in scene.objects.values() if isinstance(one, Cylinder) and one.color == GOOD
    ]
    (line,) = lines
    height = 9.0 - town.ugv[0].marker_height
    assert line.sy == pytest.approx(math.hypot(3.0, 4.0, height))
    along = [row[1] * line.sy for row in line.R]
    assert along == pytest.approx([3.0, 4.0, -height])
    cone = next(
        one for one in scene.objects.values() if isinstance(one, Cylinder) and one.opacity < 0.5
    )
    assert (cone.sx, cone.sy, cone.z) == pytest.approx((town.sensor.range, 9.0, 4.5))
    assert show(truth(2.0, 3.0, 0.0)) is scene
    assert (uav.z, line.color) == (3.0, LIMIT)
    assert cone.sx == pytest.approx(3.0 * math.tan(town.camera.half_angle))
    assert [row[-2] for row in hub.history.rows] == [5.5, None]  # hidden


def test_a_run_in_the_plane_has_no_view_in_three_dimensions(shown: Any) -> None:
    _, show = shown
    assert show(status("escort"), truth(1.0, None, None)) is None
    assert show(status(), truth(2.0, 9.0, 5.5)) is not None
    assert show(status("escort"), truth(3.0, None, None)) is None
