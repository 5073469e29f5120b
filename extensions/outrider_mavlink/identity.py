"""MAVLink system of a vehicle: its number and its telemetry messages.

MAVLink uses north, east and down; in the scenario, x is east and y is north.
"""

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

from bus.geodesy import geodetic
from bus.messages.base import Covariance, Vector
from bus.messages.scenario import Origin
from bus.messages.team import Role
from outrider_mavlink.dialect import MavMessage, mavlink

AUTOPILOT = mavlink.MAV_COMP_ID_AUTOPILOT1
_MIN_COURSE_SPEED = 0.01
"""Minimum speed for a defined course [m/s]."""
_CHUNK = 50
"""Number of text bytes in one message."""
_BOOT = 1 << 32
_LARGEST = 2**31 - 1
"""Largest named value."""
_NO_CELL, _NO_TEMPERATURE = 65_535, 32_767
"""Values of an unknown voltage and temperature."""
_WORST, _NOTE = mavlink.MAV_SEVERITY_WARNING, mavlink.MAV_SEVERITY_NOTICE


class Mode(NamedTuple):
    """Flight mode, with the numbers of PX4 that MAVSDK and ground stations recognize."""

    name: str
    main: int
    sub: int
    base: int

    @property
    def custom(self) -> int:
        """Mode number in a heartbeat."""
        return self.main << 16 | self.sub << 24


MISSION = Mode("MISSION", 4, 4, mavlink.MAV_MODE_FLAG_AUTO_ENABLED)
"""Mode of a UAV controlled by the law, or of a UGV controlled by its driver."""
HOLD = Mode("HOLD", 4, 3, mavlink.MAV_MODE_FLAG_AUTO_ENABLED)
"""Mode of a UAV that holds its position, inside the safety filter."""
OFFBOARD = Mode("OFFBOARD", 6, 0, mavlink.MAV_MODE_FLAG_GUIDED_ENABLED)
"""Mode of a UAV that tracks setpoints, inside the safety filter."""
MANUAL = Mode("MANUAL", 1, 0, mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED)
"""Mode of a UGV controlled by an operator."""


class Moving(NamedTuple):
    """State of a vehicle at one time, in scenario coordinates."""

    time: float
    """Simulated time [s]."""
    position: Vector
    velocity: Vector
    acceleration: Vector = (0.0, 0.0)
    covariance: Covariance | None = None
    """Covariance of the position, if it is an estimate [m²]."""
    altitude: float | None = None
    """Altitude above the ground [m]; None: the vehicle moves in the plane."""
    climb_rate: float = 0.0
    """Climb rate [m/s]."""
    heading: float | None = None
    """Heading of a UGV that steers [rad], from east to north; None: the vehicle moves in any direction."""


def _clipped(value: float) -> int:
    """Return a value rounded and clipped to 16 bits."""
    return round(max(-32_767.0, min(32_767.0, value)))


def status_texts(text: str, number: int, *, warns: bool) -> Iterator[MavMessage]:
    """Yield the STATUSTEXT messages of a text.

    Args:
        text: Text for the user.
        number: Number of the text, 1 to 65535, that identifies its parts.
        warns: True for a warning, False for a notice.
    """
    data = text.replace("²", "2").encode("ascii", "replace")
    severity = _WORST if warns else _NOTE
    number = number if len(data) > _CHUNK else 0
    last = len(data) // _CHUNK if number else 0  # the last chunk is shorter, possibly empty
    for chunk in range(last + 1):
        part = data[chunk * _CHUNK : (chunk + 1) * _CHUNK]
        yield mavlink.MAVLink_statustext_message(severity, part, number, chunk)


class TeamState(NamedTuple):
    """State of a UAV in its team."""

    role: Role | None = None
    """Its role; None: unknown."""
    number: int = 0
    """Its stored number; 0: it has never guarded."""
    charge: float | None = None
    """Flight time left [s]; None: unlimited."""
    endurance: float | None = None
    """Flight time with a full charge [s]; None: unlimited."""


