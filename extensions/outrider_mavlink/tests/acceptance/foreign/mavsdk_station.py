"""A ground station by MAVSDK, for `mavlink_programs.py`: watches a run, flies its UAV, and prints its findings."""

import json
import math
import sys
import time

from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.action import Action, ActionError
from mavsdk.plugins.manual_control import ManualControl
from mavsdk.plugins.offboard import AccelerationNed, Offboard, VelocityNedYaw
from mavsdk.plugins.param import Param, ParamError
from mavsdk.plugins.telemetry import Telemetry

R_V = 4.75
HOLD, MISSION, OFFBOARD = 3, 4, 7
ROWS = []


def row(what, value, holds):
    """Record a finding."""
    ROWS.append({"what": what, "value": str(value), "holds": bool(holds)})


def systems(sdk, count, patience=20.0):
    """Return the systems by number, as soon as there are `count`."""
    limit = time.monotonic() + patience
    while time.monotonic() < limit:
        found = {one.get_system_id(): one for one in sdk.get_systems() if one.has_autopilot()}
        if len(found) >= count:
            return found
        time.sleep(0.1)
    raise SystemExit(f"MAVSDK found {sdk.system_count()} of {count} systems")


class Watcher:
    """Tracks the reported positions of both vehicles."""

    def __init__(self, uav, ugv):
        self.uav, self.ugv = Telemetry(uav), Telemetry(ugv)
        self.positions = {"uav": None, "ugv": None}
        self.largest, self.count = 0.0, 0
        for name, one in (("uav", self.uav), ("ugv", self.ugv)):
            one.subscribe_position_velocity_ned(
                lambda report, _data, name=name: self.see(name, report)
            )

    def see(self, name, report):
        """Record a position."""
        self.positions[name] = (report.position.east_m, report.position.north_m)
        self.count += 1
        if None not in self.positions.values():
            self.largest = max(self.largest, math.dist(*self.positions.values()))

    @property
    def distance(self):
        """Return the current distance of the vehicles [m]."""
        return math.dist(*self.positions.values())


def refused(function, *arguments):
    """Return the error of a call, or an empty string if it succeeds."""
    try:
        function(*arguments)
    except (ActionError, ParamError) as error:
        return str(error)
    return ""


def watch(sdk):
    """Check the telemetry of both vehicles, as for an observer or operator."""
    found = systems(sdk, 2)
    row("MAVSDK discovers both vehicles", sorted(found), sorted(found) == [1, 2])
    watcher = Watcher(found[1], found[2])
    time.sleep(2.0)
    kinds = {number: one.vehicle_type().name for number, one in found.items()}
    row("as what they are", kinds, kinds == {1: "MULTICOPTER", 2: "ROVER"})
    row("telemetry in 2 s", f"{watcher.count} positions", watcher.count >= 20)
    place, home = watcher.uav.position(), watcher.uav.home()
    east, north = watcher.positions["uav"]
    # one degree of a meridian, and of the circle of latitude, by the series for WGS 84
    phi = math.radians(home.latitude_deg)
    meridian = 111132.954 - 559.822 * math.cos(2 * phi) + 1.175 * math.cos(4 * phi)
    circle = 111412.84 * math.cos(phi) - 93.5 * math.cos(3 * phi) + 0.118 * math.cos(5 * phi)
    off = math.hypot(
        (place.latitude_deg - home.latitude_deg) * meridian - north,
        (place.longitude_deg - home.longitude_deg) * circle - east,
    )
    row("degrees agree with metres", f"{off:.3f} m off", off < 0.3)  # from two different times
    states = watcher.uav.in_air(), watcher.ugv.in_air(), watcher.uav.armed()
    row("UAV in the air, UGV on the ground, armed", states, states == (True, False, True))
    parameters = Param(found[1])
    value = parameters.get_param_float("VIS_RADIUS")
    row("reads the parameter VIS_RADIUS", value, value == R_V)
    listed = len(parameters.get_all_params().float_params)
    row("lists all parameters", listed, listed >= 10)
    refused(parameters.set_param_float, "VIS_RADIUS", 9.0)
    value = parameters.get_param_float("VIS_RADIUS")
    row("and cannot set it", value, value == R_V)
    parameters.set_param_float("RT_FACTOR", 3.0)
    time.sleep(0.5)
    value = parameters.get_param_float("RT_FACTOR")
    row("sets RT_FACTOR as an operator", value, value == 3.0)
    parameters.set_param_float("RT_FACTOR", 2.0)
    return found, watcher


