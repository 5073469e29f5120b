"""Views of a team: what the terminal shows of its UAVs."""

from typing import Any

import msgspec

from bus.messages.team import Role
from bus.messages.telemetry import TeamStatus, Truth
from outrider.running.flying import fly
from outrider.view import flight_picture
from outrider.view.terminal.panel import ErrorCurve, farthest, numbers
from outrider.view.terminal.teleoperation import DriveView
from sim.scenario.loading import load_scenario
from sim.scene.altitude import decisive
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
