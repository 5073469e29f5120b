"""A vehicle as MAVLink knows it: a system with a number, and the messages by which it tells of itself.

MAVLink counts north, east and down; the scenario's x is east and its y north.
"""

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

from bus.messages.base import Covariance, Vector
from bus.messages.scenario import Origin
from outrider_mavlink.dialect import MavMessage, mavlink
from outrider_mavlink.geodesy import geodetic

AUTOPILOT = mavlink.MAV_COMP_ID_AUTOPILOT1
_MOVES = 0.01
"""Below this speed a course means nothing [m/s]."""
_CHUNK = 50
"""Bytes of a text in one message."""
_BOOT = 1 << 32
_WORST, _NOTE = mavlink.MAV_SEVERITY_WARNING, mavlink.MAV_SEVERITY_NOTICE


class Mode(NamedTuple):
    """A flight mode; its numbers are those of PX4, by which MAVSDK and ground stations know its name."""

    name: str
    main: int
    sub: int
    base: int

    @property
    def custom(self) -> int:
        """As a heartbeat carries it."""
        return self.main << 16 | self.sub << 24


MISSION = Mode("MISSION", 4, 4, mavlink.MAV_MODE_FLAG_AUTO_ENABLED)
"""A vehicle's own pilot: a UAV's law, a UGV's driver."""
HOLD = Mode("HOLD", 4, 3, mavlink.MAV_MODE_FLAG_AUTO_ENABLED)
"""A UAV stays where it is, as far as the safety filter lets it."""
OFFBOARD = Mode("OFFBOARD", 6, 0, mavlink.MAV_MODE_FLAG_GUIDED_ENABLED)
"""A UAV follows setpoints, as far as the safety filter lets it."""
MANUAL = Mode("MANUAL", 1, 0, mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED)
"""A person holds a UGV's wheel."""


class Moving(NamedTuple):
    """The motion of a vehicle at a moment, in the scenario's coordinates."""

    time: float
    """Simulated [s]."""
    position: Vector
    velocity: Vector
    acceleration: Vector = (0.0, 0.0)
    covariance: Covariance | None = None
    """Of the position, if it is an estimate [m²]."""


def _clipped(value: float) -> int:
    """A whole number that 16 bits hold."""
    return round(max(-32_767.0, min(32_767.0, value)))


def status_texts(text: str, number: int, *, warns: bool) -> Iterator[MavMessage]:
    """Yield the messages of a text for people, as many as it needs.

    Args:
        text: The text.
        number: The text's, 1 to 65535, by which its parts are put together.
        warns: Whether it is a warning.
    """
    data = text.replace("²", "2").encode("ascii", "replace")
    severity = _WORST if warns else _NOTE
    number = number if len(data) > _CHUNK else 0
    last = len(data) // _CHUNK if number else 0  # shorter than a chunk, if need be empty
    for chunk in range(last + 1):
        part = data[chunk * _CHUNK : (chunk + 1) * _CHUNK]
        yield mavlink.MAVLink_statustext_message(severity, part, number, chunk)


