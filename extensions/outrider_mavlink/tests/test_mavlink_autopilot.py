"""An autopilot as the inner loop of a UAV; a short loop stands in for a real autopilot."""

import logging
import math

import msgspec
import pytest
from test_mavlink import Station, select, texts

from bus.errors import ScenarioError
from bus.messages.vehicle import UavObservation
from flights import distances, flown_by
from outrider.running.flying import fly, make_pilots
from outrider_mavlink import autopilot as module
from outrider_mavlink.autopilot import (
    OLDER,
    OTHER_AUTOPILOT,
    AutopilotLink,
    AutopilotPilot,
)
from outrider_mavlink.dialect import mavlink
from outrider_mavlink.gateway import BEYOND_BOUNDS, NOT_FINITE
from outrider_mavlink.udp import UNREADABLE, Address, Network
from sim.scenario.loading import load_scenario

CHANGES = ("law.name=certified", "duration=15.0", "certificate.max_tracking_error=0.3")
START = (7.0, -3.0, -12.0)
"""Hover position in the autopilot's local frame: north, east, down [m]."""


class Autopilot(Station):
    """Moves to its setpoints and reports its position."""

    def __init__(self, link, port):
        super().__init__(link, number=42)
        self.mav.srcComponent = 1
        self.to = ("127.0.0.1", port)
        self.boot, self.place, self.velocity = 0, START, (0.0, 0.0)
        self.setpoints, self.requests = [], []

    def heartbeat(self, armed=True):
        flags = mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
        return mavlink.MAVLink_heartbeat_message(2, mavlink.MAV_AUTOPILOT_PX4, flags, 0, 4, 3)

    def report(self, **changes):
        self.boot += 50
        (x, y, z), (v_x, v_y) = self.place, self.velocity
        fields = {
            "time_boot_ms": self.boot % (1 << 32),
            "x": x,
            "y": y,
            "z": z,
            "vx": v_x,
            "vy": v_y,
            "vz": 0.0,
        }
        return mavlink.MAVLink_local_position_ned_message(*(fields | changes).values())

    def live(self, *, moves=True):
        """Receive setpoints, move to them, and report."""
        arrived = self.arrived()
        self.requests += select(arrived, "COMMAND_LONG")
        for one in select(arrived, "SET_POSITION_TARGET_LOCAL_NED"):
            self.setpoints.append(one)
            if moves:
                self.place, self.velocity = (one.x, one.y, one.z), (one.vx, one.vy)
        self.socket.sendto(self.report().pack(self.mav), self.to)


class Along:
    """A flight in this process with an autopilot."""

    def __init__(self, *changes):
        self.scenario = load_scenario("escort", overrides=[*CHANGES, *changes])
        self.network = Network(listen=[Address("127.0.0.1", 0)])
        self.link = AutopilotLink(self.network)
        port = self.network._links[0].socket.getsockname()[1]
        self.autopilot = Autopilot(self.link, port)
        self.pilot = AutopilotPilot(self.link)
        self.reports = []

    def fly(self, each_tick=lambda _tick: None, *, moves=lambda _tick: True):
        arrived = self.autopilot.send(self.autopilot.heartbeat(), self.autopilot.report())
        self.autopilot.requests += select(arrived, "COMMAND_LONG")

        def act(seen):
            each_tick(seen.tick)
            self.link.turn(0.0)
            command = self.pilot.act(seen)
            self.reports.append(command.report)
            self.pilot.prepare()
            self.link.refresh()
            self.autopilot.live(moves=moves(seen.tick))
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
    return fly(load_scenario("escort", overrides=CHANGES), 0)[0]


def same_bits(flight, plain):
    return flight.recorder.states.tobytes() == plain.recorder.states.tobytes()


def test_autopilot_that_tracks_its_setpoints_changes_no_bit(along, plain):
    flight = along.fly()
    assert same_bits(flight, plain)
    assert along.pilot.held_ticks == 0
    assert 0.0 < along.pilot.largest_deviation < 0.1  # it receives them a tick later
    assert along.reports[-1].decision.certified
    requests = {(one.command, one.param1) for one in along.autopilot.requests}
    assert requests == {(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 32.0)}


def test_setpoints_are_the_track_from_where_the_autopilot_hovers(along, plain):
    along.fly()
    first, last = along.autopilot.setpoints[0], along.autopilot.setpoints[-1]
    assert (first.x, first.y, first.z) == pytest.approx(START)
    uav = plain.recorder.states[:, plain.world.names.index("uav_0")]
    (x, y), (v_x, v_y) = uav[-1][:2] - uav[0][:2], uav[-1][2:4]
    assert (last.x - START[0], last.y - START[1]) == pytest.approx((y, x), abs=0.05)
    assert (last.vx, last.vy) == pytest.approx((v_y, v_x), abs=0.02)
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
    assert distances(flight).max() < 4.75
    assert flight.answers.assurance.certificate_broken == 0


