"""Summary of a run."""

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import msgspec
import numpy as np

from bus.messages.control import Action, Change
from bus.messages.decision import NotCertified
from bus.messages.links import LinkStatus
from bus.messages.telemetry import (
    CertificateStatus,
    MissionResult,
    TeamStatus,
    VehicleStatus,
)
from sim.models.vehicles import raw_switching_radius
from sim.server.answers import Answers
from sim.server.flight import Flight
from sim.server.recorder import platform_row


class Process(msgspec.Struct, frozen=True, kw_only=True):
    """Operating-system process of a run."""

    name: str
    pid: int


class UavMetrics(msgspec.Struct, frozen=True, kw_only=True):
    """Metrics of one or several UAVs, explained in `outrider.running.metrics.UAV`; None: no value."""

    max_distance: float | None
    mean_distance: float | None
    min_margin: float | None = None
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
    """Summary of a run, as printed by `outrider run --json`; UAV metrics are over all UAVs.

    `outrider.running.metrics` explains each metric. A metric without a value is None: without a UAV there are no
    distances and errors, without hazards no mission.
    """

    scenario: str
    seed: int
    secret: str = ""
    """Secret of the run, for its owner only: together with the seed it reproduces the run.

    Empty: none, and the seed alone reproduces it.
    """
    law: str | None
    """Law of the scenario; `external` if a program of the user flew the UAVs, which reports no estimate.

    None without a UAV.
    """
    dt: float
    """Length of a tick [s]."""
    ticks: int
    complete: bool
    ticks_per_second: float
    visibility_radius: float
    min_separation: float | None = None
    missing_commands: dict[str, int]
    """Ticks without a new command, by vehicle."""
    faults: dict[str, dict[str, int]] = {}
    """Faults of a vehicle's process, counted by cause; empty without a fault."""
    telemetry_faults: dict[str, int] = {}
    """Messages to observers that could not be made or sent, by topic; they change nothing else."""
    uncertified: dict[NotCertified, int] = {}
    """Ticks that were not certified, by reason."""
    certified_while_lost: int = 0
    lost_without_clearance: int | None = None
    certificate_broken: int = 0
    max_command_interval: float | None = None
    longest_command_interval: float | None = None
    max_tracking_error: float | None = None
    largest_tracking_error: float | None = None
    tracking_exceeded: int | None = None
    team: TeamStatus | None = None
    """Guarantee of the teams; None: there are none."""
    mission: MissionResult | None = None
    """Mission of the UGVs; None where there are no hazards."""
    uavs: dict[str, UavMetrics] = {}
    """Metrics of each UAV."""
    links: dict[str, LinkStatus] = {}
    """Metrics of each link, by `vehicle/kind`."""
    traces: dict[str, str] = {}
    """SHA-256 of each recorded link, by its name in the scenario."""
    realtime: float | None = None
    """Target real-time factor; None in lockstep."""
    realtime_factor: float
    late_ticks: int = 0
    changes: list[Change] = []
    """Operators' changes during the run, with their ticks."""
    deterministic: bool
    first_missing_tick: int | None
    """First tick at which a vehicle had no new command; None: every command arrived in time."""
    trajectory_sha256: str
    platform: dict[str, str]
    processes: list[Process] = []


_TRAJECTORY_ACTIONS = (Action.LAW, Action.DRIVER, Action.LINK, Action.REQUEST)
"""Operator actions that change a trajectory."""


