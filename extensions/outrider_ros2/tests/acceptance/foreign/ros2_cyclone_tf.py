"""Reads and writes a TFMessage by cyclonedds_idl, as rclpy has no wheel of it; runs in pyzeros' environment.

Arguments: files of payloads. Prints a JSON object: the hash of the type, and whether each is written as it was read.
"""

import json
import sys
from dataclasses import dataclass
from pathlib import Path

from ros2_pyterfaces.cyclone.geometry_msgs.msg import TransformStamped
from ros2_pyterfaces.cyclone.idl import IdlStruct, types


@dataclass
class TFMessage(IdlStruct, typename="tf2_msgs/msg/TFMessage"):
    transforms: types.sequence[TransformStamped]


same = {}
for file in sys.argv[1:]:
    raw = Path(file).read_bytes()
    read = TFMessage.deserialize(raw)
    same[Path(file).name] = [len(read.transforms), bytes(read.serialize()) == raw]
print(json.dumps({"hash": TFMessage.hash_rihs01(), "same": same}))
