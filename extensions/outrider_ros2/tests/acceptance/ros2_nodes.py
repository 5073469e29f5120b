"""`outrider ros2` with third-party libraries: zenoh-ros2-sdk, pyzeros, and the real rclpy.

They live in environments of their own, `.venv-ros2` and `.venv-ros2-rclpy`, which the first call creates:
make bridge-test ARGS=ros2
"""

import contextlib
import json
import os
import re
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import zenoh
from bridge_checks import Row, environment, free_port, output, outrider, report, started

from bus.access import client_settings
from bus.credentials import read_credential
from outrider.running.flying import fly
from outrider_ros2.interfaces import encode, make, type_hash
from outrider_ros2.ros_commands import TWISTS
from outrider_ros2.topics import TOPICS, wire_topic
from sim.scenario.loading import load_scenario
from sim.scene.known import scene_of

FOREIGN = Path(__file__).resolve().parent / "foreign"

OTHERS = ("zenoh-ros2-sdk==0.1.8", "pyzeros==0.1.0")
RCLPY = (
    "ros-rclpy==9.1.2", "ros-rmw-fastrtps-cpp==9.3.3", "ros-std-msgs", "ros-std-srvs", "ros-geometry-msgs",
    "ros-nav-msgs", "ros-sensor-msgs", "ros-visualization-msgs", "ros-diagnostic-msgs",
)  # fmt: skip
DOMAIN = 7
SCENARIO = "rescue-town"
"""Scenario with a message on every topic: with buildings, an altitude and hazards."""
SCENE = scene_of(load_scenario(SCENARIO))
EXPECTED = {name: row for row in TOPICS for _, name in row.names(SCENE)}
REPOSITORIES = {
    "rcl_interfaces": ("builtin_interfaces", "rosgraph_msgs", "service_msgs"),
    "common_interfaces": (
        "std_msgs", "geometry_msgs", "sensor_msgs", "nav_msgs", "diagnostic_msgs", "visualization_msgs",
    ),
    "geometry2": ("tf2_msgs",),
}  # fmt: skip


class Run:
    """A run of processes with credentials, and its bridge."""

    def __init__(self, stack: ExitStack, folder: Path, *simulated: object) -> None:
        self.folder, self.port = folder, free_port()
        self.endpoint = f"tcp/127.0.0.1:{self.port}"
        keys = ("credentials", folder / "keys", "--scenario", simulated[0], "--roles", "ros2")
        output(*outrider(*keys))
        self._stack = stack
        self.simulator = self.start(
            "simulator", "simulator", *simulated, "--listen", self.endpoint,
            "--credentials", self.key("router"), "--json",
        )  # fmt: skip
        limit = time.monotonic() + 60.0
        while time.monotonic() < limit:
            with (
                contextlib.suppress(OSError),
                socket.create_connection(("127.0.0.1", self.port), 1.0),
            ):
                break
            time.sleep(0.1)

    def key(self, name: str) -> Path:
        """Return the credentials file of a party."""
        return self.folder / "keys" / f"{name}.json"

    def start_program(self, name: str, *words: object) -> "subprocess.Popen[str]":
        """Start a program."""
        return self._stack.enter_context(started(self.folder / f"{name}.log", words))

    def start(self, name: str, *words: object) -> "subprocess.Popen[str]":
        """Start an outrider command."""
        return self.start_program(name, *outrider(*words))

    def join(self, name: str, party: str, *words: object) -> "subprocess.Popen[str]":
        """Start an outrider command with a party's credentials."""
        return self.start(
            name, *words, "--connect", self.endpoint, "--credentials", self.key(party)
        )

    def node(self, party: str) -> zenoh.Session:
        """Open a ROS 2 node of our own."""
        config = zenoh.Config()
        settings = {"mode": "client", "connect/endpoints": [self.endpoint]}
        for path, value in (settings | client_settings(read_credential(self.key(party)))).items():
            config.insert_json5(path, json.dumps(value))
        return self._stack.enter_context(zenoh.open(config))

    def settings(self, party: str) -> dict[str, str]:
        """Return the environment variables of a foreign node: for rmw_zenoh, and the domain."""
        known = read_credential(self.key(party))
        own = {"user": known.name, "password": known.password}
        config = {
            "mode": "client",
            "connect": {"endpoints": [self.endpoint]},
            "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
            "transport": {"auth": {"usrpwd": own}},
        }
        file = self.folder / f"{party}.json5"
        file.write_text(json.dumps(config))
        return {**os.environ, "ZENOH_SESSION_CONFIG_URI": str(file), "ROS_DOMAIN_ID": str(DOMAIN),
                "ZENOH_ROS2_SDK_CACHE": str(self.folder / "definitions")}  # fmt: skip

    def json_of(self, name: str) -> dict[str, Any]:
        """Return the final output of a process."""
        found: dict[str, Any] = json.loads((self.folder / f"{name}.out").read_text())
        return found


