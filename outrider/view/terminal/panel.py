"""Texts of the screen: the panel of numbers beside the map, and the lines above it."""

import math
from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

from rich.text import Text

from bus.messages.team import Role
from bus.messages.telemetry import EscortTruth, Status, VehicleStatus, VehicleTruth
from bus.registry import TELEOP
from outrider.view.operator import SILENCE
from outrider.view.terminal.palette import ALARM, EDGE, FAINT, GOOD, INK, LIMIT, UAV, UGV
from outrider.view.terminal.teleoperation import DriveView
from sim.models.sight import is_lost, sight_margin
from sim.scene.altitude import HIDDEN, decisive

WIDTH = 36
"""Width of the panel [cells]."""
_INNER = WIDTH - 4
_BARS = "▁▂▃▄▅▆▇█"
_EIGHTHS = " ▏▎▍▌▋▊▉█"
_LOCKSTEP_FACTOR = 20.0


@dataclass(slots=True)
class ErrorCurve:
    """Recent values of the coverage error e(t), for a curve."""

    errors: deque[float] = field(default_factory=lambda: deque(maxlen=_INNER))
    time: float = -math.inf
    step: float = 1.0
    """Simulated time between two values [s]."""

    def add(self, time: float, error: float) -> None:
        """Add a value [m²] if it is due."""
        if time < self.time:
            self.errors.clear()
            self.time = -math.inf
        if time - self.time >= self.step:
            self.errors.append(error)
            self.time = time


class Banner(NamedTuple):
    """Line with the current state."""

    text: str
    color: str
    ground: str


def farthest(view: DriveView, vehicle: str) -> EscortTruth | None:
    """Return the escort of a UGV that is farthest away, of a team its nearest UAV; None if unknown."""
    if view.truth is None:
        return None
    return max(
        (escort for escort in decisive(view.truth.escorts) if escort.ugv == vehicle),
        key=lambda one: one.distance,
        default=None,
    )


def banner(view: DriveView, vehicle: str, *, leaving: bool) -> Banner:
    """Return the most important message now."""
    if view.status is not None and view.status.over:
        return Banner("the flight is over · q quits", "#12151a", GOOD)
    trouble = _trouble(view)
    if trouble:
        return Banner(trouble, "#ffffff", ALARM)
    if leaving:
        return Banner("returning control", "#12151a", GOOD)
    paused = view.status is not None and view.status.paused
    if view.mine:
        does = "paused" if paused else "driving" if view.wanted is not None else "braking"
        return Banner(f"YOU DRIVE {vehicle} · {does}", "#12151a", UGV[0])
    pause = " (paused)" if paused else ""
    if view.asked:
        return Banner(f"taking control of {vehicle}{pause}", "#12151a", UGV[1])
    driver = "another operator" if view.driver == TELEOP else view.driver
    state = f"{driver} drives {vehicle}" if driver else f"the driver of {vehicle} is unknown"
    return Banner(f"{state}{pause} · an arrow key takes control", INK, EDGE)


def _trouble(view: DriveView) -> str:
    if not view.connected:
        return "ROUTER DISCONNECTED · the UGV brakes · waiting for the router"
    if not view.present:
        return "SIMULATOR DISCONNECTED · waiting for it · q quits"
    if view.age > SILENCE:
        return f"NO MESSAGE FROM THE SIMULATOR for {view.age:.0f} s"
    return view.fault and f"ERROR: {view.fault}"


def title(view: DriveView, run: str, *, wide: bool = True) -> Text:
    """Return the title with the run's name and time; without the name if not `wide`."""
    text = Text(" OUTRIDER ", style=f"bold {UAV[0]}", no_wrap=True)
    status = view.status
    if status is None:
        return text
    if wide:
        text.append(f"{status.scenario}, seed {status.seed}, run {run}   ", style=FAINT)
    text.append(f"t = {_time(view):.1f} s", style=f"bold {INK}")
    text.append(f" of {_total(status)}", style=FAINT)
    return text


def _time(view: DriveView) -> float:
    return max(
        view.truth.time if view.truth is not None else 0.0,
        view.status.time if view.status is not None else 0.0,
    )


