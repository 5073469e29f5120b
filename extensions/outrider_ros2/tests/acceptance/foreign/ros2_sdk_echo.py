"""Echoes topics and calls services by zenoh-ros2-sdk; runs in that library's environment.

Arguments: port of the router, domain, and a JSON object of topics with type and QoS. Prints a JSON object.
"""

import json
import os
import sys
import time

from zenoh_ros2_sdk import ROS2ServiceClient, ROS2Subscriber

port, domain, wanted = int(sys.argv[1]), int(sys.argv[2]), json.loads(sys.argv[3])
where = {"router_ip": "127.0.0.1", "router_port": port, "domain_id": domain}
came: dict[str, str] = {}
readers = [
    ROS2Subscriber(
        topic=name,
        msg_type=kind,
        qos=qos,
        callback=lambda message, name=name: came.setdefault(name, repr(message)[:200]),
        **where,
    )
    for name, (kind, qos) in wanted.items()
]
limit = time.monotonic() + 30.0
while len(came) < len(wanted) and time.monotonic() < limit:
    time.sleep(0.1)
calls = {}
for name, request, fields in (
    ("SetBool", "bool data", {"data": True}),
    (
        "Trigger",
        "uint8 structure_needs_at_least_one_member",
        {"structure_needs_at_least_one_member": 0},
    ),
    ("SetBool", "bool data", {"data": False}),
):
    client = ROS2ServiceClient(
        service_name="/pause" if name == "SetBool" else "/step",
        srv_type=f"std_srvs/srv/{name}",
        request_definition=request,
        response_definition="bool success\nstring message",
        **where,
    )
    answer = client.call(**fields)
    calls[f"{name} {fields}"] = None if answer is None else [answer.success, answer.message]
    client.close()
print(json.dumps({"came": came, "calls": calls}), flush=True)
os._exit(0)  # the library never closes its session, which would keep the interpreter alive
