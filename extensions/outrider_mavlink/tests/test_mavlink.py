"""A run over MAVLink: telemetry is true, and refused requests are counted."""

import math
import socket
import struct
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bus.errors import ScenarioError
from bus.geodesy import geodetic
from bus.messages.control import Action
from bus.messages.decision import NotCertified
from bus.messages.scenario import Origin
from bus.messages.team import Role
from bus.messages.telemetry import TeamStatus, VehicleStatus
from outrider_mavlink.dialect import mavlink
from outrider_mavlink.gateway import (
    BEYOND_BOUNDS,
    NOT_ALLOWED,
    NOT_FINITE,
    NOT_SUPPORTED,
    OTHER_ADDRESS,
    OTHER_SYSTEM,
    OUR_NUMBER,
    SECOND_STATION,
    TOO_MANY,
)
from outrider_mavlink.run_gateway import RunGateway
from outrider_mavlink.udp import MAX_PEERS, UNREADABLE, Address, Network, parse_address
from sim.scenario.loading import load_scenario
from sim.scene.known import geometry_of
from statuses import PRESENT, a_status, a_truth, a_vehicle

A, F = 6378137.0, 1.0 / 298.257223563
UAV, UGV = 1, 2


def ecef(latitude, longitude, height):
    """Return the earth-centred coordinates [m] of a position on WGS 84."""
    phi, lam = math.radians(latitude), math.radians(longitude)
    e2 = F * (2.0 - F)
    n = A / math.sqrt(1.0 - e2 * math.sin(phi) ** 2)
    return np.array(
        [
            (n + height) * math.cos(phi) * math.cos(lam),
            (n + height) * math.cos(phi) * math.sin(lam),
            (n * (1.0 - e2) + height) * math.sin(phi),
        ]
    )


def enu(origin, position):
    """Return east, north and up of a position in the tangent plane at the origin [m]."""
    phi, lam = math.radians(origin.latitude), math.radians(origin.longitude)
    east = np.array([-math.sin(lam), math.cos(lam), 0.0])
    up = np.array([math.cos(phi) * math.cos(lam), math.cos(phi) * math.sin(lam), math.sin(phi)])
    away = ecef(*position) - ecef(origin.latitude, origin.longitude, origin.altitude)
    return np.array([east @ away, np.cross(up, east) @ away, up @ away])


@settings(max_examples=60, deadline=None)
@given(st.floats(-80, 80), st.floats(-180, 180), st.floats(-500, 9000), *[st.floats(-500, 500)] * 2)
def test_degrees_agree_with_earth_centred_coordinates(latitude, longitude, altitude, east, north):
    origin = Origin(latitude=latitude, longitude=longitude, altitude=altitude)
    found = geodetic(origin, east, north, 12.0)
    # errors of a flat Earth: curvature, converging meridians, and the expansion with height
    far = math.hypot(east, north)
    allowed = far * (far + 12.0) / A * (1.0 + abs(math.tan(math.radians(latitude)))) * 1.02
    assert np.abs(enu(origin, found) - (east, north, 12.0)).max() <= allowed + 1e-6
    assert -180.0 <= found[1] < 180.0


@pytest.mark.parametrize("field", ["latitude=81", "longitude=181", "altitude=1e4", "latitude=nan"])
def test_an_origin_beyond_its_bounds_is_refused(field):
    with pytest.raises(ScenarioError, match=f"origin.{field.split('=')[0]}"):
        load_scenario("escort", overrides=[f"origin.{field}"])


