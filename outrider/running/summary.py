"""The numbers that sum up a flight."""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from bus.messages.control import Action, Change
from bus.messages.decision import NotCertified
from bus.messages.links import LinkStatus
from bus.messages.telemetry import CertificateStatus, MissionResult, VehicleStatus

if TYPE_CHECKING:
    from sim.server.flight import Flight


class Process(msgspec.Struct, frozen=True, kw_only=True):
    """One operating-system process of a run."""

    name: str
    pid: int


class UavMetrics(msgspec.Struct, frozen=True, kw_only=True):
    """Metrics of one UAV or of several, as `outrider.running.metrics.UAV` explains; None: it does not exist."""

    max_distance: float | None
    mean_distance: float | None
    visibility_violations: int
    switching_radius: float | None
    crossings: int
    initial_error: float | None
    mean_error: float | None
    final_error: float | None
    detections: int
    estimate_rmse: float | None
    detection_rmse: float | None
    certified_share: float | None = None
    overridden_share: float | None = None


class Summary(UavMetrics, frozen=True, kw_only=True):
    """Numbers that `outrider run --json` prints; those of UAVs are over all of them.

    `outrider.running.metrics` explains each number. Without a UAV there are no distances and errors, without hazards no
    mission, and nothing is counted: a number that does not exist is None.
    """

    scenario: str
    seed: int
    secret: str = ""
    """Of the run, for its owner alone: with the seed it gives the same flight again.

    Empty: none, and the seed alone does.
    """
    law: str | None
    """The scenario's; `external` where a program of the user's own flew, which reports no estimate.

    None without a UAV.
    """
    dt: float
    """Length of a tick [s]."""
    ticks: int
    complete: bool
    ticks_per_second: float
    visibility_radius: float
    missing_commands: dict[str, int]
    """Ticks without a new command, by vehicle."""
    faults: dict[str, dict[str, int]] = {}
    """Faults of a vehicle's process, counted by cause; empty without a fault."""
    uncertified: dict[NotCertified, int] = {}
    """Ticks that were not certified, by reason."""
    certified_while_lost: int = 0
    certificate_broken: int = 0
    max_command_interval: float | None = None
    longest_command_interval: float | None = None
    max_tracking_error: float | None = None
    largest_tracking_error: float | None = None
    mission: MissionResult | None = None
    """Mission of the UGVs; None where there are no hazards."""
    uavs: dict[str, UavMetrics] = {}
    """Metrics of each UAV."""
    links: dict[str, LinkStatus] = {}
    """Metrics of each link, by `vehicle/kind`."""
    traces: dict[str, str] = {}
    """Recorded links that were played: SHA-256 of the file, by the name in the scenario."""
    realtime: float | None = None
    """The factor that the clock was to keep; None in lockstep."""
    realtime_factor: float
    late_ticks: int = 0
    changes: list[Change] = []
    """Changes by operators while it flew, with their ticks."""
    deterministic: bool
    first_missing_tick: int | None
    """The first tick at which a vehicle had no new command."""
    trajectory_sha256: str
    platform: dict[str, str]
    processes: list[Process] = []


_FLOWN = (Action.LAW, Action.DRIVER, Action.LINK)
"""Actions of operators that change a trajectory."""


