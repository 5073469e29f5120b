"""A UAV flown by MAVLink setpoints: inside the safety filter, and to the same bits whatever else is sent."""

import math

import numpy as np
import pytest
from test_mavlink import Station, second_station, select, texts

from bus.messages.scenario import Limits, Origin
from flights import distances, flown_by
from outrider.running.flying import fly
from outrider.running.refused import Refused
from outrider.running.summary import summarize
from outrider_mavlink.dialect import mavlink
from outrider_mavlink.gateway import (
    BEYOND_BOUNDS,
    NOT_FINITE,
    NOT_SUPPORTED,
    OTHER_COMPONENT,
    OTHER_SYSTEM,
    SECOND_STATION,
)
from outrider_mavlink.identity import HOLD, MISSION, OFFBOARD, VehicleSystem
from outrider_mavlink.offboard import TOO_EARLY, OffboardGateway, OffboardPilot
from outrider_mavlink.setpoints import (
    POSITION,
    VERTICAL,
    WRONG_FRAME,
    Setpoint,
    read_setpoint,
)
from outrider_mavlink.udp import UNREADABLE, Address, Network
from sim.scenario.loading import load_scenario

SHORT = ("law.name=certified", "duration=20.0")
LIMITS = Limits(max_speed=0.6, max_acceleration=0.3)
VELOCITY, ACCELERATION = 0b110_111_000_111, 0b110_000_111_111
VELOCITY_AND_ACCELERATION = 0b110_000_000_111


def target(
    velocity=(0.0, 0.0, 0.0),
    acceleration=(0.0, 0.0, 0.0),
    *,
    mask=VELOCITY,
    frame=1,
    system=1,
    component=1,
):
    """Return a SET_POSITION_TARGET_LOCAL_NED: north, east, down."""
    return mavlink.MAVLink_set_position_target_local_ned_message(
        0, system, component, frame, mask, 0.0, 0.0, 0.0, *velocity, *acceleration, 0.0, 0.0
    )


def test_a_setpoint_is_read_by_its_type_mask():
    both = target((0.1, -0.2, 0.0), (0.05, 0.1, 0.0), mask=VELOCITY_AND_ACCELERATION)
    assert read_setpoint(both, LIMITS) == Setpoint((-0.2, 0.1), (0.1, 0.05))
    one = target((0.1, -0.2, 0.0), (math.nan,) * 3)
    assert read_setpoint(one, LIMITS) == Setpoint((-0.2, 0.1), None)
    assert read_setpoint(target((0.1, -0.2, 0.0), mask=0x0FC7), LIMITS).velocity == (
        -0.2,
        0.1,
    )  # from DroneKit
    other = target((math.nan,) * 3, (0.3, 0.0, 0.0), mask=ACCELERATION)
    assert read_setpoint(other, LIMITS) == Setpoint(None, (0.0, 0.3))
    as_fast_as_it_goes = float(np.float32(0.6))
    assert read_setpoint(target((as_fast_as_it_goes, 0.0, 0.0)), LIMITS).velocity is not None


BAD = [
    (target((math.nan, 0.0, 0.0)), NOT_FINITE),
    (target((math.inf, 0.0, 0.0)), NOT_FINITE),
    (target((0.5, 0.5, 0.0)), BEYOND_BOUNDS),
    (target(acceleration=(0.0, 0.31, 0.0), mask=ACCELERATION), BEYOND_BOUNDS),
    (target((0.1, 0.0, -0.5)), VERTICAL),
    (target((0.1, 0.0, math.nan)), VERTICAL),
    (target(frame=8), WRONG_FRAME),
    (target(mask=0), POSITION),
    (target(mask=0b110_111_111_111), NOT_SUPPORTED),
    (target(mask=VELOCITY | 0b1000), NOT_SUPPORTED),
    (target(acceleration=(0.1, 0.0, 0.0), mask=ACCELERATION | 1 << 9), NOT_SUPPORTED),
]


@pytest.mark.parametrize(("message", "cause"), BAD)
def test_infeasible_setpoint_is_refused_with_its_cause(message, cause):
    with pytest.raises(Refused) as refused:
        read_setpoint(message, LIMITS)
    assert refused.value.cause == cause


class Run:
    """A flight in this process whose UAV a ground station may fly."""

    def __init__(self, *changes):
        self.scenario = load_scenario("escort", overrides=[*SHORT, *changes])
        self.pilot = OffboardPilot()
        self.station = Station(None)
        self.network = Network([Address("127.0.0.1", self.station.port)])
        system = VehicleSystem("uav_0", 1, flies=True, origin=Origin(), height=10.0)
        self.gateway = self.station.gateway = OffboardGateway(self.pilot, self.network, system)
        self.gateway.say(system, "here")
        self.station.to = ("127.0.0.1", self.network._links[0].socket.getsockname()[1])
        self.station.arrived()

    def fly(self, each_tick=lambda _tick: None):
        def act(seen):
            each_tick(seen.tick)
            return self.pilot.act(seen)

        flight = flown_by(self.pilot, self.scenario, act)
        return flight, summarize(flight, seconds=1.0)

    def close(self):
        self.network.close()
        self.station.socket.close()


@pytest.fixture(name="run")
def a_run():
    run = Run()
    yield run
    run.close()


def offboard(run):
    return run.station.ask(mavlink.MAV_CMD_DO_SET_MODE, 1.0, 6.0)


@pytest.fixture(scope="module", name="plain")
def a_plain_flight():
    return fly(load_scenario("escort", overrides=SHORT), 0)[1].trajectory_sha256


