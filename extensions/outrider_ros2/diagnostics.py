"""Diagnostics of a run as ROS 2 messages: the run, its links, its processes and its certificates."""

from collections.abc import Iterable, Mapping

import msgspec

from bus.messages.base import Message
from bus.messages.links import LinkStatus
from bus.messages.telemetry import Status, VehicleStatus
from outrider_ros2.conversion import header
from outrider_ros2.interfaces import RosMessage, make

OK, WARN, ERROR = range(3)
"""Levels of `diagnostic_msgs`."""
_LATE, _MISSING_SHARE = 1.0, 0.05
"""A link is warned of whose newest message is older [s], or that loses a larger share."""


def _fields(message: Message, *names: str) -> dict[str, object]:
    """Some fields of one of our messages, by their names."""
    return {name: getattr(message, name) for name in names}


def _told(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    return "-" if value is None else str(value)


def diagnostic(
    name: str, values: Mapping[str, object], *, level: int = OK, message: str = "ok"
) -> RosMessage:
    """The state of one part of the run.

    Args:
        name: Of the part.
        values: Numbers and words, by name.
        level: One of OK, WARN and ERROR.
        message: In a few words.
    """
    return make(
        "diagnostic_msgs/msg/DiagnosticStatus",
        level=level,
        name=f"outrider: {name}",
        message=message,
        hardware_id="outrider",
        values=[
            make("diagnostic_msgs/msg/KeyValue", key=key, value=_told(value))
            for key, value in values.items()
        ],
    )


def _run_diagnostic(status: Status) -> RosMessage:
    warnings = (*status.warnings, *status.refusals[-1:])
    words = "over" if status.over else "paused" if status.paused else "flying"
    pace = ("realtime_factor", "target_factor", "late_ticks")
    return diagnostic(
        "run",
        _fields(status, "scenario", "seed", "tick", "ticks", "law", *pace)
        | {f"driver of {name}": driver for name, driver in status.drivers.items()},
        level=WARN if warnings else OK,
        message="; ".join((words, *warnings)),
    )


def _link_diagnostic(name: str, link: LinkStatus) -> RosMessage:
    ratio = link.delivery_ratio
    bad = ratio is not None and ratio < 1.0 - _MISSING_SHARE
    words = ["loses messages"] if bad else []
    if link.age is not None and link.age > _LATE:
        words.append(f"its newest is {link.age:.1f} s old")
    counts, ages = ("sent", "delivered", "queued", "in_transit"), ("age", "mean_age", "max_age")
    return diagnostic(
        f"link {name}",
        _fields(link, *counts, "delivery_ratio", *ages)
        | {f"lost: {cause}": count for cause, count in link.lost.items()},
        level=WARN if words else OK,
        message=", ".join(words) or "ok",
    )


def _vehicle_diagnostic(name: str, vehicle: VehicleStatus, *, over: bool) -> RosMessage:
    gone = not vehicle.present and not over
    faulty = bool(vehicle.missing_commands or vehicle.rejected or vehicle.last_fault)
    faults = ("missing_commands", "stale_commands", "shortened_commands", "lost", "rejoined")
    return diagnostic(
        f"vehicle {name}",
        _fields(vehicle, "present", *faults)
        | {f"refused: {cause}": count for cause, count in vehicle.rejected.items()},
        level=ERROR if gone else WARN if faulty else OK,
        message="its process is away" if gone else vehicle.last_fault or "ok",
    )


def diagnostics(status: Status, own: Iterable[RosMessage] = ()) -> RosMessage:
    """The run, its links, its vehicles' processes, and what is certified or why it is not.

    Args:
        status: What the simulator tells.
        own: More of them.
    """
    found = [_run_diagnostic(status)]
    found += [
        diagnostic(
            f"certificate {name}",
            {"certified": certified},
            level=OK if certified else WARN,
            message="sight is certified to be kept"
            if certified
            else f"not certified: {status.uncertified[name].text}",
        )
        for name, certified in status.certified.items()
    ]
    if status.mission is not None:
        told, hits = msgspec.structs.asdict(status.mission), status.mission.hazards_hit
        of_ugvs = told.pop("guarantees")
        found.append(diagnostic("mission", told, level=WARN if hits else OK))
        found += [
            diagnostic(
                f"known ground {name}",
                msgspec.structs.asdict(one),
                level=WARN if one.certificate_broken else OK,
            )
            for name, one in of_ugvs.items()
        ]
    found += [
        _vehicle_diagnostic(name, vehicle, over=status.over)
        for name, vehicle in status.vehicles.items()
    ]
    found += [_link_diagnostic(name, link) for name, link in status.links.items()]
    return make(
        "diagnostic_msgs/msg/DiagnosticArray",
        header=header(status.time, ""),
        status=[*found, *own],
    )
