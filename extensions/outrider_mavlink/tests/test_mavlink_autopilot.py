"""An autopilot as the inner loop of a UAV; a small vehicle model stands in for a real one."""

import logging
import math

import msgspec
import numpy as np
import pytest
from test_mavlink import Station, select, texts
from vehicle_model import HOVER, VehicleModel, heartbeat, position_report

from bus.errors import ScenarioError
from bus.messages.decision import NotCertified
from bus.messages.vehicle import UavObservation
from flights import distances, flown_by
from outrider.running.summary import summarize
from outrider_mavlink.autopilot import AutopilotPilot
from outrider_mavlink.autopilot_link import OLDER, OTHER_AUTOPILOT, AutopilotLink
from outrider_mavlink.dialect import mavlink
from outrider_mavlink.gateway import BEYOND_BOUNDS, NOT_FINITE
from outrider_mavlink.udp import UNREADABLE, Address, Network
from sim.engine.briefing import uav_briefing
from sim.scenario.loading import load_scenario

DECLARED = 0.3
"""Declared bound of the tracking error [m]."""
CHANGES = (
    "law.name=certified",
    "uav.0.body=reported",
    f"certificate.max_tracking_error={DECLARED}",
    "detections.dropout=0",
)
START = HOVER


class Autopilot(Station):
    """Flies a vehicle model, or is always at its setpoint, and reports its state."""

    def __init__(self, link, port, model=None):
        super().__init__(link, number=42)
        self.mav.srcComponent = 1
        self.to, self.model = ("127.0.0.1", port), model
        self.boot, self.place, self.velocity = 0, START, (0.0, 0.0)
        self.setpoints, self.requests = [], []

    def report(self, **changes):
        self.boot += 50
        message = position_report(self.boot, self.place, self.velocity)
        for field, value in changes.items():
            setattr(message, field, value)
        return message

    def live(self, time, *, moves=True, reports=True):
        """Receive setpoints, fly up to a time [s], and report."""
        arrived = self.arrived()
        self.requests += select(arrived, "COMMAND_LONG")
        wanted = select(arrived, "SET_POSITION_TARGET_LOCAL_NED")
        self.setpoints += wanted
        if self.model is not None:
            for one in wanted:
                self.model.command(one)
            self.model.advance(time)
            self.place = (*self.model.position, self.model.down)
            self.velocity = tuple(self.model.velocity)
        elif not moves:
            self.velocity = (0.0, 0.0)
        elif wanted:
            one = wanted[-1]
            self.place, self.velocity = (one.x, one.y, one.z), (one.vx, one.vy)
        if reports:
            self.socket.sendto(self.report().pack(self.mav), self.to)


class Along:
    """A flight in this process with an autopilot, both in simulated time."""

    def __init__(self, *changes, model=None, duration=15.0):
        given = [*CHANGES, f"duration={duration}", *changes]
        self.scenario = load_scenario("escort", overrides=given)
        self.now = 0.0
        self.network = Network(listen=[Address("127.0.0.1", 0)])
        self.link = AutopilotLink(self.network, lambda: self.now)
        port = self.network._links[0].socket.getsockname()[1]
        self.autopilot = Autopilot(self.link, port, model)
        self.pilot = AutopilotPilot(self.link)
        self.reports = []

    def fly(
        self, each_tick=lambda _tick: None, *, moves=lambda _tick: True, reports=lambda _tick: True
    ):
        arrived = self.autopilot.send(heartbeat(), self.autopilot.report())
        self.autopilot.requests += select(arrived, "COMMAND_LONG")

        def act(seen):
            self.now = seen.time
            each_tick(seen.tick)
            self.link.turn(0.0)
            command = self.pilot.act(seen)
            self.reports.append(command.report)
            self.pilot.prepare()
            self.link.refresh()
            after = (seen.tick + 1) * self.scenario.dt
            self.autopilot.live(after, moves=moves(seen.tick), reports=reports(seen.tick))
            return command

        return flown_by(self.pilot, self.scenario, act)

    def close(self):
        self.network.close()
        self.autopilot.socket.close()


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


def flown_with(model, *changes, duration=15.0, **events):
    """Fly with a vehicle model; return the flight, its summary, and the pilot."""
    along = Along(*changes, model=model, duration=duration)
    flight = along.fly(**events)
    along.close()
    return flight, summarize(flight, seconds=1.0), along.pilot


