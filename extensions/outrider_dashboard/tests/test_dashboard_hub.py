"""The state behind the page: present processes, gains of the law, teleoperation."""

from types import SimpleNamespace
from typing import Any

import pytest

from bus.keys import SIMULATOR_NAME, Party, Role
from bus.messages.control import Action, Change, Control
from bus.messages.scenario import Law
from bus.messages.telemetry import Status
from bus.messages.vehicle import Teleoperation
from bus.registry import TELEOP
from outrider_dashboard.controls.teleoperation import SharedTeleoperation
from outrider_dashboard.hub import running_law
from outrider_dashboard.sources.live import LiveRun
from statuses import a_status

FIRST = Law(name="logarithmic", parameters={"speed_gain": 2.0})
OTHER = Law(name="linear", parameters={"weight_gain": 7.0})


def status(law: str, *controls: Control) -> Status:
    changes = tuple(Change(tick=k, control=control) for k, control in enumerate(controls))
    return a_status(law=law, changes=changes)


@pytest.mark.parametrize(
    ("router", "simulator", "line"),
    [
        (True, True, ""),
        (True, False, "Waiting for a simulator to join"),
        (False, True, "The router is disconnected"),
    ],
)
def test_absent_router_is_not_reported_as_absent_simulator(router, simulator, line):
    def watch(name: str, see: Any) -> None:
        see(name, 0, simulator and name == SIMULATOR_NAME)

    party = Party(role=Role.OBSERVER, name="page")
    session: Any = SimpleNamespace(party=party, connected=router, watch=watch)
    run = LiveRun(session, read=())
    state = run.state
    run.close()
    assert (state.router, state.simulator) == (router, simulator)
    assert state.line.startswith(line)


def test_the_first_law_is_flown_until_another_is_chosen() -> None:
    assert running_law(status("logarithmic"), FIRST) == FIRST
    assert running_law(status("linear", Control(action=Action.LAW, law=OTHER)), FIRST) == OTHER


def test_unreported_gains_are_unknown() -> None:
    assert running_law(status("logarithmic"), None) is None
    assert running_law(status("switching"), FIRST) is None  # chosen before this page joined
    step = Control(action=Action.STEP)
    # older changes are no longer in the status
    assert running_law(status("logarithmic", *[step] * 20), FIRST) is None
    assert running_law(status("logarithmic", *[step] * 19), FIRST) == FIRST


def test_a_reset_brings_the_first_law_back() -> None:
    controls = (Control(action=Action.LAW, law=OTHER), Control(action=Action.RESET))
    assert running_law(status("logarithmic", *controls), FIRST) == FIRST
    assert running_law(status("logarithmic", *controls), None) is None


def test_driver_not_assigned_by_this_page_is_another_operator() -> None:
    controls: list[Control] = []
    teleoperation = SharedTeleoperation(
        lambda control: controls.append(control) is None, lambda _name, _drive: True
    )
    teleoperation.update(a_status(drivers={"ugv_0": "waypoints", "ugv_1": TELEOP}))
    assert teleoperation.other_operators() == ["ugv_1"]
    assert teleoperation.take_control(1, "browser 1", "ugv_0")
    operators = {"ugv_0": controls[-1].operator}
    taken = a_status(drivers={"ugv_0": TELEOP, "ugv_1": TELEOP}, operators=operators)
    teleoperation.update(taken)
    assert teleoperation.other_operators() == ["ugv_1"]
    teleoperation.release()
    assert teleoperation.other_operators() == ["ugv_1"]
    teleoperation.hand_back(1)
    assert controls[-1].driver == "waypoints"
    # until the simulator has restored the previous driver
    assert teleoperation.other_operators() == ["ugv_0", "ugv_1"]


def test_control_taken_by_another_operator_is_not_handed_back() -> None:
    controls: list[Control] = []
    driven: list[Teleoperation] = []
    teleoperation = SharedTeleoperation(
        lambda control: controls.append(control) is None,
        lambda _, drive: driven.append(drive) is None,
    )
    teleoperation.update(a_status(drivers={"ugv_0": "waypoints"}))
    assert teleoperation.take_control(1, "browser 1", "ugv_0")
    teleoperation.update(a_status(drivers={"ugv_0": TELEOP}, operators={"ugv_0": "a_terminal"}))
    assert not teleoperation.can_be_handed_back()
    teleoperation.hand_back(1)
    assert [control.driver for control in controls] == [TELEOP]
    teleoperation.update(a_status(drivers={"ugv_0": TELEOP}, over=True))
    assert not teleoperation.take_control(1, "browser 1", "ugv_0")