class VehicleSystem:
    """MAVLink system of a vehicle.

    Args:
        name: Name of the vehicle.
        number: Number of the system, 1 to 254.
        flies: True for a UAV.
        origin: Geodetic position of the scenario's origin.
        height: Height in the telemetry of a UAV without an altitude [m].
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
        """True if the vehicle has a critical problem."""
        self.moving: Moving | None = None
        """State of the vehicle; None: unknown so far."""
        self.followed: Moving | None = None
        """Target in `FOLLOW_TARGET`: a UGV itself, or a UAV's estimate of its UGV."""
        self.origin = origin
        self.team: TeamState | None = None
        """State in its team; None: it has none."""
        self._flat_height = height if flies else 0.0
        self._heading = 0.0  # or the course of a point [rad], from north over east
        self.capabilities = 0
        """MAVLink capability flags beyond the common ones."""
        self.sender = mavlink.MAVLink(None, srcSystem=number, srcComponent=AUTOPILOT)
        """Packer that numbers the messages."""
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
        self._in_team: dict[int, Callable[[TeamState], MavMessage | None]] = {
            mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: self._battery,
        }

    def move(self, moving: Moving) -> None:
        """Update the motion of the vehicle."""
        self.moving = moving
        v_x, v_y = moving.velocity
        if moving.heading is not None:
            self._heading = math.remainder(0.5 * math.pi - moving.heading, math.tau)
        elif math.hypot(v_x, v_y) > _MIN_COURSE_SPEED:
            self._heading = math.atan2(v_x, v_y)

    def build(self, number: int) -> MavMessage | None:
        """Return the message with this number; None if it is unsupported or its content still unknown."""
        if number in self._always:
            return self._always[number]()
        in_team = self._in_team.get(number)
        if in_team is not None:
            return None if self.team is None else in_team(self.team)
        builder = self._once_known.get(number)
        return None if builder is None or self.moving is None else builder(self.moving)

    def knows(self, number: int) -> bool:
        """Return True if the message with this number is supported."""
        return number in self._always or number in self._once_known or number in self._in_team

    def texts(self, text: str, *, warns: bool) -> Iterator[MavMessage]:
        """Yield the STATUSTEXT messages of a text."""
        self._texts = self._texts % 65_535 + 1
        return status_texts(text, self._texts, warns=warns)

    def values(self) -> Iterator[MavMessage]:
        """Yield role and number of a UAV in a team as named values: `ROLE`, from 1 as in `Role`, and `NUMBER`."""
        if self.team is None or self.moving is None:
            return
        role = 0 if self.team.role is None else 1 + list(Role).index(self.team.role)
        for name, value in ((b"ROLE", role), (b"NUMBER", min(self.team.number, _LARGEST))):
            yield mavlink.MAVLink_named_value_int_message(self._boot(self.moving), name, value)

    def _battery(self, team: TeamState) -> MavMessage | None:
        """Return the charge; None: the flight time is unlimited."""
        if team.charge is None or team.endurance is None:
            return None
        unknown = [_NO_CELL] * 10
        return mavlink.MAVLink_battery_status_message(
            0,
            mavlink.MAV_BATTERY_FUNCTION_ALL,
            mavlink.MAV_BATTERY_TYPE_UNKNOWN,
            _NO_TEMPERATURE,
            unknown,
            -1,
            -1,
            -1,
            round(100.0 * team.charge / team.endurance),
            round(team.charge),
            mavlink.MAV_BATTERY_CHARGE_STATE_OK,
        )

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
        """Return latitude and longitude [1e-7 deg] and altitude [mm]."""
        latitude, longitude, altitude = geodetic(self.origin, *position, height)
        return round(latitude * 1e7), round(longitude * 1e7), round(altitude * 1e3)

    def _height(self, moving: Moving) -> float:
        """Return the height above the ground [m]."""
        return self._flat_height if moving.altitude is None else moving.altitude

    @staticmethod
    def _boot(moving: Moving) -> int:
        return round(moving.time * 1e3) % _BOOT

    def _attitude(self, moving: Moving) -> MavMessage:
        return mavlink.MAVLink_attitude_message(
            self._boot(moving), 0.0, 0.0, self._heading, 0.0, 0.0, 0.0
        )

    def _global_position(self, moving: Moving) -> MavMessage:
        (v_x, v_y), height = moving.velocity, self._height(moving)
        heading = round(math.degrees(self._heading) * 100.0) % 36_000
        return mavlink.MAVLink_global_position_int_message(
            self._boot(moving),
            *self._degrees(moving.position, height),
            round(height * 1e3),
            _clipped(v_y * 100.0),
            _clipped(v_x * 100.0),
            _clipped(-moving.climb_rate * 100.0),
            heading,
        )

    def _local_position(self, moving: Moving) -> MavMessage:
        (x, y), (v_x, v_y) = moving.position, moving.velocity
        return mavlink.MAVLink_local_position_ned_message(
            self._boot(moving), y, x, -self._height(moving), v_y, v_x, 0.0 - moving.climb_rate
        )

    def _follow_target(self, _moving: Moving) -> MavMessage | None:
        target = self.followed
        if target is None:
            return None
        latitude, longitude, _ = self._degrees(target.position, 0.0)
        (v_x, v_y), (u_x, u_y) = target.velocity, target.acceleration
        variances = (0.0, 0.0, 0.0)
        capabilities = 0b111  # position, velocity and acceleration
        if target.covariance is not None:
            variances = (target.covariance[2], target.covariance[0], 0.0)
            capabilities = 0b001
        return mavlink.MAVLink_follow_target_message(
            self._boot(target),
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
        """Return the scenario's origin as home position."""
        return mavlink.MAVLink_home_position_message(
            *self._degrees((0.0, 0.0), 0.0), 0.0, 0.0, 0.0, (1.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0
        )
