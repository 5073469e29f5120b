"""Diagnostics of a run as ROS 2 messages: run, links, processes and certificates."""

from collections.abc import Iterable, Mapping

import msgspec

from bus.messages.base import Message
from bus.messages.links import LinkStatus
from bus.messages.telemetry import Status, VehicleStatus
from outrider_ros2.conversion import header
from outrider_ros2.interfaces import RosMessage, make

OK, WARN, ERROR = range(3)
"""Levels of `diagnostic_msgs`."""
_MAX_AGE, _MAX_LOSS = 1.0, 0.05
"""Age of the newest message [s] and share of lost messages beyond which a link gets a warning."""


def _fields(message: Message, *names: str) -> dict[str, object]:
    """Return some fields of a message, by name."""
    return {name: getattr(message, name) for name in names}


def _text(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    return "-" if value is None else str(value)


def diagnostic(
    name: str, values: Mapping[str, object], *, level: int = OK, message: str = "ok"
) -> RosMessage:
    """Return the diagnostic status of one part of the run.

    Args:
        name: Name of the part.
        values: Values, by name.
        level: OK, WARN or ERROR.
        message: Short summary.
    """
    return make(
        "diagnostic_msgs/msg/DiagnosticStatus",
        level=level,
        name=f"outrider: {name}",
        message=message,
        hardware_id="outrider",
        values=[
            make("diagnostic_msgs/msg/KeyValue", key=key, value=_text(value))
            for key, value in values.items()
        ],
    )


def _run_diagnostic(status: Status) -> RosMessage:
    warnings = (*status.warnings, *(one.text for one in status.rejections[-1:]))
    state = "over" if status.over else "paused" if status.paused else "running"
    pace = ("realtime_factor", "target_factor", "late_ticks")
    return diagnostic(
        "run",
        _fields(status, "scenario", "seed", "tick", "ticks", "law", *pace)
        | {f"driver of {name}": driver for name, driver in status.drivers.items()},
        level=WARN if warnings else OK,
        message="; ".join((state, *warnings)),
    )


def _link_diagnostic(name: str, link: LinkStatus) -> RosMessage:
    ratio = link.delivery_ratio
    bad = ratio is not None and ratio < 1.0 - _MAX_LOSS
    problems = ["message loss"] if bad else []
    if link.age is not None and link.age > _MAX_AGE:
        problems.append(f"newest message is {link.age:.1f} s old")
    counts, ages = ("sent", "delivered", "queued", "in_transit"), ("age", "mean_age", "max_age")
    return diagnostic(
        f"link {name}",
        _fields(link, *counts, "delivery_ratio", *ages)
        | {f"lost: {cause}": count for cause, count in link.lost.items()},
        level=WARN if problems else OK,
        message=", ".join(problems) or "ok",
    )


def _vehicle_diagnostic(name: str, vehicle: VehicleStatus, *, over: bool) -> RosMessage:
    disconnected = not vehicle.present and not over
    faulty = bool(vehicle.missing_commands or vehicle.rejected or vehicle.last_fault)
    faults = ("missing_commands", "stale_commands", "shortened_commands", "lost", "rejoined")
    return diagnostic(
        f"vehicle {name}",
        _fields(vehicle, "present", *faults)
        | {f"rejected: {cause}": count for cause, count in vehicle.rejected.items()},
        level=ERROR if disconnected else WARN if faulty else OK,
        message="process disconnected" if disconnected else vehicle.last_fault or "ok",
    )


def diagnostics(status: Status, own: Iterable[RosMessage] = ()) -> RosMessage:
    """Return the diagnostics of run, links, vehicle processes and certificates.

    Args:
        status: Status of the run.
        own: Further diagnostic statuses.
    """
    found = [_run_diagnostic(status)]
    found += [
        diagnostic(
            f"certificate {name}",
            {"certified": certified},
            level=OK if certified else WARN,
            message="visibility is certified"
            if certified
            else f"not certified: {status.uncertified[name].text}",
        )
        for name, certified in status.certified.items()
    ]
    if status.team is not None:
        counts = msgspec.structs.asdict(status.team)
        members = {name: counts.pop(name) for name in ("charges", "numbers")}
        broken = status.team.team_certified_while_lost or status.team.team_certificate_broken
        found.append(diagnostic("team", counts, level=ERROR if broken else OK))
        found += [
            diagnostic(
                f"team member {name}",
                {"role": role.value}
                | {key: values[name] for key, values in members.items() if name in values},
            )
            for name, role in status.roles.items()
        ]
    if status.mission is not None:
        mission, hits = msgspec.structs.asdict(status.mission), status.mission.hazards_hit
        of_ugvs = mission.pop("guarantees")
        found.append(diagnostic("mission", mission, level=WARN if hits else OK))
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
