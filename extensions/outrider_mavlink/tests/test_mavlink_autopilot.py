"""An autopilot as the inner loop of a UAV; a small vehicle model stands in for a real one."""

import logging
import math

import msgspec
import pytest
from along import CHANGES, Along, Autopilot, kept, uav_of
from test_mavlink import Station, select, texts
from vehicle_model import HOVER, heartbeat

from bus.errors import ScenarioError
from bus.messages.vehicle import UavObservation
from outrider.running.summary import summarize
from outrider_mavlink.autopilot import AutopilotPilot
from outrider_mavlink.autopilot_link import OLDER, OTHER_AUTOPILOT, AutopilotLink
from outrider_mavlink.dialect import mavlink
from outrider_mavlink.gateway import BEYOND_BOUNDS, NOT_FINITE
from outrider_mavlink.udp import UNREADABLE, Network
from sim.engine.briefing import uav_briefing
from sim.scenario.loading import load_scenario


@pytest.fixture(name="along")
def flown_along():
    along = Along()
    yield along
    along.close()


@pytest.fixture(scope="module", name="plain")
def a_plain_flight():
    along = Along()
    flight = along.fly()
    along.close()
    return flight


def same_bits(flight, plain):
    return flight.recorder.states.tobytes() == plain.recorder.states.tobytes()


def test_the_same_robot_flies_the_same_bits(along, plain):
    flight = along.fly()
    assert same_bits(flight, plain)
    assert along.pilot.held_ticks == 0
    assert along.reports[-1].decision.certified
    requests = {(one.command, one.param1) for one in along.autopilot.requests}
    assert requests == {(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 32.0)}


def test_setpoints_are_the_track_from_where_the_autopilot_hovers(along):
    flight = along.fly()
    first, last = along.autopilot.setpoints[0], along.autopilot.setpoints[-1]
    assert (first.x, first.y, first.z) == pytest.approx(HOVER)
    uav = flight.recorder.reference[:, uav_of(flight)]
    (x, y), (v_x, v_y) = uav[-2][:2] - uav[0][:2], uav[-2][2:4]
    assert (last.x - HOVER[0], last.y - HOVER[1]) == pytest.approx((y, x), abs=1e-5)
    assert (last.vx, last.vy) == pytest.approx((v_y, v_x), abs=1e-5)
    assert last.z == HOVER[2]
    assert (last.target_system, last.type_mask) == (42, 0b110_000_000_000)


def test_run_waits_uncertified_for_a_lagging_autopilot(along, caplog):
    with caplog.at_level(logging.WARNING):
        flight = along.fly(moves=lambda tick: not 40 <= tick < 200)
    assert (
        "m, allowed up to 0.3 m: the UAV holds its position, and nothing is certified"
        in caplog.text
    )
    assert "the autopilot tracks the reference state" in caplog.text
    assert 0 < along.pilot.held_ticks < 200
    waiting = [one for one in along.reports if one is not None and one.decision is None]
    assert len(waiting) >= along.pilot.held_ticks - 1
    assert along.reports[-1].decision.certified
    summary = summarize(flight, seconds=1.0)
    assert summary.tracking_exceeded > 0
    assert along.pilot.dropped > 0
    assert summary.visibility_violations == 0
    assert kept(summary)


def test_run_waits_for_an_unarmed_autopilot(along):
    along.fly()
    along.autopilot.send(heartbeat(armed=False))
    assert not along.link.armed
    seen = msgspec.convert(
        {"tick": 300, "time": 15.0, "position": along.link.reference.position, "velocity": [0, 0]},
        UavObservation,
        strict=False,
    )
    assert along.pilot.act(seen).report.decision is None


