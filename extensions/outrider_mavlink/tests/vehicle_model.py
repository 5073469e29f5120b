"""An autopilot over UDP with a small vehicle model: a mass with drag, limited thrust, a delay, and wind.

It stands in for PX4 or ArduPilot: python extensions/outrider_mavlink/tests/vehicle_model.py 127.0.0.1:14540

It reports HEARTBEAT and LOCAL_POSITION_NED, and tracks SET_POSITION_TARGET_LOCAL_NED until SIGTERM.
"""

import argparse
import json
import math
import random
import select
import signal
import socket
import sys
import time
from collections import deque

from pymavlink.dialects.v20 import common as mavlink

HOVER = (7.0, -3.0, -12.0)
"""Hover position in the autopilot's local frame: north, east, down [m]."""
STEP = 0.01
"""Time step of the model [s]."""
POSITION_GAIN, VELOCITY_GAIN = 2.0, 3.0
"""Gains of the controller [1/s]."""
THRUST_LIMIT = 3.0
"""Largest horizontal acceleration by thrust [m/s²]."""
THRUST_LAG = 0.15
"""Time constant of the thrust [s]."""
SETPOINT_DELAY = 0.05
"""Time until a setpoint reaches the controller [s]."""
DRAG = 0.35
"""Deceleration by drag per speed through the air [1/s]."""
GUST_TIME = 3.0
"""Correlation time of a gust [s]."""


class VehicleModel:
    """Second-order model of a multirotor, north and east; its height follows the setpoint.

    A controller of position and velocity with feed-forward commands the thrust, which follows with a lag. The wind is a
    mean velocity of the air with gusts.

    Args:
        wind: Mean velocity of the air, north and east [m/s].
        gust: Standard deviation of the gusts per axis [m/s].
        seed: Seed of the gusts.
    """

    def __init__(self, wind=(0.0, 0.0), gust=0.0, seed=0):
        self.wind, self.gust = wind, gust
        self.position, self.down = list(HOVER[:2]), HOVER[2]
        self.velocity, self.thrust, self._gust = [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]
        self.time = 0.0
        self._random = random.Random(seed)
        self._steps = 0
        self._setpoints = deque()
        self._wanted = (HOVER[:2], (0.0, 0.0), (0.0, 0.0), HOVER[2])

    def command(self, message):
        """Receive a setpoint."""
        wanted = (
            (message.x, message.y),
            (message.vx, message.vy),
            (message.afx, message.afy),
            message.z,
        )
        self._setpoints.append((self.time, wanted))

    def advance(self, to):
        """Simulate up to a time [s]."""
        while self.time < to - 0.5 * STEP:
            self._step()

    def _step(self):
        while self._setpoints and self._setpoints[0][0] <= self.time - SETPOINT_DELAY + 1e-9:
            _, self._wanted = self._setpoints.popleft()
        p, v, u, self.down = self._wanted
        commanded = [
            u[k]
            + VELOCITY_GAIN * (v[k] + POSITION_GAIN * (p[k] - self.position[k]) - self.velocity[k])
            for k in range(2)
        ]
        share = min(1.0, THRUST_LIMIT / max(math.hypot(*commanded), THRUST_LIMIT))
        kept = math.exp(-STEP / GUST_TIME)
        for k in range(2):
            fresh = self._random.gauss(0.0, self.gust) if self.gust else 0.0
            self._gust[k] = kept * self._gust[k] + math.sqrt(1.0 - kept * kept) * fresh
            self.thrust[k] += (share * commanded[k] - self.thrust[k]) * STEP / THRUST_LAG
            air = self.velocity[k] - self.wind[k] - self._gust[k]
            self.velocity[k] += (self.thrust[k] - DRAG * air) * STEP
            self.position[k] += self.velocity[k] * STEP
        self._steps += 1
        self.time = self._steps * STEP


def heartbeat(*, armed=True):
    """Return the heartbeat of a multirotor."""
    flags = mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
    return mavlink.MAVLink_heartbeat_message(2, mavlink.MAV_AUTOPILOT_PX4, flags, 0, 4, 3)


def position_report(boot, position, velocity):
    """Return the telemetry at a time on the autopilot's clock [ms]."""
    return mavlink.MAVLink_local_position_ned_message(boot % (1 << 32), *position, *velocity, 0.0)


def fly(address, model):
    """Fly in real time until SIGTERM; return the number of setpoints."""
    ended, count, begin, due, beat = [], 0, time.monotonic(), 0.0, 0.0
    signal.signal(signal.SIGTERM, lambda *_: ended.append(True))
    link = mavlink.MAVLink(None, srcSystem=42, srcComponent=1)
    link.robust_parsing = True
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    opened.bind(("127.0.0.1", 0))
    while not ended:
        ready, _, _ = select.select([opened], [], [], STEP)
        model.advance(time.monotonic() - begin)
        for message in (link.parse_buffer(opened.recv(2048)) if ready else None) or ():
            if message.get_type() == "SET_POSITION_TARGET_LOCAL_NED":
                model.command(message)
                count += 1
        if model.time >= beat:
            beat += 1.0
            opened.sendto(heartbeat().pack(link), address)
        if model.time >= due:
            due = max(due + 0.02, model.time)
            place = (*model.position, model.down)
            report = position_report(round(model.time * 1e3), place, model.velocity)
            opened.sendto(report.pack(link), address)
    return count


def main():
    """Fly the model for a run, and print the number of setpoints."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("address", help="HOST:PORT of --in")
    parser.add_argument("--wind", type=float, nargs=2, default=(0.0, 0.0), metavar=("N", "E"))
    parser.add_argument("--gust", type=float, default=0.0)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    host, _, port = asked.address.partition(":")
    model = VehicleModel(tuple(asked.wind), asked.gust, asked.seed)
    sys.stdout.write(json.dumps({"setpoints": fly((host, int(port)), model)}) + "\n")


if __name__ == "__main__":
    main()
