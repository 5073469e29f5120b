"""Mission results and views: the observers' map of ground with hazards, and every picture of it."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from rich.color import Color
from rich.segment import Segment

from worlds import small

pytest.importorskip("foxglove", reason="the extra [record] is not installed")

from bus.keys import GROUND, Role
from bus.messages.ground import GroundMap, Hazard
from observed import recorded
from outrider.cli.summary_table import print_summary
from outrider.envs.env_pilots import pilots
from outrider.envs.parallel import parallel_env
from outrider.experiments.report.document import COLUMNS, columns_of, mission_cells
from outrider.experiments.report.results import Cell, Panel
from outrider.experiments.sweep.columns import RESULTS, row_of
from outrider.recording.reader import entries, flight_of, grounds, statuses
from outrider.recording.refly import refly
from outrider.recording.schemas import GROUND as TOPIC
from outrider.running.flying import InProcess, make_pilots
from outrider.running.summary import Summary, summarize
from outrider.view.film import Film, render
from outrider.view.flight_picture import draw_flight
from outrider.view.terminal.palette import UGV
from outrider.view.terminal.teleoperation import DriveView
from outrider.view.terminal.topview import Trails, draw
from sim.scenario.types import Ground, Scenario
from sim.scenario.vehicle_types import Ugv
from sim.scene.colors import HAZARDS, LIMIT
from sim.scene.drawing import Map
from sim.scene.ground_map import HIT, KNOWN, UNKNOWN, ground_map
from sim.scene.known import geometry_of, scene_of
from sim.server.flight import Flight

ORANGE = Color.parse(UGV[0])
MUD = ((11.0, 7.0), (13.0, 7.0), (13.0, 9.0), (11.0, 9.0))
NEAR_PATH = Hazard(kind="block", center=(10.0, 6.0), radius=0.5)
FAR = Hazard(kind="block", center=(2.0, 2.0), radius=0.4)
HAZARDOUS = (
    NEAR_PATH,
    FAR,
    Hazard(kind="rough", polygon=MUD),
    Hazard(kind="find", center=(10.0, 8.0), radius=0.2),
)


def course(driver: str = "waypoints", **ground: Any) -> Scenario:
    plain = small("tracking", duration=40.0, name="course")
    ugv = Ugv(position=(8.0, 6.0), driver=driver, goals=((12.0, 6.0),), max_speed=0.3)
    return msgspec.structs.replace(
        plain, ugv=(ugv,), hazard=HAZARDOUS, ground=Ground(touch="damage", **ground)
    )


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Flight, Summary]:
    path = tmp_path_factory.mktemp("ground") / "run.mcap"
    flight = recorded(path, course(), 1, secret="5" * 32)
    return path, flight, summarize(flight, seconds=1.0)


def test_only_observers_receive_the_ground_with_hazards() -> None:
    assert set(GROUND.readers) == {Role.OBSERVER, Role.OPERATOR}


class Routed(InProcess):
    """Pilots whose observations are recorded as text, with the UGV's routes, which may be forged."""

    def __init__(self, scenario: Scenario, forged: tuple[Any, ...] | None = None) -> None:
        super().__init__(make_pilots(scenario, 1))
        self.observed_bytes: list[bytes] = []
        self.routes: list[Any] = []
        self._forged = forged

    def publish(self, observations: Any) -> None:
        self.observed_bytes.append(msgspec.json.encode(dict(observations)))
        super().publish(observations)

    def collect(self, tick: int) -> Any:
        commands = super().collect(tick)
        self.routes.append(commands["ugv_0"].route)
        if self._forged is not None:
            commands["ugv_0"] = msgspec.structs.replace(commands["ugv_0"], route=self._forged)
        return commands


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Flight, Routed]:
    path = tmp_path_factory.mktemp("route") / "run.mcap"
    scenario = msgspec.structs.replace(course("navigate"), duration=6.0)
    routed = Routed(scenario)
    return path, recorded(path, scenario, 1, exchange=routed), routed


def test_no_vehicle_receives_the_planned_route_of_a_ugv(planned) -> None:
    _, flight, routed = planned
    forged = Routed(flight.scenario, forged=((1.25, 1.25), (3.25, 9.75)))
    flight = Flight(flight.scenario, 1)
    flight.fly(forged)
    assert flight.routes == {"ugv_0": ((1.25, 1.25), (3.25, 9.75))}
    assert forged.observed_bytes == routed.observed_bytes
    assert b"route" not in b"".join(routed.observed_bytes)


def test_ugv_reports_a_changed_route_to_observers(planned) -> None:
    _, flight, routed = planned
    changes = [(tick, one) for tick, one in enumerate(routed.routes) if one is not None]
    assert 2 <= len(changes) < 0.5 * len(routed.routes)
    for (_, before), (_, now) in pairwise(changes):
        assert now[1:] != before[len(before) - len(now) + 1 :]
    for _, route in changes:
        assert route[-1] == (12.0, 6.0)
        steps = np.abs(np.diff(np.array(route[1:-1]).reshape(-1, 2), axis=0))
        assert ((steps[:, 0] == steps[:, 1]) | (steps == 0.0).any(axis=1)).all()
    last = ground_map(flight.world, routes=flight.routes)
    route, x = last.routes["ugv_0"], float(flight.world.position[1, 0])
    assert route[0] == tuple(flight.world.position[1].tolist())
    assert all(corner[0] > x for corner in route[1:])  # without the part that was driven
    assert route[1:] == flight.routes["ugv_0"][-len(route) + 1 :]
    old = {"ugv_0": ((7.0, 6.0), (7.5, 6.5), (7.8, 6.0), (12.0, 6.0))}
    behind = ground_map(flight.world, routes=old)
    assert behind.routes["ugv_0"] == (route[0], (12.0, 6.0))