def definitions(share: Path, cache: Path) -> None:
    """Copy the message definitions that zenoh-ros2-sdk would clone from GitHub from rclpy's wheels."""
    for name, packages in REPOSITORIES.items():
        folder = cache / name
        for package in packages:
            if package == "tf2_msgs":  # rclpy has no wheel of it
                (folder / package / "msg").mkdir(parents=True)
                definition = "geometry_msgs/TransformStamped[] transforms\n"
                (folder / package / "msg" / "TFMessage.msg").write_text(definition)
            else:
                shutil.copytree(share / package / "msg", folder / package / "msg")
        git = ["git", "-C", folder, "-c", "user.name=x", "-c", "user.email=x"]
        for words in (["init", "-q", "-b", "jazzy"], ["add", "-A"], ["commit", "-q", "-m", "x"]):
            output(*git, *words)


def listed(run: Run, sdk: Path) -> Iterator[Row]:
    """Check that the command line of zenoh-ros2-sdk lists and describes all topics."""
    tool = [sdk / "zenoh-ros2", "--router", f"127.0.0.1:{run.port}", "--no-daemon", "--timeout", 2]
    settings = run.settings("ros2_observer")
    limit, shown = time.monotonic() + 60.0, ""
    wanted = {f"{name} [{row.interface}]" for name, row in EXPECTED.items()}
    while time.monotonic() < limit and not wanted <= set(shown.splitlines()):
        shown = output(*tool, "topic", "list", "-t", env=settings)
    found = wanted & set(shown.splitlines())
    yield Row(
        "zenoh-ros2 topic list -t",
        f"{len(found)} of {len(wanted)} topics, with their types",
        found == wanted,
    )
    described = 0
    for name, row in EXPECTED.items():
        described_topic = output(*tool, "topic", "info", "-v", name, env=settings)
        described += (
            type_hash(row.interface) in described_topic
            and f"QoS: {row.qos.encoded()}" in described_topic
        )
    yield Row(
        "zenoh-ros2 topic info -v", f"{described} with type, hash and QoS", described == len(wanted)
    )


def echoed(run: Run, sdk: Path) -> Iterator[Row]:
    """Check that zenoh-ros2-sdk decodes all topics and calls services."""
    kinds = json.dumps({name: (row.interface, row.qos.encoded()) for name, row in EXPECTED.items()})
    words = (FOREIGN / "ros2_sdk_echo.py", run.port, DOMAIN, kinds)
    printed = output(sdk / "python", *words, env=run.settings("ros2_operator"))
    found = json.loads(printed.splitlines()[-1])
    missing = sorted(set(EXPECTED) - set(found["came"]))
    yield Row(
        "zenoh-ros2-sdk echoes", f"{len(found['came'])} topics, missing: {missing}", not missing
    )
    good = all(answer and answer[0] for answer in found["calls"].values())
    yield Row("zenoh-ros2-sdk calls /pause and /step", found["calls"], good)


def driven(run: Run, sdk: Path) -> Iterator[Row]:
    """Check that pyzeros drives the UGV and reads its odometry."""
    words = (FOREIGN / "ros2_pyzeros_driver.py", 0.1)
    printed = output(sdk / "python", *words, env=run.settings("ros2_operator"))
    found = json.loads(printed.splitlines()[-1])
    yield Row(
        "pyzeros drives the UGV at 0.1 m/s east", f"odometry says {found['now']}", found["reached"]
    )
    printed = output(sdk / "python", "-c", _ROGUE, env=run.settings("uav_0"))
    found = json.loads(printed.splitlines()[-1])
    yield Row(
        "pyzeros with uav_0's credentials reads the truth",
        found,
        not any(found.values()),
    )


