"""Description of a counterexample in text."""

import math

from sim.scenario.safety import largest_error
from sim.scenario.types import Scenario
from sim.scene.altitude import HIDDEN
from sim.server.flight import Flight


def _start(scenario: Scenario) -> str:
    uav, ugv = scenario.uav[0], scenario.ugv[0]
    v_a, v_g = math.hypot(*uav.velocity), math.hypot(*ugv.velocity)
    speeds = f"the UAV flies at {v_a:.2f} m/s, the UGV drives at {v_g:.2f} m/s"
    if uav.velocity == ugv.velocity == (0.0, 0.0):
        speeds = "both at rest"
    return f"The vehicles start {math.dist(uav.position, ugv.position):.2f} m apart, {speeds}."


def _network(scenario: Scenario) -> str:
    links, error = scenario.links, largest_error(scenario, scenario.uav[0])
    detections, parts = links.detections, []
    if error:
        parts.append(f"errors of up to {error:.2f} m in the detections")
    if detections.delay or detections.jitter:
        parts.append(f"detections up to {detections.delay + detections.jitter:.2f} s late")
    if detections.loss:
        parts.append(f"{100.0 * detections.loss:.0f} % of them lost")
    if detections.blackouts:
        start, length = detections.blackouts[0]
        parts.append(f"blackouts of {length:.2f} s, the first at {start:.2f} s")
    if links.commands.delay:
        parts.append(f"the UAV's commands {links.commands.delay:.2f} s late")
    return f"Network: {', '.join(parts)}." if parts else "Network: undegraded."


def _at(flight: Flight, tick: int) -> str:
    """Describe the motion of both vehicles at a tick, along the line between them."""
    a, g = flight.recorder.states[tick, flight.world.escorts[0]]
    x, y = float(a[0] - g[0]), float(a[1] - g[1])
    away = math.hypot(x, y) or 1.0
    flies, drives = (float(v[2] * x + v[3] * y) / away for v in (a, g))
    uav = (
        f"the UAV recedes at {flies:.2f} m/s"
        if flies >= 0.0
        else f"the UAV approaches at {-flies:.2f} m/s"
    )
    ugv = (
        f"the UGV drives away at {-drives:.2f} m/s"
        if drives <= 0.0
        else f"the UGV drives towards it at {drives:.2f} m/s"
    )
    return f"{uav}, {ugv}"


def describe(scenario: Scenario, flight: Flight) -> list[str]:
    """Describe the run, one sentence per item."""
    distance, r_v, dt = flight.recorder.escorts[:, 0, 0], scenario.visibility.radius, scenario.dt
    farthest = int(distance.argmax())
    beyond = [int(tick) for tick in flight.recorder.lost[:, 0].nonzero()[0]]
    lines = [
        _start(scenario),
        f"The UGV follows a script of {len(scenario.ugv[0].script)} steps.",
        _network(scenario),
    ]
    if beyond:
        last = max(0, beyond[0] - 1)
        lines.append(
            f"At {beyond[0] * dt:.2f} s the UGV is lost. One tick earlier, {_at(flight, last)}."
        )
        hidden = int((flight.recorder.radii[:, 0] == 0.0).sum())
        behind = f", of which {hidden * dt:.2f} s {HIDDEN}" if hidden else ""
        lines.append(
            f"It is out of sight for {len(beyond) * dt:.2f} s of {scenario.duration:g} s{behind}."
        )
    lines.append(
        f"The largest distance is {distance[farthest]:.4f} m at {farthest * dt:.2f} s; r_v = {r_v:g} m."
    )
    return lines