def drive(ugv, watcher):
    """Drive the UGV by the sticks for some seconds."""
    sticks = ManualControl(ugv)
    for _ in range(60):
        sticks.set_manual_control_input(1.0, 0.0, 0.0, 0.0)
        time.sleep(0.05)
    speed = watcher.ugv.velocity_ned()
    going = speed.north_m_s > 0.15 and abs(speed.east_m_s) < 0.05
    row("sticks drive the UGV north", f"{speed.north_m_s:.2f} m/s", going)
    time.sleep(2.0)
    speed = watcher.ugv.velocity_ned()
    row("and without them it brakes", f"{speed.north_m_s:.2f} m/s", abs(speed.north_m_s) < 0.02)


def fly(sdk, watcher):
    """Fly the UAV by offboard setpoints."""
    (uav,) = systems(sdk, 1).values()
    telemetry, offboard, action, texts = Telemetry(uav), Offboard(uav), Action(uav), []
    telemetry.subscribe_status_text(lambda report, _data: texts.append(report.text))
    time.sleep(1.0)
    row("before: the law flies", telemetry.flight_mode(), telemetry.flight_mode() == MISSION)
    row("arms", refused(action.arm) or "accepted", not refused(action.arm))
    why = refused(action.disarm)
    row("does not disarm in the air", why.split("(")[0], why)
    why = refused(action.land)
    row("does not land: not supported", why.split("(")[0], why)
    offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, 0.0))
    offboard.start()
    time.sleep(1.5)
    row("offboard starts", telemetry.flight_mode(), telemetry.flight_mode() == OFFBOARD)
    east, _ = watcher.positions["uav"]
    offset = (0.0, -0.6) if east < watcher.positions["ugv"][0] else (0.0, 0.6)
    fastest = 0.0
    offboard.set_velocity_ned(VelocityNedYaw(*offset, 0.0, 0.0))
    for _ in range(100):
        time.sleep(0.1)
        fastest = max(fastest, abs(telemetry.velocity_ned().east_m_s))
    row("flies away by velocity", f"up to {fastest:.2f} m/s", fastest > 0.5)
    row("is stopped", f"at {watcher.distance:.2f} m", 3.0 < watcher.distance < R_V)
    reported = [text for text in texts if "safety filter acts" in text]
    row("with its reason", reported[:1], reported)
    offboard.set_acceleration_ned(AccelerationNed(0.0, math.copysign(0.3, offset[1]), 0.0))
    time.sleep(5.0)
    row("nor by acceleration", f"{watcher.distance:.2f} m", 3.0 < watcher.distance < R_V)
    texts.clear()
    offboard.set_velocity_ned(VelocityNedYaw(0.0, 6.0, 0.0, 0.0))
    time.sleep(1.5)
    reported = [text for text in texts if "beyond the bounds" in text]
    row("6 m/s is refused", reported[:1], reported)
    reported = [text for text in texts if "the run's law flies" in text]
    row("and the law flies", reported[:1], reported)
    offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, 0.0))
    time.sleep(0.5)
    offboard.stop()
    time.sleep(1.5)
    row("stop: hold", telemetry.flight_mode(), telemetry.flight_mode() == HOLD)


def main(watched, flown):
    """Watch at one address, fly at the other."""
    as_station = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    with Mavsdk(as_station) as observer, Mavsdk(as_station) as pilot:
        observer.add_any_connection(watched)
        pilot.add_any_connection(flown)
        found, watcher = watch(observer)
        fly(pilot, watcher)
        drive(found[2], watcher)
        near = watcher.largest < R_V
        row("r_v = 4.75 m is kept throughout", f"at most {watcher.largest:.2f} m", near)
        print(json.dumps(ROWS))


if __name__ == "__main__":
    main(*sys.argv[1:])
