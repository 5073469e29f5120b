"""Drives a UGV and reads its odometry by pyzeros; runs in that library's environment.

Arguments: speed east [m/s]. The session's configuration is in ZENOH_SESSION_CONFIG_URI, the domain in ROS_DOMAIN_ID.
Prints a JSON object: velocities read before and during the drive.
"""

import asyncio
import json
import sys
import time

import asyncio_for_robotics as afor
import pyzeros
from ros2_pyterfaces.cydr.geometry_msgs.msg import TwistStamped
from ros2_pyterfaces.cydr.nav_msgs.msg import Odometry

SPEED = float(sys.argv[1])


@afor.scoped
async def main() -> None:
    odometry = pyzeros.Sub(Odometry, "/ugv_0/odom")
    driver = pyzeros.Pub(TwistStamped, "/ugv_0/cmd_vel")
    # Reading and writing a first message of a type compiles code, for a minute on a busy machine.
    first = await asyncio.wait_for(odometry.wait_for_value(), 300.0)
    twist = TwistStamped()
    driver.publish(twist)
    twist.twist.linear.x = SPEED

    async def drive() -> None:
        while True:  # a UGV brakes if its next velocity is late, as while the odometry is awaited
            driver.publish(twist)
            await asyncio.sleep(0.05)

    driving = asyncio.create_task(drive())
    limit, reached, last = time.monotonic() + 30.0, False, first
    while time.monotonic() < limit and not reached:
        last = await asyncio.wait_for(odometry.wait_for_value(), 5.0)
        v = last.twist.twist.linear
        reached = abs(v.x - SPEED) < 0.02 and abs(v.y) < 0.02
    driving.cancel()
    before, now = first.twist.twist.linear, last.twist.twist.linear
    found = {
        "before": [float(before.x), float(before.y)],
        "now": [float(now.x), float(now.y)],
        "frame": last.child_frame_id.decode(),
        "reached": bool(reached),
    }
    print(json.dumps(found), flush=True)


with pyzeros.auto_context(node="driver"):
    asyncio.run(main())