def test_without_a_setpoint_the_law_flies_to_the_same_bits(run, plain):
    run.pilot.mode = OFFBOARD
    assert run.fly()[1].trajectory_sha256 == plain
    assert run.pilot.setpoint_ticks == 0


def test_bad_messages_are_counted_by_cause_and_change_no_bit(run, plain):
    run.pilot.mode = OFFBOARD
    others = [
        (target(system=9), OTHER_SYSTEM),
        (target(component=100), OTHER_COMPONENT),
        (
            mavlink.MAVLink_set_attitude_target_message(0, 1, 1, 0, [1, 0, 0, 0], 0, 0, 0, 0),
            NOT_SUPPORTED,
        ),
    ]
    messages = [message for message, _ in BAD + others]

    def each_tick(tick):
        if tick % 20 == 0:
            run.station.send(messages[tick // 20 % len(messages)], raw=b"\xfd\x09nonsense")

    flight, summary = run.fly(each_tick)
    assert summary.trajectory_sha256 == plain
    ticks = range(0, flight.scenario.ticks, 20)
    causes = [(BAD + others)[tick // 20 % len(messages)][1] for tick in ticks]
    wanted = {cause: causes.count(cause) for cause in causes}
    refused = dict(run.gateway.refusals.counts)
    assert refused.pop(UNREADABLE) == len(ticks)
    assert refused == wanted


def test_setpoints_fly_the_uav(run):
    run.pilot.mode = OFFBOARD
    flown = []

    def each_tick(tick):
        if tick < 100:
            run.pilot.set_setpoint(Setpoint((0.0, 0.2), None))
        flown.append(run.pilot.flown)

    run.fly(each_tick)
    assert flown[99].observation.velocity == pytest.approx((0.0, 0.2), abs=1e-6)
    assert run.pilot.setpoint_ticks == 100 + 10  # the last setpoint counts for the command timeout
    assert run.pilot.interventions == 0


def test_flying_away_is_stopped_by_the_filter(run):
    run.pilot.mode = OFFBOARD
    flight, summary = run.fly(lambda _tick: run.pilot.set_setpoint(Setpoint((-0.6, 0.0), None)))
    assert distances(flight).max() < 4.75
    assert distances(flight)[-1] > 3.0  # it tried to leave
    assert run.pilot.interventions > 50
    assert summary.certified_share == 1.0
    run.gateway.refresh()
    assert "the safety filter acts: the UGV would be lost from sight" in texts(
        run.station.arrived()
    )


def test_a_law_without_a_filter_gets_one_when_setpoints_may_come():
    run = Run("law.name=tracking")
    flight, summary = run.fly(lambda _tick: run.pilot.set_setpoint(Setpoint(None, (-0.3, 0.0))))
    assert summary.max_distance < 4.75
    run.pilot.mode = OFFBOARD
    flight, summary = run.fly(lambda _tick: run.pilot.set_setpoint(Setpoint(None, (-0.3, 0.0))))
    assert 3.0 < distances(flight)[-1] < 4.75
    run.close()


def test_mode_hold_stops_the_uav(run):
    run.pilot.mode = HOLD
    run.fly()
    assert math.hypot(*run.pilot.flown.observation.velocity) < 0.25  # while its UGV drives on
    assert run.pilot.setpoint_ticks == 0


def test_only_the_first_ground_station_changes_modes(run):
    assert select(run.station.send(target()), "COMMAND_ACK") == []
    assert run.gateway.refusals.counts == {TOO_EARLY: 1}
    run.fly()
    assert offboard(run) == mavlink.MAV_RESULT_ACCEPTED
    assert run.pilot.mode is OFFBOARD
    ask = run.station.ask
    assert ask(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == mavlink.MAV_RESULT_ACCEPTED
    assert ask(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0) == mavlink.MAV_RESULT_DENIED
    assert ask(mavlink.MAV_CMD_DO_SET_MODE, 1.0, 3.0) == mavlink.MAV_RESULT_UNSUPPORTED
    assert ask(mavlink.MAV_CMD_DO_SET_MODE, 1.0, math.nan) == mavlink.MAV_RESULT_UNSUPPORTED
    second = second_station(run)
    assert ask(mavlink.MAV_CMD_DO_SET_MODE, 1.0, 4.0, 4.0) == mavlink.MAV_RESULT_DENIED
    before = run.pilot._setpoint
    assert any(SECOND_STATION in text for text in texts(second.send(target((0.1, 0.0, 0.0)))))
    assert run.gateway.refusals.counts[SECOND_STATION] == 2
    assert (run.pilot.mode, run.pilot._setpoint) == (OFFBOARD, before)


def test_uav_reports_its_own_knowledge_and_not_the_truth(run):
    run.fly()
    run.gateway.refresh()
    arrived = run.station.send(mavlink.MAVLink_param_request_list_message(1, 1))
    seen, report = run.pilot.flown.observation, run.pilot.flown.command.report
    (local,) = select(arrived, "LOCAL_POSITION_NED")
    assert (local.y, local.x) == pytest.approx(seen.position)
    (followed,) = select(arrived, "FOLLOW_TARGET")
    assert followed.est_capabilities == 1  # a position, but not the UGV's velocity
    assert followed.position_cov[1] == pytest.approx(report.covariance[0])
    assert {one.param_id for one in select(arrived, "PARAM_VALUE")} >= {
        "HOLD",
        "VIS_RADIUS",
        "MAX_SPEED",
    }
    assert run.gateway.systems[1].mode is MISSION
