"""Work of `outrider ros2 --vehicle`: a vehicle that a node controls."""

import time

import typer

from outrider.cli.console import ERR, print_json
from outrider.cli.joining import Joining
from outrider.cli.stopping import stop_on_signals
from outrider_ros2.ros_node import RosNode
from outrider_ros2.ros_pilot import RosPilot


def fly(joining: Joining, *, domain: int, json: bool) -> None:
    """Wait for a node that controls the vehicle, then fly the vehicle with it."""
    name = joining.party.name
    with joining.session() as session:
        node = RosNode(session, domain=domain, name="outrider", namespace=f"/{name}")
        pilot = RosPilot(node, joining.party)
        with stop_on_signals() as stop:
            if not pilot.connected:
                ERR.tell(f"waiting for a ROS 2 node that subscribes to /{name}/pilot/observation")
            while not pilot.connected and not stop:
                time.sleep(0.05)
        if stop:
            raise typer.Exit(stop.exit_code)
        try:
            sent = joining.fly(pilot.make)
        finally:
            pilot.close()
            node.close()
    found = {"vehicle": name, "commands": sent, "refused": dict(pilot.refusals.counts)}
    if json:
        print_json(found)
    else:
        ERR.tell(f"{name}: {sent} commands from a ROS 2 node")