_ROGUE = """
import asyncio, json, pyzeros
from ros2_pyterfaces.cydr.nav_msgs.msg import Odometry
import asyncio_for_robotics as afor
@afor.scoped
async def main():
    names = ("/ugv_0/odom", "/uav_0/odom")
    subs = {name: pyzeros.Sub(Odometry, name) for name in names}
    found = {}
    for name, sub in subs.items():
        try:
            await asyncio.wait_for(sub.wait_for_value(), 3.0)
            found[name] = True
        except asyncio.TimeoutError:
            found[name] = False
    print(json.dumps(found))
with pyzeros.auto_context(node="rogue"):
    asyncio.run(main())
"""


def captured(run: Run, folder: Path) -> list[dict[str, str]]:
    """Capture one payload of each topic."""
    folder.mkdir()
    node, came = run.node("ros2_observer"), {}
    kept = []
    for name, row in EXPECTED.items():
        key = wire_topic(row.interface, name).key(DOMAIN)
        if row.qos.transient_local:
            history = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1)
            kept.append(zenoh.ext.declare_advanced_subscriber(
                node, key, lambda sample, name=name: came.update({name: sample}), history=history))  # fmt: skip
        else:
            kept.append(
                node.declare_subscriber(key, lambda sample, name=name: came.update({name: sample}))
            )
    limit = time.monotonic() + 30.0
    while set(came) != set(EXPECTED) and time.monotonic() < limit:
        time.sleep(0.1)
    for one in kept:
        one.undeclare()
    index = []
    for name, sample in sorted(came.items()):
        file = f"{re.sub('/', '_', name)}.bin"
        (folder / file).write_bytes(sample.payload.to_bytes())
        kind = EXPECTED[name].interface
        index.append({"name": name, "type": kind, "hash": type_hash(kind), "file": file})
    (folder / "index.json").write_text(json.dumps(index))
    return index


def same_bytes(run: Run, sdk: Path, rclpy: Path) -> Iterator[Row]:
    """Check that the real rclpy reads all payloads, writes the same bytes, and has the same hashes."""
    index = captured(run, run.folder / "payloads")
    program = FOREIGN / "ros2_rclpy_bytes.py"
    rows = json.loads(output(rclpy / "python", program, run.folder / "payloads"))
    messages = [row for row in rows if "file" in row and row["tried"]]
    untried = sorted({row["type"] for row in rows if not row["tried"]})
    padding = sum(row["padding"] for row in messages)
    differ = [
        f"{row['name']} {row['bytes']} -> {row['again']}" for row in messages if not row["same"]
    ]
    yield Row("rclpy reads and writes the same bytes",
              f"{len(messages)} of {len(index)} payloads but for {padding} bytes of padding; "
              f"no wheel: {untried}; differ: {differ}",
              not differ and len(messages) == len(EXPECTED) - 2)  # fmt: skip
    files = [run.folder / "payloads" / row["file"] for row in rows if not row["tried"]]
    transforms = json.loads(output(sdk / "python", FOREIGN / "ros2_cyclone_tf.py", *files))
    good = transforms["hash"] == type_hash("tf2_msgs/msg/TFMessage") and all(
        same for _, same in transforms["same"].values()
    )
    yield Row(
        "cyclonedds_idl reads and writes the transforms",
        transforms["same"],
        good and len(transforms["same"]) == len(files) == 2,
    )
    wrong = [row["type"] for row in messages if not row["hashes"]]
    wrong += [
        row["service"]
        for row in rows
        if "service" in row and type_hash(row["service"]) != row["hash"]
    ]
    yield Row("rclpy's type hashes are ours", f"wrong: {wrong}", not wrong)


def in_real_time(folder: Path, sdk: Path, rclpy: Path | None) -> Iterator[Row]:
    """Check a run in real time from other programs: listing, echoing, driving, calling."""
    with ExitStack() as stack:
        output(*outrider("run", SCENARIO, "--in-process", "--duration", 1, "--no-files"))  # compile
        # The UGV waits at its start to be driven.
        still = ("--set", "ugv.0.driver=teleop")
        run = Run(stack, folder, SCENARIO, *still, "--realtime", "1", "--duration", "900")
        if rclpy is not None:
            definitions(rclpy.parent / "share", folder / "definitions")
        run.join("uav", "uav_0", "uav")
        run.join("ugv", "ugv_0", "ugv")
        bridge = run.join("bridge", "operator", "ros2", "--operator", "--domain", DOMAIN, "--json")
        yield from listed(run, sdk)
        if rclpy is not None:
            yield from echoed(run, sdk)
            yield from same_bytes(run, sdk, rclpy)
        yield from driven(run, sdk)
        bridge.terminate()
        bridge.wait(15.0)
        result = run.json_of("bridge")
        yield Row("the bridge ends in order", f"{result['commands']} commands, refused: {result['refused']}",
                  result["commands"] > 0 and not result["router_lost"])  # fmt: skip