def _rms(errors: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> float | None:
    squares = (errors**2).sum(axis=-1)
    found = squares[~np.isnan(squares)]
    return math.sqrt(float(found.mean())) if found.size else None


def _mean(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> float | None:
    return float(values.mean()) if values.size else None


def switching_radius_of(flight: Flight, escort: int = 0) -> float | None:
    """Return r_s of one escort, eq. (18) [m]; None if it is not finite."""
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


def _faults(vehicles: Mapping[str, VehicleStatus], answers: Answers) -> dict[str, dict[str, int]]:
    """Return the faults of each vehicle by cause, without zeros."""
    found: dict[str, dict[str, int]] = {}
    for name, count in answers.shortened.items():
        counted = answers.counted(name)
        status = vehicles.get(name, VehicleStatus(present=True, rejected=counted.rejected))
        counts = {
            "command beyond its bound": count,
            "lost": status.lost,
            "joined again": status.rejoined,
            "no new command": status.missing_commands,
            "late command used": status.stale_commands,
            "no state of its robot": counted.unreported_ticks,
            **status.rejected,
        }
        if any(counts.values()):
            found[name] = {cause: count for cause, count in counts.items() if count}
    return found


def certificate_fields(status: CertificateStatus | None) -> dict[str, Any]:
    """Return the summary's fields about certificates; empty for None, which means that no safety filter acted."""
    if status is None:
        return {}
    return {
        "certified_share": status.certified / status.ticks,
        "overridden_share": status.overridden / status.ticks,
        "uncertified": status.uncertified,
        "certified_while_lost": status.certified_while_lost,
        "lost_without_clearance": status.lost_without_clearance,
        "certificate_broken": status.certificate_broken,
        "max_command_interval": status.max_command_interval,
        "longest_command_interval": status.longest_command_interval,
        "max_tracking_error": status.max_tracking_error,
        "tracking_exceeded": status.tracking_exceeded,
    }


def _uav_metrics(flight: Flight, rows: list[int]) -> dict[str, Any]:
    """Return the merged metrics of several UAVs, from their recorded states and reports.

    Args:
        flight: Flight with its record.
        rows: Rows of the escorts; means are over all their ticks.
    """
    recorder, world = flight.recorder, flight.world
    recorded = recorder.escorts[:, rows]
    distance, error = recorded[:, :, 0], recorded[:, :, 1]
    pairs = world.escorts[rows]
    p_a, p_g = (recorder.states[:, pairs[:, k], :2] for k in (0, 1))
    together = len(rows) == len(world.uavs)
    margins = recorder.widest_margins if together else recorder.margins[:, rows]
    lost = recorder.unseen if together else recorder.lost[:, rows]
    radii = [switching_radius_of(flight, k) for k in rows]
    beyond = distance >= np.array([math.inf if r_s is None else r_s for r_s in radii])
    return {
        "max_distance": float(distance.max()) if distance.size else None,
        "mean_distance": _mean(distance),
        "min_margin": float(margins.min()) if distance.size else None,
        "visibility_violations": int(lost.sum()),
        "switching_radius": next(iter(radii), None),
        "crossings": int((beyond[1:] & ~beyond[:-1]).sum()),
        "initial_error": _mean(error[0]),
        "mean_error": _mean(error),
        "final_error": _mean(error[-1]),
        "detections": int((~np.isnan(recorded[:, :, 2])).sum()),
        "estimate_rmse": _rms(recorded[:, :, 4:6] - p_g),
        "detection_rmse": _rms(recorded[:, :, 2:4] - (p_a - p_g)),
    }


def _min_separation(flight: Flight) -> float | None:
    """Return the smallest distance of two UAVs at a tick [m]; None with fewer than two."""
    recorder, rows = flight.recorder, flight.world.escorts[:, 0]
    places = recorder.states[:, rows, :2]
    if flight.scenario.has_altitude:
        places = np.concatenate((places, recorder.heights[:, :, :1]), axis=2)
    found = [
        float(np.linalg.norm(places[:, k + 1 :] - places[:, k : k + 1], axis=2).min())
        for k in range(len(rows) - 1)
    ]
    return min(found, default=None)


def _by_uav(flight: Flight) -> dict[str, UavMetrics]:
    """Return the metrics of each UAV, by name."""
    found: dict[str, UavMetrics] = {}
    for k, pair in enumerate(flight.world.escorts):
        certified, overridden = flight.answers.assurance.shares(k)
        found[flight.scenario.vehicles[pair[0]].name] = UavMetrics(
            **_uav_metrics(flight, [k]), certified_share=certified, overridden_share=overridden
        )
    return found


def summarize(
    flight: Flight,
    *,
    seconds: float,
    vehicles: Mapping[str, VehicleStatus] | None = None,
    realtime: float | None = None,
    late_ticks: int = 0,
    changes: Sequence[Change] = (),
    telemetry_faults: Mapping[str, int] = MappingProxyType({}),
) -> Summary:
    """Return the summary of a flight so far.

    Args:
        flight: Flight with at least one recorded state.
        seconds: Wall time of the ticks [s].
        vehicles: Status of the vehicles' processes.
        realtime: Target real-time factor; None: lockstep.
        late_ticks: Ticks that missed their wall-clock time.
        changes: Changes by operators.
        telemetry_faults: Messages to observers that could not be made or sent, by topic.
    """
    scenario, recorder, world = flight.scenario, flight.recorder, flight.world
    steered = any(change.control.action in _TRAJECTORY_ACTIONS for change in changes)
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
        min_separation=_min_separation(flight),
        missing_commands=dict(flight.answers.missing),
        faults=_faults(vehicles or {}, flight.answers),
        telemetry_faults=dict(telemetry_faults),
        largest_tracking_error=recorder.tracking_error,
        team=flight.answers.teams.status(),
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
