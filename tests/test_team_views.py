"""Views of a team: terminal, pictures, films and recordings."""

import json
import math
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from matplotlib.path import Path as MplPath

from bus.messages.team import Request, Role
from bus.messages.telemetry import TeamStatus, Truth
from outrider.recording.reader import entries, flight_of
from outrider.recording.refly import restore
from outrider.recording.writer import FlightRecorder
from outrider.running.flying import InProcess, fly, make_pilots
from outrider.view import flight_picture
from outrider.view.film import Film
from outrider.view.operator import request_of
from outrider.view.terminal.panel import ErrorCurve, farthest, numbers
from outrider.view.terminal.teleoperation import DriveView
from sim.compiling.records import code
from sim.scenario.loading import load_scenario
from sim.scene.altitude import decisive
from sim.scene.drawing import legend_of
from sim.scene.known import geometry_of, scene_of
from sim.scene.team import in_role, known_roles, occurring, team_cells
from sim.server.flight import Flight
from statuses import a_status, a_truth, a_vehicle


def view_of(*, teamed: bool = False, **fields: Any) -> DriveView:
    truth = a_truth(1.0, a_vehicle(), a_vehicle(), distance=8.0, teamed=teamed)
    (far,) = truth.escorts
    near = msgspec.structs.replace(far, uav="uav_1", distance=2.0)
    vehicles = truth.vehicles | {"uav_1": a_vehicle()}
    truth = msgspec.structs.replace(truth, escorts=(far, near), vehicles=vehicles)
    return DriveView(status=a_status(**fields), truth=truth)


def test_of_a_team_the_nearest_uav_decides_and_else_the_farthest() -> None:
    alone, teamed = view_of(), view_of(teamed=True)
    first, second = farthest(alone, "ugv_0"), farthest(teamed, "ugv_0")
    assert first is not None
    assert second is not None
    assert (first.uav, second.uav) == ("uav_0", "uav_1")


def test_terminal_shows_role_number_and_charge_of_each_uav() -> None:
    team = TeamStatus(
        team_certified_share=1.0,
        team_out_of_sight=0,
        charges={"uav_1": 123.4},
        numbers={"uav_0": 0, "uav_1": 30},
    )
    view = view_of(roles={"uav_0": Role.SCOUT, "uav_1": Role.GUARD}, team=team)
    shown = " ".join(numbers(view, "ugv_0", ErrorCurve()).plain.split())
    assert "uav_0 scout" in shown
    assert "uav_1 (30) guard, 123 s left" in shown
    assert "scout" not in numbers(view_of(), "ugv_0", ErrorCurve()).plain


def teamed_truth() -> Truth:
    (far,) = a_truth(1.0, a_vehicle(), a_vehicle(), distance=8.0, teamed=True).escorts
    near = msgspec.structs.replace(far, uav="uav_1", distance=2.0)
    other = msgspec.structs.replace(far, ugv="ugv_1", uav="uav_2", distance=9.0, teamed=False)
    truth = a_truth(1.0, a_vehicle(), a_vehicle())
    return msgspec.structs.replace(truth, escorts=(far, near, other))


def test_sight_depends_on_the_nearest_uav_of_a_team() -> None:
    assert [one.uav for one in decisive(teamed_truth().escorts)] == ["uav_1", "uav_2"]


def test_picture_of_a_team_that_sees_its_ugv_raises_no_alarm() -> None:
    flight = fly(load_scenario("scouts", overrides={"duration": 30.0, "area.cell": 0.5}), 7)[0]
    verdict = flight_picture._verdict(flight)
    assert verdict is not None
    assert verdict.text.startswith("UGV always in sight, margin 0.")
    assert verdict.reached.startswith("nearest UAV within 4.")
    assert not flight.recorder.unseen.any()
    assert flight.recorder.lost.any()
    assert flight.recorder.unseen.shape[1] == 1


def test_cells_contain_the_ground_that_is_nearest() -> None:
    rng = np.random.default_rng(3)
    positions = [tuple(row) for row in rng.uniform(0.0, 40.0, (5, 2)).tolist()]
    paths = [MplPath(cell) for cell in team_cells(positions, 40.0, 40.0)]
    for x, y in rng.uniform(0.1, 39.9, (500, 2)).tolist():
        distances = [math.hypot(x - p_x, y - p_y) for p_x, p_y in positions]
        inside = [path.contains_point((x, y)) for path in paths]
        assert inside.index(True) == distances.index(min(distances))
        assert inside.count(True) == 1