def _rms(errors: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> float | None:
    squares = (errors**2).sum(axis=-1)
    found = squares[~np.isnan(squares)]
    return math.sqrt(float(found.mean())) if found.size else None


def _mean(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> float | None:
    return float(values.mean()) if values.size else None


def switching_radius_of(flight: "Flight", escort: int = 0) -> float | None:
    """r_s of (18) [m] for one escort; None where it has no finite value."""
    from sim.models.vehicles import raw_switching_radius  # noqa: PLC0415 - compiled: whoever only reads summaries goes without

    world = flight.world
    a, g = world.escorts[escort]
    uav, ugv = world.vehicles[a], world.vehicles[g]
    r_s: float = raw_switching_radius(
        world.parameters.r_v,
        float(uav["max_speed"]),
        float(ugv["max_speed"]),
        float(uav["max_acceleration"]),
    )
    return r_s if math.isfinite(r_s) else None


def _faults(
    vehicles: Mapping[str, VehicleStatus], shortened: Mapping[str, int]
) -> dict[str, dict[str, int]]:
    """All that went wrong, by vehicle and cause, without the zeros."""
    found: dict[str, dict[str, int]] = {}
    for name, count in shortened.items():
        status = vehicles.get(name, VehicleStatus(present=True))
        counts = {
            "command beyond its bound": count,
            "lost": status.lost,
            "joined again": status.rejoined,
            "no new command": status.missing_commands,
            "late command used": status.stale_commands,
            **status.rejected,
        }
        if any(counts.values()):
            found[name] = {cause: count for cause, count in counts.items() if count}
    return found


def certificate_fields(told: CertificateStatus | None) -> dict[str, Any]:
    """The summary's fields on what safety filters have certified, from their counts; None where none has watched."""
    if told is None:
        return {}
    return {
        "certified_share": told.certified / told.ticks,
        "overridden_share": told.overridden / told.ticks,
        "uncertified": told.uncertified,
        "certified_while_lost": told.certified_while_lost,
        "certificate_broken": told.certificate_broken,
        "max_command_interval": told.max_command_interval,
        "longest_command_interval": told.longest_command_interval,
        "max_tracking_error": told.max_tracking_error,
    }


def _uav_metrics(flight: "Flight", rows: list[int]) -> dict[str, Any]:
    """Return the metrics of some UAVs together, from their recorded states and reports.

    Args:
        flight: What was flown.
        rows: The escorts; a mean is over all ticks of all of them.
    """
    recorder, world, r_v = flight.recorder, flight.world, flight.scenario.visibility.radius
    told = recorder.escorts[:, rows]
    distance, error = told[:, :, 0], told[:, :, 1]
    pairs = world.escorts[rows]
    p_a, p_g = (recorder.states[:, pairs[:, k], :2] for k in (0, 1))
    radii = [switching_radius_of(flight, k) for k in rows]
    beyond = distance >= np.array([math.inf if r_s is None else r_s for r_s in radii])
    return {
        "max_distance": float(distance.max()) if distance.size else None,
        "mean_distance": _mean(distance),
        "visibility_violations": int((distance >= r_v).sum()),
        "switching_radius": next(iter(radii), None),
        "crossings": int((beyond[1:] & ~beyond[:-1]).sum()),
        "initial_error": _mean(error[0]),
        "mean_error": _mean(error),
        "final_error": _mean(error[-1]),
        "detections": int((~np.isnan(told[:, :, 2])).sum()),
        "estimate_rmse": _rms(told[:, :, 4:6] - p_g),
        "detection_rmse": _rms(told[:, :, 2:4] - (p_a - p_g)),
    }


def _by_uav(flight: "Flight") -> dict[str, UavMetrics]:
    """Return the metrics of each UAV, by name."""
    found: dict[str, UavMetrics] = {}
    for k, pair in enumerate(flight.world.escorts):
        certified, intervened = flight.answers.assurance.shares(k)
        found[flight.scenario.vehicles[pair[0]].name] = UavMetrics(
            **_uav_metrics(flight, [k]), certified_share=certified, overridden_share=intervened
        )
    return found


def summarize(
    flight: "Flight",
    *,
    seconds: float,
    vehicles: Mapping[str, VehicleStatus] | None = None,
    realtime: float | None = None,
    late_ticks: int = 0,
    changes: Sequence[Change] = (),
) -> Summary:
    """Sum up what was flown so far.

    Args:
        flight: At least one state must have been taken down.
        seconds: Wall time of the ticks [s].
        vehicles: How their processes did.
        realtime: The factor that the clock was to keep.
        late_ticks: Ticks that it could not keep.
        changes: What operators have changed.
    """
    from sim.server.recorder import platform_row  # noqa: PLC0415 - likewise

    scenario, recorder, world = flight.scenario, flight.recorder, flight.world
    steered = any(change.control.action in _FLOWN for change in changes)
    certified = flight.answers.assurance.status()
    every = _uav_metrics(flight, list(range(len(world.uavs))))
    return Summary(
        **every | certificate_fields(certified),
        uavs=_by_uav(flight),
        scenario=scenario.name,
        seed=flight.seed,
        secret=flight.secret,
        law=flight.law_name if world.uavs else None,
        dt=scenario.dt,
        ticks=recorder.ticks,
        complete=flight.complete,
        ticks_per_second=recorder.ticks / seconds if seconds > 0.0 else 0.0,
        visibility_radius=scenario.visibility.radius,
        missing_commands=dict(flight.answers.missing),
        faults=_faults(vehicles or {}, flight.answers.shortened),
        largest_tracking_error=recorder.tracking_error,
        mission=world.mission,
        links=world.links.status(),
        traces={one.name: one.sha256 for one in world.link_table.traces},
        realtime=realtime,
        realtime_factor=recorder.ticks * scenario.dt / seconds if seconds > 0.0 else 0.0,
        late_ticks=late_ticks,
        changes=list(changes),
        deterministic=flight.answers.first_missing is None and not steered,
        first_missing_tick=flight.answers.first_missing,
        trajectory_sha256=recorder.sha256(),
        platform=platform_row(),
    )
