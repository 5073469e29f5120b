"""The page with ground, with a planned route, and with a UGV without a UAV."""

from pathlib import Path
from typing import Any

import msgspec
import pytest

from observed import recorded
from outrider.recording.reader import flight_of, grounds
from outrider_dashboard.hub import Hub
from outrider_dashboard.sources.recorded import RecordedRun
from sim.scenario.loading import load_scenario
from sim.scenario.types import Ground, Hazard, Scenario
from sim.scenario.vehicle_types import Ugv
from worlds import small

HAZARDS = (
    Hazard(kind="block", center=(10.0, 6.0), radius=0.5),
    Hazard(kind="find", center=(10.0, 8.0), radius=0.2),
)


def course(driver: str) -> Scenario:
    """Return a scenario with an obstacle on the straight route."""
    ugv = Ugv(position=(8.0, 6.0), driver=driver, goals=((12.0, 6.0),), max_speed=0.3)
    plain = small("tracking", duration=30.0, name="course")
    return msgspec.structs.replace(plain, ugv=(ugv,), hazard=HAZARDS, ground=Ground(touch="damage"))


def hub_at(path: Path, time: float = 0.0) -> Hub:
    """Return a hub that has received a recording up to this time [s]."""
    recorded_run = RecordedRun(flight_of(path), 1.0, lambda: 0.0)
    hub = Hub(recorded_run)
    hub.update()
    recorded_run.seek(time)
    hub.update()
    return hub


def frame_of(hub: Hub) -> Any:
    return msgspec.json.decode(hub.frame(hub.add_browser("127.0.0.1")))


@pytest.mark.parametrize("driver", ["waypoints", "navigate"])
def test_page_receives_ground_and_route_as_replay_advances(driver, tmp_path) -> None:
    recorded(tmp_path / "run.mcap", course(driver), 1)
    *_, last = grounds(tmp_path / "run.mcap", flight=0)
    hub = hub_at(tmp_path / "run.mcap")
    browser = hub.add_browser("127.0.0.1")
    frame = msgspec.json.decode(hub.frame(browser))
    assert len(frame["ground"]["hazards"]) == len(HAZARDS)
    assert "ground" not in msgspec.json.decode(hub.frame(browser))
    hub = hub_at(tmp_path / "run.mcap", 30.0)
    frame = msgspec.json.decode(hub.frame(hub.add_browser("127.0.0.1")))
    assert frame["ground"]["tick"] == last.tick
    routes = {name: [list(one) for one in route] for name, route in last.routes.items()}
    assert frame["ground"]["routes"] == routes
    assert bool(routes) == (driver == "navigate")
    assert frame["status"]["mission"]["hazards_hit"] == (driver == "waypoints")


def test_page_shows_a_ugv_without_a_uav(tmp_path: Path) -> None:
    alone = load_scenario("escort", overrides={"uav": [], "duration": 2.0})
    recorded(tmp_path / "run.mcap", alone, 1)
    frame = frame_of(hub_at(tmp_path / "run.mcap", 2.0))
    assert list(frame["truth"]["vehicles"]) == ["ugv_0"]
