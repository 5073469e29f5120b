"""A stand-in for an autopilot, for `mavlink_programs.py`: MAVSDK's server communicates, a short loop flies."""

import json
import signal
import sys
import time

from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.action_server import ActionServer
from mavsdk.plugins.mavlink_direct_server import MavlinkDirectServer
from mavsdk.plugins.telemetry_server import (
    PositionNed,
    PositionVelocityNed,
    TelemetryServer,
    VelocityNed,
)

START = (5.0, -2.0, -15.0)
"""Initial hover position: north, east, down [m]."""
STEP = 0.02
"""Time step of the loop [s]."""


class Loop:
    """A mass that is pulled to its setpoint, north and east."""

    def __init__(self):
        self.position, self.velocity = list(START[:2]), [0.0, 0.0]
        self.wanted = (list(START[:2]), [0.0, 0.0], [0.0, 0.0])
        self.count = 0

    def receive(self, message, _data):
        """Store a setpoint."""
        setpoint = json.loads(message.fields_json)
        self.wanted = (
            [setpoint["x"], setpoint["y"]],
            [setpoint["vx"], setpoint["vy"]],
            [setpoint["afx"], setpoint["afy"]],
        )
        self.count += 1

    def step(self, dt):
        """Simulate a time step [s]."""
        p, v, u = self.wanted
        for k in range(2):
            pull = u[k] + 4.0 * (p[k] - self.position[k]) + 4.0 * (v[k] - self.velocity[k])
            self.velocity[k] += pull * dt
            self.position[k] += self.velocity[k] * dt


def main(address):
    """Hover and track setpoints until SIGTERM."""
    ended = []
    signal.signal(signal.SIGTERM, lambda *_: ended.append(True))
    configuration = Configuration.create_with_component_type(ComponentType.AUTOPILOT)
    with Mavsdk(configuration) as sdk:
        sdk.add_any_connection(address)
        server = sdk.server_component_by_type(ComponentType.AUTOPILOT)
        action, telemetry = ActionServer(server), TelemetryServer(server)
        direct, loop = MavlinkDirectServer(server), Loop()
        action.set_armed_state(True)
        direct.subscribe_message("SET_POSITION_TARGET_LOCAL_NED", loop.receive)
        last = time.monotonic()
        while not ended:
            time.sleep(STEP)
            now = time.monotonic()
            loop.step(now - last)
            last = now
            (north, east), (v_north, v_east) = loop.position, loop.velocity
            telemetry.publish_position_velocity_ned(
                PositionVelocityNed(
                    PositionNed(north, east, START[2]), VelocityNed(v_north, v_east, 0.0)
                )
            )
        print(json.dumps({"setpoints": loop.count, "position": loop.position}))


if __name__ == "__main__":
    main(*sys.argv[1:])