def _total(status: Status) -> str:
    return "-" if status.geometry is None else f"{status.ticks * status.geometry.dt:g} s"


def numbers(view: DriveView, vehicle: str, history: ErrorCurve) -> Text:
    """Return the panel of numbers."""
    text = Text(no_wrap=True, style=INK)
    escort = farthest(view, vehicle)
    _distance(text, view, escort)
    _team(text, view)
    _coverage(text, escort, history)
    _velocities(text, view, vehicle, escort)
    _mission(text, view)
    _clock(text, view)
    _processes(text, view)
    return text


def _row(text: Text, name: str, value: str, color: str = INK, *, bold: bool = False) -> None:
    text.append(name, style=FAINT)
    text.append(value.rjust(_INNER - len(name)) + "\n", style=f"bold {color}" if bold else color)


def _distance(text: Text, view: DriveView, escort: EscortTruth | None) -> None:
    geometry = view.status.geometry if view.status is not None else None
    distance = escort.distance if escort is not None else None
    r_v = geometry.visibility_radius if geometry is not None else None
    sight = escort.sight_radius if escort is not None else None
    r_v = r_v if sight is None else sight
    r_s = geometry.switching_radius if geometry is not None else None
    color, margin = INK, "-"
    if distance is not None and r_v is not None:
        color = _severity(distance, r_v, r_s)
        margin = HIDDEN if r_v == 0.0 else f"{float(sight_margin(distance, r_v)):+.2f} m"
    name = f"distance {escort.uav}" if escort is not None else "distance"
    _row(text, name, "-" if distance is None else f"{distance:.2f} m", color, bold=True)
    text.append_text(_gauge(distance, r_v, r_s, color))
    limit = f" = {r_v:.4g} m" if r_v else ""
    _row(text, f"margin to r_v{limit}", margin, color, bold=True)
    if view.truth is not None and escort is not None:
        _altitude(text, view.truth.vehicles[escort.uav])
    text.append("\n")


def _team(text: Text, view: DriveView) -> None:
    """Add role, number and charge of each UAV in a team."""
    status = view.status
    if status is None or status.team is None:
        return
    for name, role in status.roles.items():
        charge = status.team.charges.get(name)
        left = "" if charge is None else f", {charge:.0f} s left"
        number = status.team.numbers.get(name, 0)
        color = UAV[0] if role is Role.GUARD else INK
        _row(text, f"{name} ({number})" if number else name, f"{role.lower()}{left}", color)
    text.append("\n")


def _altitude(text: Text, uav: VehicleTruth) -> None:
    """Add the altitude of a UAV, if it has one."""
    if uav.altitude is not None:
        climb = f" {uav.climb_rate:+.2f} m/s" if uav.climb_rate else ""
        _row(text, "altitude", f"{uav.altitude:.2f} m{climb}", bold=True)


def _severity(distance: float, r_v: float, r_s: float | None) -> str:
    if is_lost(distance, r_v):
        return LIMIT
    return UGV[0] if r_s is not None and distance > r_s else GOOD


def _gauge(distance: float | None, r_v: float | None, r_s: float | None, color: str) -> Text:
    """Return the distance as a bar that is full at r_v, with a mark at r_s."""
    share = 0.0 if distance is None or r_v is None else min(distance / r_v, 1.0) if r_v else 1.0
    eighths = round(share * _INNER * 8)
    full, rest = divmod(eighths, 8)
    bar = ("█" * full + (_EIGHTHS[rest] if rest else "")).ljust(_INNER)
    gauge = Text(bar, style=f"{color} on {EDGE}")
    if r_v is not None and r_s is not None and 0.0 < r_s < r_v:
        mark = int(r_s / r_v * _INNER)
        gauge = (
            gauge[:mark]
            + Text("┆", style=f"{LIMIT} on {color if mark < full else EDGE}")
            + gauge[mark + 1 :]
        )
    return gauge + Text("\n")


