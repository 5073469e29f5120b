"""The numbers that sum up a flight."""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from bus.messages import (
    Action,
    CertificateStatus,
    Change,
    LinkStatus,
    Mission,
    UgvGuarantee,
    VehicleStatus,
)

if TYPE_CHECKING:
    from sim.server.flight import Flight


class Process(msgspec.Struct, frozen=True, kw_only=True):
    """One operating-system process of a run."""

    name: str
    pid: int


class Summary(msgspec.Struct, frozen=True, kw_only=True):
    """Numbers that `outrider run --json` prints, over all escorts; a number that does not exist is None.

    Without a UAV there are no escorts: no distance, no coverage error, nothing lost.
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
    """[s]"""
    ticks: int
    complete: bool
    """True if the flight reached the scenario's end."""
    ticks_per_second: float
    """Wall time, from the first tick to the last."""
    max_distance: float | None
    """[m]"""
    mean_distance: float | None
    """[m]"""
    visibility_radius: float
    """r_v [m]"""
    visibility_violations: int
    """Ticks with a distance of r_v or more."""
    switching_radius: float | None
    """r_s of (18) [m]"""
    crossings: int
    """Count of the ticks at which the distance rose to r_s or beyond."""
    initial_error: float | None
    """e(0) [m²]"""
    mean_error: float | None
    """[m²]"""
    final_error: float | None
    """[m²]"""
    detections: int
    estimate_rmse: float | None
    """Root of the mean squared distance between estimated and true p_g [m]."""
    detection_rmse: float | None
    """The same of the raw detections [m]."""
    missing_commands: dict[str, int]
    """Ticks for which a vehicle had no new command."""
    faults: dict[str, dict[str, int]] = {}
    """Faults of a vehicle's process, counted by cause; empty where nothing did."""
    certified_share: float | None = None
    """Of the ticks that a safety filter watched over, those in which sight was certified to be kept."""
    intervened_share: float | None = None
    """Those in which it acted instead of the law."""
    uncertified: dict[str, int] = {}
    """Ticks that were not certified, by reason."""
    certified_while_lost: int = 0
    """Ticks that were certified although the UGV was out of sight; any is a fault of the certificate."""
    certificate_broken: int = 0
    """Ticks that were not certified although the one before was and all assumptions held; likewise."""
    declared_outage: float | None = None
    """Longest time from the start of a motion to the start of the next, as it is declared, B [s]."""
    longest_outage: float | None = None
    """And the longest in this flight [s]."""
    declared_tracking: float | None = None
    """Largest true distance of a UAV from where it is told that it is, w [m]; None where no filter watches or nothing
    takes it from there.
    """
    tracking_error: float | None = None
    """And the farthest in this flight [m], whatever the law; None where nothing takes it from there."""
    arrived: bool | None = None
    """True if every UGV that has goals has reached them all; None, as all up to `found`: there are no hazards."""
    mission_time: float | None = None
    """Time at which the last of them had [s]; None: not yet."""
    hazards_hit: int | None = None
    """Blocking hazards that were touched, each once by each UGV."""
    near_misses: int | None = None
    """Blocking hazards that a UGV came nearer to than 0.2 m without touching them."""
    hazards_on_way: int | None = None
    """Hazards, blocking or rough, that a UGV came nearer to than 2 m."""
    warned: int | None = None
    """Those of them that it knew of before it came so near."""
    warned_before: float | None = None
    """Time from then until it came so near, in the mean of those [s]."""
    seen_ahead: float | None = None
    """Share of the UGVs' way that led over ground which had come by radio before."""
    entered_unknown_tile: int | None = None
    """Ticks in which a UGV drove over a tile that it did not know to be drivable: 0 for a cautious one."""
    ground_certificate_broken: int | None = None
    """Certified ticks after which a cautious UGV was not certified to stay on tiles that it knows, or in which it left
    them, although all assumptions hold: 0, or the guarantee is wrong."""
    guarantees: dict[str, UgvGuarantee] = {}
    """Certified ticks of each UGV, and the reasons of the other ticks."""
    still_time: float | None = None
    """Time that the UGVs stood still before they had arrived [s]."""
    finds: int | None = None
    """Things to be found."""
    found: int | None = None
    """Those that a vehicle's sensor has told of."""
    links: dict[str, LinkStatus] = {}
    """Counts of each link's messages, by `vehicle/kind`."""
    traces: dict[str, str] = {}
    """Recorded links that were played: SHA-256 of the file, by the name in the scenario."""
    realtime: float | None = None
    """The factor that the clock was to keep; None in lockstep."""
    realtime_factor: float
    """Simulated seconds per second of wall time, over the whole flight."""
    late_ticks: int = 0
    """Ticks that the clock could not keep."""
    changes: list[Change] = []
    """Changes by operators while it flew, with their ticks."""
    deterministic: bool
    """True if every command came in time and no operator had a hand in it.

    The hash is that of scenario, seed and secret.
    """
    first_missing_tick: int | None
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
            **status.refused,
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
        "intervened_share": told.intervened / told.ticks,
        "uncertified": told.uncertified,
        "certified_while_lost": told.certified_while_lost,
        "certificate_broken": told.certificate_broken,
        "declared_outage": told.outage,
        "longest_outage": told.longest_outage,
        "declared_tracking": told.tracking,
    }


def mission_fields(mission: Mission | None) -> dict[str, Any]:
    """The summary's fields on how the UGVs got through; None where there are no hazards."""
    return {} if mission is None else msgspec.structs.asdict(mission)


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
    distance, error = recorder.escorts[:, :, 0], recorder.escorts[:, :, 1]
    p_a = recorder.states[:, world.escorts[:, 0], :2]
    p_g = recorder.states[:, world.escorts[:, 1], :2]
    radii = [switching_radius_of(flight, k) for k in range(len(world.uavs))]
    steered = any(change.control.action in _FLOWN for change in changes)
    certified = flight.answers.assurance.status()
    beyond = distance >= np.array([math.inf if r_s is None else r_s for r_s in radii])
    return Summary(
        scenario=scenario.name,
        seed=flight.seed,
        secret=flight.secret,
        law=flight.law_name if world.uavs else None,
        dt=scenario.dt,
        ticks=recorder.ticks,
        complete=flight.complete,
        ticks_per_second=recorder.ticks / seconds if seconds > 0.0 else 0.0,
        max_distance=float(distance.max()) if distance.size else None,
        mean_distance=_mean(distance),
        visibility_radius=scenario.visibility.radius,
        visibility_violations=int((distance >= scenario.visibility.radius).sum()),
        switching_radius=next(iter(radii), None),
        crossings=int((beyond[1:] & ~beyond[:-1]).sum()),
        initial_error=_mean(error[0]),
        mean_error=_mean(error),
        final_error=_mean(error[-1]),
        detections=int((~np.isnan(recorder.escorts[:, :, 2])).sum()),
        estimate_rmse=_rms(recorder.escorts[:, :, 4:6] - p_g),
        detection_rmse=_rms(recorder.escorts[:, :, 2:4] - (p_a - p_g)),
        missing_commands=dict(flight.answers.missing),
        faults=_faults(vehicles or {}, flight.answers.shortened),
        **certificate_fields(certified),
        tracking_error=recorder.tracking_error,
        **mission_fields(world.mission),
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
