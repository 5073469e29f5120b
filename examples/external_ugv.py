"""UGV that drives a circle with plain Zenoh and JSON, as any language could.

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
    mine = "outrider/flight/ugv_0"
    observations = session.declare_subscriber(f"{mine}/observation", zenoh.handlers.RingChannel(16))
    commands = session.declare_publisher(f"{mine}/command")
    here = session.liveliness().declare_token(f"{mine}/alive/0")
    for sample in observations:
        observation = json.loads(sample.payload.to_bytes())
        if observation.get("over"):
            break
        wanted = [
            0.2 * math.cos(0.1 * observation["time"]),
            0.2 * math.sin(0.1 * observation["time"]),
        ]
        push = [w - v for w, v in zip(wanted, observation["velocity"], strict=True)]
        commands.put(json.dumps({"tick": observation["tick"], "acceleration": push}))