class Station:
    """A ground station: a socket and pymavlink."""

    def __init__(self, gateway, number=255):
        self.gateway = gateway
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.setblocking(False)
        self.port = self.socket.getsockname()[1]
        self.number = number
        self.mav = mavlink.MAVLink(None, srcSystem=number, srcComponent=190)
        self.parser = mavlink.MAVLink(None)

    def send(self, *messages, raw=b""):
        """Send messages, let the gateway process them, and return the replies."""
        for message in messages:
            self.socket.sendto(message.pack(self.mav), self.to)
        if raw:
            self.socket.sendto(raw, self.to)
        self.gateway.turn(0.2)
        return self.arrived()

    def arrived(self):
        found = []
        while True:
            try:
                data = self.socket.recv(2048)
            except BlockingIOError:
                return found
            found += self.parser.parse_buffer(data) or []

    def ask(self, command, *parameters, target=UAV):
        """Return the result of a command."""
        values = (*parameters, *[0.0] * 7)[:7]
        message = mavlink.MAVLink_command_long_message(target, 1, command, 0, *values)
        (ack,) = select(self.send(message), "COMMAND_ACK")
        assert (ack.command, ack.target_system) == (command, self.number)
        return ack.result


def select(messages, kind, system=None):
    return [
        one for one in messages if one.get_type() == kind and system in (None, one.get_srcSystem())
    ]


def texts(messages):
    """Return the texts, each joined from its chunks."""
    parts = {}
    for one in select(messages, "STATUSTEXT"):
        key = (one.get_srcSystem(), one.id or object())
        parts[key] = parts.get(key, "") + one.text
    return list(parts.values())


def truth(distance=3.0):
    here = a_vehicle((10.0, 12.0), (0.3, -0.4), acceleration=(0.1, 0.2))
    there = a_vehicle((10.0, 12.0 - distance), (0.0, 0.2), acceleration=(0.0, 0.05))
    return a_truth(1.0, here, there, distance=distance)


SCENARIO = load_scenario("escort")


def status(**changes):
    fields = {"law": "certified", "drivers": {"ugv_0": "waypoints"}, "certified": {"uav_0": True}}
    fields |= {"geometry": geometry_of(SCENARIO), "vehicles": PRESENT}
    return a_status(**fields | changes)


class Client:
    """A client of an operator or observer that records the calls."""

    def __init__(self, may_steer=True):
        self.may_steer, self.controls, self.driven = may_steer, [], []

    def control(self, control):
        self.controls.append(control)
        return self.may_steer

    def drive(self, vehicle, drive):
        self.driven.append((vehicle, drive))
        return True

    def close(self):
        self.controls.append("closed")


@pytest.fixture(name="run")
def a_run():
    """Yield a gateway that listens, and a ground station that it knows."""
    yield from opened(Client())


@pytest.fixture(name="watched")
def an_observers_run():
    yield from opened(Client(may_steer=False))


def opened(client):
    station = Station(None)
    network = Network([Address("127.0.0.1", station.port)])
    gateway = RunGateway(client, network, status(), first=1, height=10.0)
    gateway.take(status())
    station.gateway = gateway
    gateway.turn(0.0)  # the first message binds its socket
    station.to = ("127.0.0.1", network._links[0].socket.getsockname()[1])
    station.arrived()
    yield SimpleNamespace(gateway=gateway, station=station, client=client)
    network.close()
    station.socket.close()


def second_station(run):
    """Return a second station at the same address, as behind a router of MAVLink."""
    run.station.mav.srcSystem = run.station.number = 254
    return run.station


def test_both_vehicles_are_reported_with_their_true_state(run):
    run.gateway.take(truth())
    run.gateway._timers = RunGateway(
        run.client, run.gateway.network, status(), first=1, height=10.0
    )._timers
    arrived = run.station.send()
    for system in (UAV, UGV):
        numbers = [one.get_seq() for one in arrived if one.get_srcSystem() == system]
        assert len(numbers) > 3
        assert numbers == [(numbers[0] + k) % 256 for k in range(len(numbers))]
    assert {one.type for one in select(arrived, "HEARTBEAT", UAV)} == {mavlink.MAV_TYPE_QUADROTOR}
    assert {one.type for one in select(arrived, "HEARTBEAT", UGV)} == {
        mavlink.MAV_TYPE_GROUND_ROVER
    }
    (local,) = select(arrived, "LOCAL_POSITION_NED", UAV)
    assert (local.x, local.y, local.z) == (12.0, 10.0, -10.0)  # north is y, east is x
    assert (local.vx, local.vy) == pytest.approx((-0.4, 0.3))
    assert local.time_boot_ms == 1000
    (position,) = select(arrived, "GLOBAL_POSITION_INT", UAV)
    latitude, longitude, altitude = geodetic(Origin(), 10.0, 12.0, 10.0)
    assert (position.lat, position.lon) == (round(latitude * 1e7), round(longitude * 1e7))
    assert (position.alt, position.relative_alt) == (round(altitude * 1e3), 10_000)
    assert (position.vx, position.vy) == (-40, 30)
    assert position.hdg == round(math.degrees(math.atan2(0.3, -0.4)) * 100)
    (attitude,) = select(arrived, "ATTITUDE", UAV)
    assert attitude.yaw == pytest.approx(math.atan2(0.3, -0.4))


