"""A UGV that needs only Zenoh and JSON, as in any language: it drives a circle.

Start `outrider simulator escort --realtime 1` and `outrider uav` in two terminals, and this file in a third.
"""

import json
import math

import zenoh

config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", '["tcp/127.0.0.1:17447"]')
# With credentials: transport/auth/usrpwd/user and .../password, from ugv_0.json.
with zenoh.open(config) as session:
    root = "outrider/flight/ugv_0"
    observations = session.declare_subscriber(f"{root}/observation", zenoh.handlers.RingChannel(16))
    commands = session.declare_publisher(f"{root}/command")
    alive = session.liveliness().declare_token(f"{root}/alive/0")
    for sample in observations:
        observation = json.loads(sample.payload.to_bytes())
        if observation.get("over"):
            break
        target = [
            0.2 * math.cos(0.1 * observation["time"]),
            0.2 * math.sin(0.1 * observation["time"]),
        ]
        # at most 0.4 (0.2 - 0) m/s², below the UGV's bound of 0.1 m/s²
        acceleration = [0.4 * (w - v) for w, v in zip(target, observation["velocity"], strict=True)]
        commands.put(json.dumps({"tick": observation["tick"], "acceleration": acceleration}))