def test_bad_telemetry_is_counted_by_cause_and_changes_no_bit(along, plain):
    station = along.autopilot
    other = Station(along.link, number=43)
    other.to, other.mav.srcComponent = station.to, 1
    bad = [
        (station, {"x": math.nan}, NOT_FINITE),
        (station, {"vz": math.inf}, NOT_FINITE),
        (station, {"y": 1e30}, BEYOND_BOUNDS),
        (station, {"vx": 7.0}, BEYOND_BOUNDS),
        (station, {"time_boot_ms": 1}, OLDER),
        (other, {}, OTHER_AUTOPILOT),
    ]

    def each_tick(tick):
        if tick % 10 == 5:
            who, changes, _ = bad[tick // 10 % len(bad)]
            message = station.report(**changes)
            who.socket.sendto(message.pack(who.mav), who.to)
            who.socket.sendto(b"\xfe nonsense", who.to)

    flight = along.fly(each_tick)
    other.socket.close()
    assert same_bits(flight, plain)
    times = flight.scenario.ticks // 10
    causes = [bad[n % len(bad)][2] for n in range(times)]
    wanted = {cause: causes.count(cause) for cause in causes} | {UNREADABLE: times}
    assert dict(along.link.refusals.counts) == wanted


def accepted(along, **changes):
    """Return whether telemetry of this kind is accepted."""
    along.link.turn(0.0)
    before = along.link.reports
    along.autopilot.send(along.autopilot.report(**changes))
    return along.link.reports > before


def test_restarted_autopilot_is_accepted_again(along):
    along.fly()
    assert accepted(along)
    late = along.autopilot.report(time_boot_ms=7)
    (why,) = texts(along.autopilot.send(late))
    assert why == f"rejected: telemetry {OLDER}; accepted after 1 s without telemetry"
    along.now += 1.1
    assert accepted(along, time_boot_ms=7)
    other = Autopilot(along.link, along.autopilot.to[1])
    (why,) = texts(other.send(heartbeat()))
    assert OTHER_AUTOPILOT in why
    assert why.endswith("accepted after 3 s of silence")
    along.now += 3.1
    arrived = other.send(heartbeat(), other.report())
    assert select(arrived, "COMMAND_LONG")  # the new station has no requests yet
    assert along.link.peer.address[1] == other.port
    assert along.link.armed
    other.socket.close()


def test_a_silent_autopilot_is_asked_again_for_telemetry(along):
    along.fly()
    along.autopilot.arrived()
    along.now += 0.9
    along.link.refresh()
    assert not select(along.autopilot.arrived(), "COMMAND_LONG")
    along.now += 1.1
    along.link.refresh()
    assert select(along.autopilot.arrived(), "COMMAND_LONG")


def test_no_other_system_becomes_the_autopilot(along):
    along.fly()
    along.now += 3.1
    other = Autopilot(along.link, along.autopilot.to[1])
    other.mav.srcSystem = 43
    (why,) = texts(other.send(heartbeat()))
    assert why.endswith(OTHER_AUTOPILOT)
    assert along.link.peer.system == 42
    other.socket.close()


def test_the_clock_of_an_autopilot_may_roll_over(along):
    along.fly()
    assert accepted(along, time_boot_ms=(1 << 31) + 5_000)
    assert accepted(along, time_boot_ms=(1 << 32) - 10)
    assert accepted(along, time_boot_ms=40)
    assert not accepted(along, time_boot_ms=(1 << 32) - 10)


@pytest.mark.parametrize(
    ("change", "wrong"),
    [
        ("certificate.max_tracking_error=0", r"--set certificate\.max_tracking_error=0\.3"),
        ("uav.0.body=point", r"--set uav\.\*\.body=reported"),
    ],
)
def test_a_run_that_takes_no_robot_is_refused(change, wrong):
    pilot = AutopilotPilot(AutopilotLink(Network()))
    scenario = load_scenario("escort", overrides=[*CHANGES, change])
    with pytest.raises(ScenarioError, match=wrong):
        pilot.make(uav_briefing(scenario, "uav_0", 0))


def test_past_replayed_on_rejoin_is_not_sent_to_the_autopilot(along):
    along.fly()
    pilot, brief = along.pilot, uav_briefing(along.scenario, "uav_0", 0)
    here, anchor = along.link.reference.position, along.link.anchor
    pilot.make(brief)
    past = msgspec.convert(
        {"tick": 0, "time": 0.0, "position": [1.0, 1.0], "velocity": [0.0, 0.0]}, UavObservation
    )
    assert pilot.act(past).robot is None
    assert along.link.reference is None
    now = msgspec.structs.replace(past, tick=1, position=here)
    pilot.act(now)
    pilot.prepare()
    assert along.link.reference.position == here
    assert along.link.anchor == anchor  # the same run, and the robot is where it was
    pilot.make(msgspec.structs.replace(brief, episode=1))
    pilot.act(now)
    pilot.prepare()
    assert along.link.deviation(here) < 0.01  # another run begins where the robot hovers
    pilot.make(msgspec.structs.replace(brief, episode=1))
    pilot.act(msgspec.structs.replace(past, tick=1, position=(30.0, 8.0)))
    pilot.prepare()
    assert along.link.deviation((30.0, 8.0)) < 0.01


def test_paused_run_commands_the_autopilot_to_stay(along):
    along.fly()
    along.autopilot.arrived()
    along.now += 0.4
    along.link.refresh()
    (one,) = select(along.autopilot.arrived(), "SET_POSITION_TARGET_LOCAL_NED")
    assert (one.vx, one.vy, one.afx, one.afy) == (0.0, 0.0, 0.0, 0.0)