def test_the_altitude_of_a_uav_is_reported(run):
    here = a_vehicle((10.0, 12.0), altitude=7.5, climb_rate=0.4)
    there = a_vehicle((10.0, 10.0))
    run.gateway.take(a_truth(1.0, here, there, distance=2.0, sight_radius=0.0))
    arrived = run.station.send()
    (local,) = select(arrived, "LOCAL_POSITION_NED", UAV)
    assert (local.z, local.vz) == pytest.approx((-7.5, -0.4))
    (position,) = select(arrived, "GLOBAL_POSITION_INT", UAV)
    _, _, altitude = geodetic(Origin(), 10.0, 12.0, 7.5)
    assert (position.alt, position.relative_alt, position.vz) == (round(altitude * 1e3), 7500, -40)
    (ground,) = select(arrived, "GLOBAL_POSITION_INT", UGV)
    assert ground.relative_alt == 0
    assert "ugv_0 is hidden or too low" in texts(arrived)


def test_the_ugv_alone_can_be_followed(run):
    run.gateway.take(truth())
    ask = mavlink.MAVLINK_MSG_ID_FOLLOW_TARGET
    message = mavlink.MAVLink_command_long_message(0, 0, 512, 0, ask, *[0.0] * 6)
    arrived = run.station.send(message)
    assert {one.get_srcSystem() for one in select(arrived, "FOLLOW_TARGET")} == {UGV}
    followed = select(arrived, "FOLLOW_TARGET")[0]
    latitude, longitude, _ = geodetic(Origin(), 10.0, 9.0)
    assert (followed.lat, followed.lon) == (round(latitude * 1e7), round(longitude * 1e7))
    assert followed.vel == pytest.approx([0.2, 0.0, 0.0])
    assert followed.acc == pytest.approx([0.05, 0.0, 0.0])


def test_lost_sight_and_missing_certificate_are_reported(run, monkeypatch):
    absent = PRESENT | {"uav_0": VehicleStatus(present=False)}
    why = NotCertified.MEASUREMENT_TOO_OLD
    run.gateway.take(
        status(vehicles=absent, certified={"uav_0": False}, uncertified={"uav_0": why})
    )
    run.gateway.take(truth(distance=4.8))
    reported = texts(run.station.arrived())
    assert "uav_0: process disconnected" in reported
    assert f"not certified: {why.text}" in reported
    assert "ugv_0 is out of sight: distance 4.8 m, r_v 4.75 m" in reported
    assert run.gateway.systems[UAV].critical
    run.gateway.take(status())
    run.gateway.take(truth())
    assert texts(run.station.arrived()) == []  # reported only just before
    monkeypatch.setattr("outrider_mavlink.gateway._SETTLE", 0.0)
    run.gateway.take(status())
    run.gateway.take(truth())
    again = ["uav_0: process reconnected", "certified again", "ugv_0 is in sight again"]
    assert texts(run.station.arrived()) == again
    assert not run.gateway.systems[UAV].critical