def test_run_waits_for_a_silent_or_unarmed_autopilot(along, monkeypatch):
    along.fly()
    where = along.pilot._link.reference.position
    assert along.link.deviation(where) < 0.1
    monkeypatch.setattr(module, "_TELEMETRY_TIMEOUT", -1.0)
    assert along.link.deviation(where) == math.inf
    monkeypatch.undo()
    along.autopilot.send(along.autopilot.heartbeat(armed=False))
    assert not along.link.armed


def test_bad_telemetry_is_counted_by_cause_and_changes_no_bit(along, plain):
    station = along.autopilot
    other = Station(along.link, number=43)
    other.to, other.mav.srcComponent = station.to, 1
    bad = [
        (station, {"x": math.nan}, NOT_FINITE),
        (station, {"vy": math.inf}, NOT_FINITE),
        (station, {"vx": 5.0}, BEYOND_BOUNDS),
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


def test_restarted_autopilot_is_accepted_again(along, monkeypatch):
    along.fly()
    assert accepted(along)
    late = along.autopilot.report(time_boot_ms=7)
    (why,) = texts(along.autopilot.send(late))
    assert why == f"rejected: telemetry {OLDER}; accepted after 1 s without telemetry"
    monkeypatch.setattr(module, "_TELEMETRY_TIMEOUT", -1.0)  # as after a second of silence
    assert accepted(along, time_boot_ms=7)
    other = Autopilot(along.link, along.autopilot.to[1])
    (why,) = texts(other.send(other.heartbeat()))
    assert OTHER_AUTOPILOT in why
    assert why.endswith("accepted after 3 s of silence")
    monkeypatch.setattr(module, "_PEER_TIMEOUT", -1.0)
    arrived = other.send(other.heartbeat(), other.report())
    assert select(arrived, "COMMAND_LONG")  # the new station has no requests yet
    assert along.link.peer.address[1] == other.port
    assert along.link.armed
    other.socket.close()


def test_a_silent_autopilot_is_asked_again_for_telemetry(along, monkeypatch):
    along.fly()
    along.autopilot.arrived()
    monkeypatch.setattr(module, "_HEARTBEAT", 0.0)
    along.link.refresh()
    assert not select(along.autopilot.arrived(), "COMMAND_LONG")
    monkeypatch.setattr(module, "_TELEMETRY_TIMEOUT", -1.0)
    along.link.refresh()
    assert select(along.autopilot.arrived(), "COMMAND_LONG")


def test_no_other_system_becomes_the_autopilot(along, monkeypatch):
    along.fly()
    monkeypatch.setattr(module, "_PEER_TIMEOUT", -1.0)
    other = Autopilot(along.link, along.autopilot.to[1])
    other.mav.srcSystem = 43
    (why,) = texts(other.send(other.heartbeat()))
    assert why.endswith(OTHER_AUTOPILOT)
    assert along.link.peer.system == 42
    other.socket.close()


def test_the_clock_of_an_autopilot_may_roll_over(along):
    along.fly()
    assert accepted(along, time_boot_ms=(1 << 31) + 5_000)
    assert accepted(along, time_boot_ms=(1 << 32) - 10)
    assert accepted(along, time_boot_ms=40)
    assert not accepted(along, time_boot_ms=(1 << 32) - 10)


def test_a_run_that_declares_no_deviation_is_refused():
    pilot = AutopilotPilot(AutopilotLink(Network()))
    arrived = make_pilots(load_scenario("escort"), 0)["uav_0"]._briefing
    assert msgspec.to_builtins(arrived)["safety"]["max_tracking_error"] == 0.0
    with pytest.raises(ScenarioError, match=r"--set certificate\.max_tracking_error=0\.3"):
        pilot.make(arrived)


def test_past_replayed_on_rejoin_is_not_sent_to_the_autopilot(along):
    along.fly()
    pilot, seen = along.pilot, make_pilots(along.scenario, 0)["uav_0"]._briefing
    pilot.make(seen)
    past = msgspec.convert(
        {"tick": 0, "time": 0.0, "position": [1.0, 1.0], "velocity": [0.0, 0.0]}, UavObservation
    )
    pilot.act(past)
    assert along.link.reference is None
    now = msgspec.structs.replace(past, tick=1, position=(9.0, 8.0))
    pilot.act(now)
    pilot.prepare()
    assert along.link.reference.position == (9.0, 8.0)
    assert along.link.deviation((9.0, 8.0)) == 0.0  # the deviation from its own position


def test_paused_run_commands_the_autopilot_to_stay(along, monkeypatch):
    along.fly()
    monkeypatch.setattr(module, "_PAUSED", -1.0)
    monkeypatch.setattr(module, "_RESEND", 0.0)
    along.autopilot.arrived()
    along.link.refresh()
    (one,) = select(along.autopilot.arrived(), "SET_POSITION_TARGET_LOCAL_NED")
    assert (one.vx, one.vy, one.afx, one.afy) == (0.0, 0.0, 0.0, 0.0)