def _coverage(text: Text, escort: EscortTruth | None, history: ErrorCurve) -> None:
    _row(
        text,
        "coverage error e(t)",
        "-" if escort is None else f"{escort.coverage_error:.1f} m²",
        bold=True,
    )
    low, high = min(history.errors, default=0.0), max(history.errors, default=0.0)
    width = max(high - low, 1e-9)
    text.append(
        "".join(_BARS[int((error - low) / width * 7.99)] for error in history.errors).rjust(_INNER),
        style=UAV[0],
    )
    text.append("\n\n")


def _velocities(text: Text, view: DriveView, vehicle: str, escort: EscortTruth | None) -> None:
    text.append(
        "velocity".ljust(12) + "x".rjust(6) + "y".rjust(7) + "m/s".rjust(_INNER - 25) + "\n",
        style=FAINT,
    )
    wanted = view.wanted if view.wanted is not None else (0.0, 0.0) if view.mine else None
    _velocity(text, "desired", wanted, UGV[0])
    vehicles = view.truth.vehicles if view.truth is not None else {}
    shown = {vehicle: UGV[0]} | ({} if escort is None else {escort.uav: UAV[0]})
    for name, color in shown.items():
        _velocity(text, name, vehicles[name].velocity if name in vehicles else None, color)
    text.append("\n")


def _velocity(text: Text, name: str, velocity: tuple[float, float] | None, color: str) -> None:
    text.append(name[:11].ljust(11), style=color)
    if velocity is None:
        text.append("      -      -      -\n", style=FAINT)
        return
    x, y = velocity
    text.append(f"{x:+7.2f}{y:+7.2f}")
    text.append(f"{math.hypot(x, y):7.2f}\n", style="bold")


def _mission(text: Text, view: DriveView) -> None:
    """Add the lines on the mission, in a scenario with hazards."""
    mission = view.status.mission if view.status is not None else None
    if mission is None:
        return
    if mission.mission_time is None:
        _row(text, "at the goals", "not yet")
    else:
        _row(text, "at the goals", f"after {mission.mission_time:.1f} s", GOOD)
    hits = mission.hazards_hit
    _row(text, "hazards hit", str(hits), LIMIT if hits else GOOD, bold=True)
    _row(text, "on the path / known", f"{mission.hazards_on_path} / {mission.warned}")
    if mission.reported_share is not None:
        _row(text, "path reported ahead", f"{100.0 * mission.reported_share:.0f} %")
    if mission.finds:
        _row(text, "found", f"{mission.found} of {mission.finds}")
    text.append("\n")


def _clock(text: Text, view: DriveView) -> None:
    status = view.status
    if status is None:
        return
    lockstep = status.target_factor is None
    pace = "paused" if status.paused else f"x {view.factor:.2f}"
    _row(text, "real time" + ("" if lockstep else f" (target x {status.target_factor:g})"), pace)
    if lockstep and view.factor > _LOCKSTEP_FACTOR:
        text.append("too fast to drive: --realtime 1\n", style=LIMIT)
    elif lockstep:
        text.append("lockstep: as fast as possible\n", style=FAINT)
    else:
        _row(text, "late ticks", f"{status.late_ticks}", LIMIT if status.late_ticks else INK)


def _processes(text: Text, view: DriveView) -> None:
    if view.status is None:
        return
    here = view.connected and view.present
    _process(text, "simulator", VehicleStatus(present=here))
    for name, vehicle in view.status.vehicles.items():
        _process(text, name, vehicle, known=here)


def _process(text: Text, name: str, vehicle: VehicleStatus, *, known: bool = True) -> None:
    state, color = ("up", GOOD) if vehicle.present else ("DOWN", LIMIT)
    if not known:
        state, color = "unknown", FAINT
    text.append("● ", style=color)
    text.append(name)
    counts = [f"lost {vehicle.lost}x"] if vehicle.lost else []
    counts += [f"missed {vehicle.missing_commands}"] if vehicle.missing_commands else []
    counts += [f"shortened {vehicle.shortened_commands}"] if vehicle.shortened_commands else []
    text.append(", ".join([*counts, state]).rjust(_INNER - 2 - len(name)) + "\n", style=color)