def flown_by_nodes(folder: Path) -> Iterator[Row]:
    """Fly both vehicles with ROS 2 nodes, in lockstep and in real time, while another node sends nonsense to the
    bridge.
    """
    scenario, secret = load_scenario("escort", overrides=["duration=20.0"]), "5" * 32
    _, here = fly(scenario, scenario.seed, secret=secret)
    (folder / "clock").mkdir()
    summary, result, sent = _by_nodes(folder, secret)
    same = summary["trajectory_sha256"] == here.trajectory_sha256
    rate = summary["ticks_per_second"]
    yield Row("UAV (JSON) and UGV (AccelStamped) flown by ROS 2 nodes over processes, lockstep",
              f"{summary['trajectory_sha256'][:16]}, {rate:.0f} ticks/s", same)  # fmt: skip
    yield Row(
        "nonsense on cmd_vel meanwhile",
        f"refused: {result['refused']}",
        len(result["refused"]) >= 3,
    )
    yield Row("commands of the nodes", sent, sent == [summary["ticks"]] * 2)
    summary, _, sent = _by_nodes(folder / "clock", secret, "--realtime", "2")
    share = min(sent) / summary["ticks"]
    yield Row(
        "the same at twice real time", f"{100.0 * share:.1f} % of the ticks answered", share > 0.9
    )


def _by_nodes(
    folder: Path, secret: str, *pace: str
) -> tuple[dict[str, Any], dict[str, Any], list[int]]:
    """Return the final output of simulator and bridge, and the number of commands of each node."""
    zero = make("geometry_msgs/msg/Vector3", x=9.0, y=float("nan"), z=0.0)
    twist = encode(TWISTS[1], make(TWISTS[1], linear=zero, angular=zero))
    bad = [(wire_topic(TWISTS[1], name).key(domain), payload)
           for name in ("/ugv_0/cmd_vel", "/uav_0/cmd_vel")
           for domain in (DOMAIN, DOMAIN + 1)
           for payload in (twist, twist[:9])]  # fmt: skip
    with ExitStack() as stack:
        run = Run(stack, folder, "escort", "--duration", "20", "--secret", secret, *pace)
        bridge = run.join("bridge", "operator", "ros2", "--operator", "--domain", DOMAIN, "--json")
        links = [run.join(name, name, "ros2", "--vehicle", name, "--domain", DOMAIN, "--json")
                 for name in ("uav_0", "ugv_0")]  # fmt: skip
        flood = run.node("ros2_operator")
        for name, form in (("uav_0", "exact"), ("ugv_0", "accel")):
            words = [
                sys.executable,
                FOREIGN / "ros2_pilot_node.py",
                run.endpoint,
                run.key(name),
                DOMAIN,
                form,
            ]
            stack.enter_context(started(folder / f"node_{name}.log", words))
        while run.simulator.poll() is None:
            for key, payload in bad:
                flood.put(key, payload)
            time.sleep(0.01)
        for process in (bridge, *links):
            process.wait(20.0)
        sent = [run.json_of(name)["commands"] for name in ("uav_0", "ugv_0")]
        return run.json_of("simulator"), run.json_of("bridge"), sent


def findings(folder: Path) -> Iterator[Row]:
    """Run all checks."""
    sdk = environment("ros2", OTHERS)
    python = shutil.which("python3.11")
    rclpy = None if python is None else environment("ros2-rclpy", RCLPY, python)
    if rclpy is None:
        yield Row("rclpy", "not tried: its wheels need Python 3.11", True)
    for name, part in (
        ("real", lambda where: in_real_time(where, sdk, rclpy)),
        ("lock", flown_by_nodes),
    ):
        (folder / name).mkdir()
        yield from part(folder / name)


if __name__ == "__main__":
    # in a folder of its own, as pyzeros writes its cache to the working directory
    sys.exit(report(findings, __doc__))