@pytest.mark.parametrize("length", [1, 49, 50, 51, 99, 100, 101, 500])
def test_a_text_of_any_length_arrives_whole(run, length):
    run.gateway.say(run.gateway.systems[UAV], "x" * length)
    arrived = run.station.arrived()
    assert texts(arrived) == ["x" * length]
    assert length <= 50 or len(select(arrived, "STATUSTEXT")[-1].text) < 50  # which marks the end


def test_each_command_is_answered(run):
    ask = run.station.ask
    assert ask(mavlink.MAV_CMD_NAV_LAND) == mavlink.MAV_RESULT_UNSUPPORTED
    assert ask(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == mavlink.MAV_RESULT_ACCEPTED
    assert ask(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0) == mavlink.MAV_RESULT_DENIED
    assert ask(mavlink.MAV_CMD_DO_SET_MODE, 1.0, 6.0) == mavlink.MAV_RESULT_DENIED  # a UAV
    assert ask(mavlink.MAV_CMD_REQUEST_MESSAGE, math.nan) == mavlink.MAV_RESULT_UNSUPPORTED
    version = float(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    assert ask(mavlink.MAV_CMD_REQUEST_MESSAGE, version) == mavlink.MAV_RESULT_ACCEPTED
    pace = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
    attitude = float(mavlink.MAVLINK_MSG_ID_ATTITUDE)
    assert ask(pace, attitude, 50_000.0) == mavlink.MAV_RESULT_ACCEPTED
    assert ask(pace, attitude, 1.0) == mavlink.MAV_RESULT_DENIED
    assert ask(pace, attitude, math.nan) == mavlink.MAV_RESULT_UNSUPPORTED
    assert run.gateway.refusals.counts[f"command {NOT_SUPPORTED}"] == 3


def test_the_runs_settings_are_parameters(run):
    listed = select(
        run.station.send(mavlink.MAVLink_param_request_list_message(UAV, 1)), "PARAM_VALUE"
    )
    values = {one.param_id: one.param_value for one in listed}
    assert [one.param_index for one in listed] == list(range(listed[0].param_count))
    assert values["VIS_RADIUS"] == 4.75
    assert values["DT"] == pytest.approx(0.05)
    assert values["MAX_SPEED"] == pytest.approx(0.6)
    read = mavlink.MAVLink_param_request_read_message(UGV, 1, b"MAX_SPEED", -1)
    (one,) = select(run.station.send(read), "PARAM_VALUE")
    assert one.param_value == pytest.approx(0.2)
    assert not run.station.send(mavlink.MAVLink_param_request_read_message(UGV, 1, b"NO", -1))[1:]
    assert run.gateway.refusals.counts == {NOT_SUPPORTED: 1}


def set_parameter(name, value):
    return mavlink.MAVLink_param_set_message(UAV, 1, name.encode(), value, 9)


def test_operator_sets_pause_speed_and_law_by_parameters(run):
    (answer,) = select(run.station.send(set_parameter("PAUSED", 1.0)), "PARAM_VALUE")
    assert answer.param_value == 1.0
    run.station.send(set_parameter("RT_FACTOR", 2.0))
    run.station.send(set_parameter("LAW", 0.0))
    actions = [(one.action, one.factor) for one in run.client.controls]
    assert actions == [(Action.PAUSE, None), (Action.SPEED, 2.0), (Action.LAW, None)]


@pytest.mark.parametrize(
    ("name", "value", "cause"),
    [
        ("RT_FACTOR", math.nan, NOT_FINITE),
        ("RT_FACTOR", -1.0, BEYOND_BOUNDS),
        ("LAW", 1.5, BEYOND_BOUNDS),
        ("PAUSED", 0.5, BEYOND_BOUNDS),
        ("VIS_RADIUS", 9.0, NOT_ALLOWED),
        ("NOTHING", 9.0, NOT_SUPPORTED),
    ],
)
def test_invalid_parameter_is_refused_and_reported_unchanged(run, name, value, cause):
    answer = run.station.send(set_parameter(name, value))
    assert run.gateway.refusals.counts == {cause: 1}
    assert run.client.controls == []
    assert any(cause in text for text in texts(answer))
    for one in select(answer, "PARAM_VALUE"):
        assert one.param_value == pytest.approx(
            run.gateway.parameters(run.gateway.systems[UAV])[name]
        )


def sticks(north, east, target=UGV):
    return mavlink.MAVLink_manual_control_message(target, north, east, 0, 0, 0)


def test_sticks_drive_the_ugv_and_first_deflection_takes_control(run):
    run.station.send(sticks(0, 0))
    assert (run.client.controls, run.client.driven) == ([], [])  # the station is only connected
    run.station.send(sticks(500, 0))
    (taken,) = run.client.controls
    assert (taken.action, taken.vehicle, taken.driver) == (Action.DRIVER, "ugv_0", "teleop")
    run.gateway.take(status(drivers={"ugv_0": "teleop"}))
    for north, east, wanted in ((500, 0, (0.0, 0.1)), (0, 1000, (0.2, 0.0)), (0, 0, (0.0, 0.0))):
        run.station.send(sticks(north, east))
        assert run.client.driven[-1][1].velocity == pytest.approx(wanted)
    run.station.send(sticks(1000, -1000))
    assert math.hypot(*run.client.driven[-1][1].velocity) == pytest.approx(0.2)
    run.gateway.close()
    assert run.client.controls[-2].driver == "waypoints"  # the previous driver


def test_a_ugv_that_steers_reports_its_heading_and_is_driven_in_its_own_frame(run):
    west = a_vehicle((10.0, 9.0), (0.1, 0.0), heading=math.pi)  # it reverses east
    run.gateway.take(a_truth(1.0, a_vehicle((10.0, 12.0)), west))
    arrived = run.station.send()
    (attitude,), (position,) = (
        select(arrived, kind, UGV) for kind in ("ATTITUDE", "GLOBAL_POSITION_INT")
    )
    assert (attitude.yaw, position.hdg) == (pytest.approx(-0.5 * math.pi), 27_000)
    geometry = msgspec.structs.replace(status().geometry, max_turn_rates={"ugv_0": 0.8})
    run.gateway.take(status(drivers={"ugv_0": "teleop"}, geometry=geometry))
    run.station.send(sticks(-1000, 500))
    drive = run.client.driven[-1][1]
    assert (drive.velocity, drive.speed, drive.turn_rate) == (None, -0.2, -0.4)


def test_second_ground_station_waits_until_the_first_is_silent(run, monkeypatch):
    run.station.send(sticks(500, 0))
    first = list(run.client.driven)
    second = second_station(run)
    assert any(SECOND_STATION in text for text in texts(second.send(sticks(-900, 0))))
    assert run.client.driven == first
    assert run.gateway.refusals.counts == {SECOND_STATION: 1}
    monkeypatch.setattr("outrider_mavlink.gateway._CONTROL_TIMEOUT", 0.0)
    second.send(sticks(-900, 0))
    assert run.client.driven[-1][1].velocity == pytest.approx((0.0, -0.18))


def test_one_ground_station_too_many_is_refused_and_hears_it(run):
    network = Network(listen=[Address("127.0.0.1", 0)])
    shown, run.gateway.network = run.gateway.network, network
    to = network._links[0].socket.getsockname()
    stations = []
    for k in range(MAX_PEERS + 1):
        stations.append(Station(run.gateway, number=100 + k))
        stations[-1].to = to
    driven = [station.send(sticks(500, 0)) for station in stations][-1]
    assert any("16 ground stations" in text for text in texts(driven))
    assert run.gateway.refusals.counts[TOO_MANY] == 1
    assert run.gateway.received == MAX_PEERS
    for system in (UAV, UGV):
        arm = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
        assert stations[-1].ask(arm, 1.0, target=system) == mavlink.MAV_RESULT_DENIED
        assert stations[0].ask(arm, 1.0, target=system) == mavlink.MAV_RESULT_ACCEPTED
    for station in stations:
        station.socket.close()
    network.close()
    run.gateway.network = shown


def test_services_that_a_run_does_not_have_reply(run):
    files = [1, 0, 3, 10, 0, 0, 0, 0, 4, 0, 0, 0, *[0] * 239]
    asked = {
        "MISSION_ACK": [
            mavlink.MAVLink_mission_count_message(UAV, 1, 3),
            mavlink.MAVLink_mission_request_int_message(UAV, 1, 0),
            mavlink.MAVLink_mission_clear_all_message(UAV, 1),
            mavlink.MAVLink_mission_set_current_message(UAV, 1, 2),
        ],
        "MISSION_COUNT": [mavlink.MAVLink_mission_request_list_message(UAV, 1)],
        "LOG_ENTRY": [mavlink.MAVLink_log_request_list_message(UAV, 1, 0, 9)],
        "LOG_DATA": [mavlink.MAVLink_log_request_data_message(UAV, 1, 5, 90, 90)],
        "FILE_TRANSFER_PROTOCOL": [
            mavlink.MAVLink_file_transfer_protocol_message(0, UAV, 1, files)
        ],
    }
    total = 0
    for reply, requests in asked.items():
        for request in requests:
            (answer,) = select(run.station.send(request), reply)
            total += 1
            if reply == "MISSION_ACK":
                assert answer.type == mavlink.MAV_MISSION_UNSUPPORTED
    assert list(answer.payload[:13]) == [2, 0, 3, 129, 1, 10, 0, 0, 4, 0, 0, 0, 7]
    erased = run.station.send(mavlink.MAVLink_log_erase_message(UAV, 1))
    assert texts(erased) == ["rejected: there are no logs to erase"]
    files[3] = 128  # a reply, which a further reply would never end
    again = run.station.send(mavlink.MAVLink_file_transfer_protocol_message(0, UAV, 1, files))
    assert not select(again, "FILE_TRANSFER_PROTOCOL")
    run.station.send(mavlink.MAVLink_request_data_stream_message(UAV, 1, 0, 4, 1))
    wanted = {f"service {NOT_SUPPORTED}": total + 2, f"message {NOT_SUPPORTED}": 1}
    assert run.gateway.refusals.counts == wanted


def test_what_is_bad_is_counted_by_cause_and_drives_nothing(run):
    run.gateway.reject = counted = Counted(run.gateway)
    send = run.station.send
    send(sticks(2000, 0))
    send(sticks(500, 0, target=7))
    send(sticks(500, 0, target=UAV))
    send(raw=b"not a message")
    good = sticks(500, 0).pack(run.station.mav)
    send(raw=good[:-3])
    send(raw=good[:-1] + bytes([good[-1] ^ 1]))
    run.station.mav.srcSystem = UAV
    send(sticks(500, 0))
    assert counted.causes == [
        BEYOND_BOUNDS,
        OTHER_SYSTEM,
        NOT_ALLOWED,
        UNREADABLE,
        UNREADABLE,
        UNREADABLE,
        OUR_NUMBER,
    ]
    assert run.client.driven == []


class Counted:
    def __init__(self, gateway):
        self.causes, self._refuse = [], gateway.reject

    def __call__(self, cause, what, count=1):
        self.causes += [cause] * count
        self._refuse(cause, what, count)


def frame(number, payload, crc_extra):
    """Return a complete message with this payload."""
    head = struct.pack("<BBBBBBHB", len(payload), 0, 0, 0, 255, 190, number & 0xFFFF, number >> 16)
    crc = mavlink.x25crc(head + payload + bytes([crc_extra])).crc
    return b"\xfd" + head + payload + struct.pack("<H", crc)


def test_no_content_of_any_message_ends_the_gateway(run):
    rng = np.random.default_rng(1)
    for number, kind in mavlink.mavlink_map.items():
        values = list(kind.unpacker.unpack(rng.bytes(kind.unpacker.size)))
        for target in {UAV, UGV} if "target_system" in kind.fieldnames else {0}:
            if target:
                values[sum(kind.lengths[: kind.ordered_fieldnames.index("target_system")])] = target
            payload = kind.unpacker.pack(*values)
            run.station.socket.sendto(frame(number, payload, kind.crc_extra), run.station.to)
        run.gateway.turn(0.01)
    assert run.gateway.received > 200
    assert run.client.driven == []
    assert run.station.ask(mavlink.MAV_CMD_NAV_LAND) == mavlink.MAV_RESULT_UNSUPPORTED


def test_an_observer_only_watches(watched):
    watched.station.send(sticks(500, 0), set_parameter("PAUSED", 1.0))
    assert watched.station.ask(mavlink.MAV_CMD_DO_SET_MODE, 1.0, 1.0, target=UGV) == 2  # denied
    assert watched.gateway.refusals.counts == {NOT_ALLOWED: 3}
    assert (watched.client.controls, watched.client.driven) == ([], [])


@pytest.mark.parametrize(
    "text", ["udpin:127.0.0.1:1", "127.0.0.1", "udpout:h:0", "h:x", "udpout::14550", "tcp:h:1"]
)
def test_an_address_that_is_none_is_named(text):
    with pytest.raises(ScenarioError, match="--to"):
        parse_address(text, listens=False)


def test_messages_of_another_sender_are_not_read(run):
    """The socket of a ground station is reachable for every process of the host, and of the network."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.sendto(sticks(500, 0).pack(run.station.mav), run.station.to)
        run.gateway.turn(0.5)
    assert run.client.driven == []
    assert run.gateway.refusals.counts == {OTHER_ADDRESS: 1}
    run.station.send(sticks(500, 0))
    assert run.client.driven


def test_first_line_names_the_telemetry_target(command):
    def first_line(*options):
        refused = command("mavlink", *options, "--credentials", "nowhere.json")
        assert refused.returncode == 2
        return refused.stderr.splitlines()[0]

    usual = first_line()
    assert "including the truth, to 127.0.0.1:14550: any user's process can listen" in usual
    assert "--private" in usual
    assert "to 127.0.0.1:14999: any" in first_line("--to", "127.0.0.1:14999")
    ports = {first_line("--private").split("127.0.0.1:")[1].split(":")[0] for _ in range(2)}
    assert len(ports) == 2
    assert "14550" not in ports
    assert "truth" not in first_line("--vehicle", "uav_0")


@pytest.mark.parametrize("other", [["--to", "127.0.0.1:14999"], ["--autopilot", "uav_0"]])
def test_a_private_port_goes_with_no_other_target(command, other):
    refused = command("mavlink", "--private", *other)
    assert refused.returncode == 2
    assert "not both" in refused.stderr


def test_role_number_and_charge_of_a_team_are_reported(run):
    geometry = msgspec.structs.replace(status().geometry, endurances={"uav_0": 300.0})
    team = TeamStatus(
        team_certified_share=1.0,
        team_out_of_sight=0,
        charges={"uav_0": 75.0},
        numbers={"uav_0": 31},
    )
    teamed = msgspec.structs.replace(
        status(), geometry=geometry, team=team, roles={"uav_0": Role.GUARD}
    )
    run.gateway._timers = RunGateway(
        run.client, run.gateway.network, status(), first=1, height=10.0
    )._timers
    run.gateway.take(truth())
    run.gateway.take(teamed)
    run.gateway.take(msgspec.structs.replace(teamed, roles={"uav_0": Role.AWAY}))
    arrived = run.station.send()
    named = [(one.name, one.value) for one in select(arrived, "NAMED_VALUE_INT", UAV)]
    assert named == [("ROLE", 3), ("NUMBER", 31), ("ROLE", 4), ("NUMBER", 31)]
    assert "uav_0: away" in [one.text for one in select(arrived, "STATUSTEXT", UAV)]
    (battery,) = select(arrived, "BATTERY_STATUS", UAV)
    assert (battery.battery_remaining, battery.time_remaining) == (25, 75)
    assert not select(arrived, "BATTERY_STATUS", UGV)