def terminal_map(path: Path, flight: Flight, ground: GroundMap | None) -> list[Segment]:
    """Return the pieces of a terminal's map at the end of a recorded flight."""
    *_, status = statuses(path, flight=0)
    status = msgspec.structs.replace(status, geometry=geometry_of(flight.scenario))
    view = DriveView(status=status, truth=flight.truth(), ground=ground)
    canvas = draw(view, "ugv_0", Trails(), width=90, height=40, wide=True)
    return [one for row in range(40) for one in canvas.row(row)]


def test_every_view_draws_the_route(planned, tmp_path: Path) -> None:
    path, flight, _ = planned
    ground = ground_map(flight.world, routes=flight.routes)
    *_, recorded = grounds(path, flight=0)
    assert recorded == ground
    drawn = Map(Figure().add_subplot(), scene_of(flight.scenario), hazards=ground)
    (line,) = [one for one in drawn.artists if getattr(one, "is_dashed", lambda: False)()]
    assert line.get_xydata().tolist() == [list(corner) for corner in ground.routes["ugv_0"]]
    with_route, without = (
        sum(len(one.text) for one in terminal_map(path, flight, shown) if one.style.color == ORANGE)
        for shown in (ground, msgspec.structs.replace(ground, routes={}))
    )
    assert with_route > without + 5


def test_the_environment_draws_the_route_that_its_pilots_plan() -> None:
    env, bare = (parallel_env(course("navigate"), render_mode="rgb_array") for _ in range(2))
    observations, _ = env.reset(seed=1)
    bare.reset(seed=1)
    policies = pilots(env)
    for _ in range(60):
        actions = {name: policies[name](seen) for name, seen in observations.items()}
        observations = env.step(actions)[0]
        unrouted = msgspec.structs.replace(actions["ugv_0"], route=None)
        bare.step(actions | {"ugv_0": unrouted})
    assert (env.render() != bare.render()).any()
    assert (env.world.position == bare.world.position).all()


def test_each_hazard_is_unknown_then_known_then_hit(flown) -> None:
    path, flight, _ = flown
    first, *_, last = grounds(path, flight=0)
    assert set(first.states) == {UNKNOWN}
    assert list(last.states) == [HIT, UNKNOWN, KNOWN, KNOWN]
    assert last == ground_map(flight.world)


def test_summary_states_the_mission_in_plain_words(flown, capsys) -> None:
    _, flight, summary = flown
    mission = flight.world.mission
    assert summary.mission == mission
    assert mission.arrived
    print_summary(summary, [])
    table = capsys.readouterr().out
    for words in (f"{mission.mission_time:.1f} s", "hazards hit", "objects found"):
        assert words in table


def test_mission_is_not_reported_without_hazards(tmp_path: Path, capsys: Any) -> None:
    flight = recorded(tmp_path / "run.mcap", small("tracking", duration=1.0), 1)
    summary = summarize(flight, seconds=1.0)
    assert summary.mission is None
    assert ground_map(flight.world) is None
    assert not [one for one in entries(tmp_path / "run.mcap") if one.topic == TOPIC.name]
    print_summary(summary, [])
    assert "hazard" not in capsys.readouterr().out


def test_recording_stores_hazards_once_and_draws_the_same(flown, tmp_path) -> None:
    path, flight, _ = flown
    maps = [msgspec.json.decode(e.data, type=GroundMap) for e in entries(path, (TOPIC.name,))]
    assert len(maps[0].hazards) == len(HAZARDOUS)
    assert len(maps) > 30
    assert not any(one.hazards for one in maps[1:])
    draw_flight(flight, tmp_path / "flight.png")
    render(flight_of(path), tmp_path / "again.png")
    assert (tmp_path / "flight.png").read_bytes() == (tmp_path / "again.png").read_bytes()
    again = refly(flight_of(path))
    assert again.difference is None
    assert again.trajectory_sha256 == flight.recorder.sha256()


def test_film_shows_unknown_known_and_hit_hazards(flown) -> None:
    path, *_ = flown

    def count(frame: Any, color: str) -> int:
        ground = frame[100:640, :, :3].astype(int)  # without title and legend
        return int((np.abs(ground - np.array(to_rgb(color)) * 255.0) < 3.0).all(axis=2).sum())

    first, last = Film(flight_of(path)).frames([0.0, 40.0])
    assert count(last, HAZARDS["block"]) > count(first, HAZARDS["block"])
    assert count(last, LIMIT) > count(first, LIMIT) + 200


def test_terminal_marks_hit_and_found_hazards(flown) -> None:
    path, flight, _ = flown
    canvas = terminal_map(path, flight, ground_map(flight.world))
    text = "".join(one.text for one in canvas)
    assert (text.count("✗"), text.count("★"), text.count("☆")) == (1, 1, 0)


def test_sweep_and_report_keep_the_mission(flown) -> None:
    row = row_of(flown[2], 1.0)
    assert {"arrived", "mission_time", "hazards_hit", "reported_share"} <= set(RESULTS)
    assert (row["arrived"], row["hazards_hit"]) == (True, 1)
    cell = Cell([row | {"error": None}, row | {"error": None, "hazards_hit": 2, "arrived": False}])
    time = f"{row['mission_time']:.1f}"
    assert mission_cells(cell)[:3] == ["1 (50 %)", time, "1.5"]
    panel = Panel(
        title="", field="", values=[None], laws=["tracking"], cells={("tracking", None): cell}
    )
    assert columns_of(panel)[len(COLUMNS)] == "at the goals"
    panel.cells["tracking", None] = Cell([row | {"error": None, "hazards_hit": None}])
    assert columns_of(panel) == COLUMNS
