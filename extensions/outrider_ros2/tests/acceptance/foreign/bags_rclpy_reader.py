"""Deserialises all payloads of a bag by the real rclpy; runs in its environment.

Argument: a pickle of name, type and bytes of each payload. Prints JSON.
"""

import importlib
import json
import pickle
import sys
from pathlib import Path

from rclpy.serialization import deserialize_message

read, untried, tracks = 0, set(), {}
for topic, interface, raw in pickle.loads(Path(sys.argv[1]).read_bytes()):  # noqa: S301 - our own data
    package, _, name = interface.split("/")
    try:
        module = importlib.import_module(f"{package}.msg")
    except ImportError:
        untried.add(package)
        continue
    message = deserialize_message(raw, getattr(module, name))
    read += 1
    if topic.endswith("/odom"):
        position, velocity = message.pose.pose.position, message.twist.twist.linear
        numbers = [value.hex() for value in (position.x, position.y, velocity.x, velocity.y)]
        tracks.setdefault(topic.split("/")[1], []).append(numbers)
print(json.dumps({"read": read, "untried": sorted(untried), "odometry": tracks}))