def test_roles_split_a_path_without_gaps() -> None:
    scout, guard = code(Role.SCOUT), code(Role.GUARD)
    known = known_roles(np.array([0, 0, scout, scout, guard, 0]))
    assert known.tolist() == [scout] * 4 + [guard] * 2
    path = np.arange(12.0).reshape(6, 2)
    scouted, guarded = (in_role(path, known, role)[:, 0] for role in (Role.SCOUT, Role.GUARD))
    assert scouted[:5].tolist() == path[:5, 0].tolist()  # up to the first point of the next role
    assert np.isnan(scouted[5])
    assert np.isnan(guarded[:4]).all()
    assert guarded[4:].tolist() == path[4:, 0].tolist()


def recorded(path: Path) -> Flight:
    scenario = load_scenario("scouts", overrides={"duration": 15.0, "area.cell": 0.5})
    flight, recorder = Flight(scenario, 7), FlightRecorder(path, scenario, 7)
    pilots = InProcess(make_pilots(scenario, 7))
    flight.fly(pilots, on_tick=lambda: recorder.tick(flight))
    recorder.close()
    return flight


def test_roles_are_recorded_per_tick_and_restored(tmp_path: Path) -> None:
    flight = recorded(tmp_path / "run.mcap")
    roles = flight.recorder.roles
    assert roles.shape == (301, 3)
    assert {Role.GUARD, Role.SCOUT} <= set(occurring({"all": roles.ravel()}))
    recording = flight_of(tmp_path / "run.mcap")
    assert np.array_equal(restore(recording).recorder.roles, roles)
    flight.recorder.write(tmp_path / "run.csv")
    header, *_, last = (tmp_path / "run.csv").read_text(encoding="utf-8").splitlines()[:-1]
    assert header.endswith("uav_0.role,uav_1.role,uav_2.role")
    assert sorted(last.split(",")[-3:]) == ["GUARD", "SCOUT", "SCOUT"]
    states = [one for one in entries(tmp_path / "run.mcap") if one.topic == "/uav_0/team"]
    assert json.loads(states[-1].data)["role"] in {*Role}


def test_pictures_and_films_of_a_team_name_the_roles(tmp_path: Path) -> None:
    flight = recorded(tmp_path / "run.mcap")
    figure = flight_picture.flight_figure(flight)
    shown = [
        text.get_text()
        for axes in figure.axes
        if axes.get_legend()
        for text in axes.get_legend().texts
    ]
    assert {"guard", "scout", "cell of a UAV"} <= set(shown)
    assert "away" not in shown
    film = Film(flight_of(tmp_path / "run.mcap"))
    first, last = (frame.copy() for frame in film.frames([0.0, 15.0]))
    assert not np.array_equal(first, last)


def test_pictures_without_a_team_show_no_roles() -> None:
    flight = fly(load_scenario("escort", overrides={"duration": 5.0, "area.cell": 0.5}), 7)[0]
    assert flight.recorder.roles.shape == (101, 0)
    scene = scene_of(flight.scenario)
    assert not scene.teams
    labels = [artist.get_label() for artist in legend_of(scene, roles=tuple(Role))]
    assert labels[0] == "UAV"
    assert "guard" not in labels


def test_terminal_requests_the_guard_s_relief_and_the_fullest_scout() -> None:
    team = TeamStatus(
        team_certified_share=1.0,
        team_out_of_sight=0,
        charges={"uav_1": 120.0, "uav_2": 280.0},
        numbers={"uav_0": 31, "uav_1": 30, "uav_2": 0},
    )
    geometry = geometry_of(load_scenario("scouts"))
    roles = {"uav_0": Role.GUARD, "uav_1": Role.SCOUT, "uav_2": Role.SCOUT}
    status = a_status(roles=roles, team=team, geometry=geometry)
    asked = [request_of(status, "ugv_0", request) for request in Request]
    assert [one and (one.vehicle, one.request) for one in asked] == [
        ("uav_2", Request.GUARD),
        ("uav_0", Request.RELIEF),
    ]
    assert request_of(status, "ugv_1", Request.GUARD) is None
    assert request_of(a_status(geometry=geometry), "ugv_0", Request.GUARD) is None