class VehicleSystem:
    """A vehicle's system.

    Args:
        name: The vehicle's.
        number: The system's, 1 to 254.
        flies: True for a UAV.
        origin: Where on Earth the scenario's positions are counted from.
        height: Over the ground [m], at which it is told to be: the scenario is flat.
    """

    def __init__(
        self,
        name: str,
        number: int,
        *,
        flies: bool,
        origin: Origin,
        height: float,
    ) -> None:
        self.name, self.number, self.flies = name, number, flies
        self.mode = MISSION
        self.critical = False
        """True if something is wrong with it."""
        self.moving: Moving | None = None
        """None: nothing is known of it yet."""
        self.followed: Moving | None = None
        """Subject of `FOLLOW_TARGET`: a UGV itself, or what a UAV believes of its UGV."""
        self.origin = origin
        self._height = height if flies else 0.0
        self._heading = 0.0  # [rad], from north over east
        self.capabilities = 0
        """Flags of MAVLink's beyond those that all have."""
        self.sender = mavlink.MAVLink(None, srcSystem=number, srcComponent=AUTOPILOT)
        """Numbers its messages."""
        self._texts = 0
        self._always: dict[int, Callable[[], MavMessage]] = {
            mavlink.MAVLINK_MSG_ID_HEARTBEAT: self._heartbeat,
            mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: self._landed,
            mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: self._version,
            mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: self._global_origin,
        }
        self._once_known: dict[int, Callable[[Moving], MavMessage | None]] = {
            mavlink.MAVLINK_MSG_ID_ATTITUDE: self._attitude,
            mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: self._global_position,
            mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: self._local_position,
            mavlink.MAVLINK_MSG_ID_FOLLOW_TARGET: self._follow_target,
            mavlink.MAVLINK_MSG_ID_HOME_POSITION: self._home,
        }

    def move(self, moving: Moving) -> None:
        """Take in where it is."""
        self.moving = moving
        v_x, v_y = moving.velocity
        if math.hypot(v_x, v_y) > _MOVES:
            self._heading = math.atan2(v_x, v_y)

    def build(self, number: int) -> MavMessage | None:
        """The message of this number; None where there is none, or nothing is known to be told yet."""
        if number in self._always:
            return self._always[number]()
        builder = self._once_known.get(number)
        return None if builder is None or self.moving is None else builder(self.moving)

    def knows(self, number: int) -> bool:
        """True if it can tell a message of this number."""
        return number in self._always or number in self._once_known

    def texts(self, text: str, *, warns: bool) -> Iterator[MavMessage]:
        """A text for people, in as many messages as it needs."""
        self._texts = self._texts % 65_535 + 1
        return status_texts(text, self._texts, warns=warns)

    def _heartbeat(self) -> MavMessage:
        flags = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        return mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_QUADROTOR if self.flies else mavlink.MAV_TYPE_GROUND_ROVER,
            mavlink.MAV_AUTOPILOT_GENERIC,
            flags | self.mode.base,
            self.mode.custom,
            mavlink.MAV_STATE_CRITICAL if self.critical else mavlink.MAV_STATE_ACTIVE,
            3,
        )

    def _landed(self) -> MavMessage:
        air, ground = mavlink.MAV_LANDED_STATE_IN_AIR, mavlink.MAV_LANDED_STATE_ON_GROUND
        return mavlink.MAVLink_extended_sys_state_message(0, air if self.flies else ground)

    def _global_origin(self) -> MavMessage:
        return mavlink.MAVLink_gps_global_origin_message(*self._degrees((0.0, 0.0), 0.0))

    def _version(self) -> MavMessage:
        capabilities = (
            mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
            | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
            | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
            | self.capabilities
        )
        nothing = [0] * 8
        return mavlink.MAVLink_autopilot_version_message(
            capabilities, 0, 0, 0, 0, nothing, nothing, nothing, 0, 0, self.number
        )

    def _degrees(self, position: Vector, height: float) -> tuple[int, int, int]:
        """Latitude and longitude [1e-7 deg], altitude [mm]."""
        latitude, longitude, altitude = geodetic(self.origin, *position, height)
        return round(latitude * 1e7), round(longitude * 1e7), round(altitude * 1e3)

    @staticmethod
    def _boot(moving: Moving) -> int:
        return round(moving.time * 1e3) % _BOOT

    def _attitude(self, moving: Moving) -> MavMessage:
        return mavlink.MAVLink_attitude_message(
            self._boot(moving), 0.0, 0.0, self._heading, 0.0, 0.0, 0.0
        )

    def _global_position(self, moving: Moving) -> MavMessage:
        v_x, v_y = moving.velocity
        heading = round(math.degrees(self._heading) * 100.0) % 36_000
        return mavlink.MAVLink_global_position_int_message(
            self._boot(moving),
            *self._degrees(moving.position, self._height),
            round(self._height * 1e3),
            _clipped(v_y * 100.0),
            _clipped(v_x * 100.0),
            0,
            heading,
        )

    def _local_position(self, moving: Moving) -> MavMessage:
        (x, y), (v_x, v_y) = moving.position, moving.velocity
        return mavlink.MAVLink_local_position_ned_message(
            self._boot(moving), y, x, -self._height, v_y, v_x, 0.0
        )

    def _follow_target(self, _moving: Moving) -> MavMessage | None:
        told = self.followed
        if told is None:
            return None
        latitude, longitude, _ = self._degrees(told.position, 0.0)
        (v_x, v_y), (u_x, u_y) = told.velocity, told.acceleration
        variances = (0.0, 0.0, 0.0)
        capabilities = 0b111  # position, velocity and acceleration
        if told.covariance is not None:
            variances = (told.covariance[2], told.covariance[0], 0.0)
            capabilities = 0b001
        return mavlink.MAVLink_follow_target_message(
            self._boot(told),
            capabilities,
            latitude,
            longitude,
            self.origin.altitude,
            (v_y, v_x, 0.0),
            (u_y, u_x, 0.0),
            (1.0, 0.0, 0.0, 0.0),
            (0.0, 0.0, 0.0),
            variances,
            0,
        )

    def _home(self, _moving: Moving) -> MavMessage:
        """Home is the scenario's origin."""
        return mavlink.MAVLink_home_position_message(
            *self._degrees((0.0, 0.0), 0.0), 0.0, 0.0, 0.0, (1.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0
        )
