"""UGVs that steer, driven along a path by a ROS 2 node: a run of processes with credentials, in real time.

The node stands in for Nav2's regulated pure pursuit controller (tests/path_follower.py): make bridge-test ARGS=paths
"""

import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

from bridge_checks import Row, report
from ros2_nodes import DOMAIN, Run

FOLLOWER = Path(__file__).resolve().parents[1] / "path_follower.py"
FAST = (
    "ugv.0.driver=teleop", "ugv.0.heading=0.0", "ugv.0.max_speed=0.5", "ugv.0.max_acceleration=0.5",
    "uav.0.max_speed=1.5", "uav.0.max_acceleration=1.0", "duration=60.0",
)  # fmt: skip
KINDS = {
    "a differential drive": ("corner", "ugv.0.kinematics=differential", "ugv.0.track=0.4"),
    "an Ackermann vehicle": ("curve", "ugv.0.kinematics=ackermann", "ugv.0.max_curvature=1.5"),
}


def followed(folder: Path, kind: str) -> Iterator[Row]:
    """Check that a node leads a UGV along a path, without a rejected command, in sight of the UAV."""
    path, *kinematics = KINDS[kind]
    changes = [word for change in (*FAST, *kinematics) for word in ("--set", change)]
    with ExitStack() as stack:
        run = Run(stack, folder, "escort", *changes, "--realtime", "1")
        run.join("uav", "uav_0", "uav")
        run.join("ugv", "ugv_0", "ugv")
        bridge = run.join("bridge", "operator", "ros2", "--operator", "--domain", DOMAIN, "--json")
        words = (run.endpoint, run.key("ros2_operator"), DOMAIN, "ugv_0", path)
        node = run.start_program("node", sys.executable, FOLLOWER, *words)
        node.wait(600.0)
        run.simulator.wait(600.0)
        bridge.wait(30.0)
        found, result, summary = map(run.json_of, ("node", "bridge", "simulator"))
    yield Row(f"a node follows a path with {kind}", found, found["arrived"])
    sideways = found["sideways"]
    yield Row("its velocity is along its heading", f"{sideways:.1e} m/s aside", sideways < 1e-9)
    commands = f"{result['commands']} commands, refused: {result['refused']}"
    yield Row("no command is refused", commands, result["commands"] > 50 and not result["refused"])
    lost, distance = summary["visibility_violations"], summary["max_distance"]
    yield Row("the UAV keeps it in sight", f"within {distance:.2f} m, {lost} ticks lost", not lost)


def findings(folder: Path) -> Iterator[Row]:
    """Run all checks."""
    for kind in KINDS:
        place = folder / kind.split()[1].lower()
        place.mkdir()
        yield from followed(place, kind)


if __name__ == "__main__":
    sys.exit(report(findings, __doc__))