def same_bits(flight, plain):
    return flight.recorder.states.tobytes() == plain.recorder.states.tobytes()


def kept(summary):
    """Return whether no counter shows an error in the certificate."""
    return (summary.certified_while_lost, summary.certificate_broken) == (0, 0)


def uav_of(flight):
    return flight.world.names.index("uav_0")


def test_the_robot_is_the_true_uav_of_the_run():
    model, seen = VehicleModel(wind=(1.5, -1.0)), []

    def each_tick(_tick):
        north, east = model.position
        seen.append((east - START[1], north - START[0]))

    flight, summary, pilot = flown_with(model, each_tick=each_tick)
    states, reference = (
        array[:-1, uav_of(flight)] for array in (flight.recorder.states, flight.recorder.reference)
    )
    robot = np.array(seen) + reference[0, :2]
    # the velocity bridges one tick; tick 1 has no report yet
    assert np.abs(states[2:, :2] - robot[2:]).max() < 0.003
    assert np.abs(reference[2:, :2] - robot[2:]).max() > 0.05
    uav, ugv = (
        flight.world.position[flight.world.names.index(name)] for name in ("uav_0", "ugv_0")
    )
    assert distances(flight)[-1] == pytest.approx(math.dist(uav, ugv))
    assert summary.largest_tracking_error == pytest.approx(pilot.largest_deviation, abs=0.01)
    assert (summary.tracking_exceeded, pilot.held_ticks, flight.robots.unreported["uav_0"]) == (
        0,
        0,
        2,
    )
    assert kept(summary)
    assert summary.certified_share > 0.95


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
    assert (first.x, first.y, first.z) == pytest.approx(START)
    uav = flight.recorder.reference[:, uav_of(flight)]
    (x, y), (v_x, v_y) = uav[-2][:2] - uav[0][:2], uav[-2][2:4]
    assert (last.x - START[0], last.y - START[1]) == pytest.approx((y, x), abs=1e-5)
    assert (last.vx, last.vy) == pytest.approx((v_y, v_x), abs=1e-5)
    assert last.z == START[2]
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


@pytest.mark.parametrize("declared", [DECLARED, 0.15])
def test_every_excess_of_the_declared_bound_is_counted(declared):
    model = VehicleModel(gust=0.3, seed=1)

    def storm(tick):
        model.wind = (0.0, 8.0) if 100 <= tick < 180 else (0.0, 0.0)

    change = f"certificate.max_tracking_error={declared}"
    flight, summary, pilot = flown_with(model, change, each_tick=storm)
    off = flight.recorder.states[:-1, uav_of(flight), :2]
    off = np.hypot(*(off - flight.recorder.reference[:-1, uav_of(flight), :2]).T)
    assert summary.tracking_exceeded == int((off > declared).sum()) > 20
    assert summary.largest_tracking_error > 0.35
    assert pilot.held_ticks > 20
    assert kept(summary)
    assert flight.recorder.escorts[-2, 0, 6] == 1.0  # certified again


def test_silence_is_counted_until_the_autopilot_is_back():
    silent = range(100, 160)
    flight, summary, pilot = flown_with(
        VehicleModel(gust=0.5), reports=lambda tick: tick not in silent
    )
    unreported = flight.robots.unreported["uav_0"]
    assert unreported == pytest.approx(2 + 60 - 20, abs=1)
    assert summary.uncertified[NotCertified.NO_ROBOT_STATE] == unreported
    assert pilot.held_ticks == pytest.approx(60 - 20, abs=1)
    certified = flight.recorder.escorts[:-1, 0, 6]
    assert not (certified[124:160] == 1.0).any()
    assert certified[-1] == 1.0
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


def test_a_flight_goes_on_after_a_restart_of_the_autopilot():
    along = Along(model=VehicleModel())

    def each_tick(tick):
        if tick == 160:
            along.autopilot.boot = 0

    flight = along.fly(each_tick, reports=lambda tick: not 100 <= tick < 160)
    along.close()
    assert along.pilot.held_ticks > 0
    assert flight.recorder.escorts[-2, 0, 6] == 1.0
    assert summarize(flight, seconds=1.0).largest_tracking_error < DECLARED


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
