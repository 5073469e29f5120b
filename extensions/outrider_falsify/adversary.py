"""Omniscient UGV that reacts to the UAV; its decisions are recorded as a script that replays them."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from agents.drivers.steering import Steering
from agents.ugv import UgvPilot
from bus.messages.base import Vector
from bus.messages.scenario import ScriptStep
from bus.messages.vehicle import UgvBriefing, UgvObservation
from outrider.running.flying import InProcess, make_pilots
from sim.engine.briefing import ugv_briefing
from sim.scenario.types import Scenario
from sim.server.flight import Flight


def cut(number: float, digits: int) -> float:
    """Truncate a number towards zero, so that bounds still hold and the scenario stays readable."""
    scale = 10.0**digits
    return math.trunc(number * scale) / scale


@dataclass(frozen=True, slots=True, kw_only=True)
class Tactics:
    """Reactions of the UGV to the UAV's distance and radial velocity."""

    far: float
    """Distance from which the UAV counts as far [m]."""
    fast: float
    """Radial speed above which the UAV counts as approaching or receding [m/s]."""
    period: int
    """Ticks between two decisions."""
    table: tuple[tuple[float, float], ...]
    """Angle from the direction away from the UAV [rad] and speed [m/s].

    Rows: near UAV that recedes, holds its distance, approaches; then the same for a far UAV.
    """


class Adversary:
    """UGV controller with access to the true state.

    Args:
        tactics: Reactions to the UAV.
        flight: Run that holds the true state.
        briefing: The UGV's briefing.
    """

    def __init__(self, tactics: Tactics, flight: Flight, briefing: UgvBriefing) -> None:
        self._tactics, self._world = tactics, flight.world
        self._steering = Steering(briefing)
        self.script: list[ScriptStep] = []
        """Its commands so far."""

    def opponent(self) -> int:
        """Return the row of the UAV to which it reacts, among the vehicles."""
        return int(self._world.escorts[0, 0])

    def _wanted(self) -> Vector:
        c, a, g = self._tactics, self.opponent(), int(self._world.escorts[0, 1])
        p_a = self._world.position[a].tolist()
        p_g = self._world.position[g].tolist()
        v_a = self._world.velocity[a].tolist()
        x, y = p_a[0] - p_g[0], p_a[1] - p_g[1]
        distance = math.hypot(x, y)
        outward = (v_a[0] * x + v_a[1] * y) / distance if distance > 0.0 else 0.0
        kind = 0 if outward > c.fast else (2 if outward < -c.fast else 1)
        angle, speed = c.table[kind + (3 if distance >= c.far else 0)]
        angle += math.atan2(-y, -x)
        return cut(speed * math.cos(angle), 4), cut(speed * math.sin(angle), 4)

    def drive(self, observation: UgvObservation) -> Vector:
        """Return the acceleration [m/s²] towards the velocity that a script would hold at this tick."""
        if observation.tick % self._tactics.period == 0:
            self.script.append(ScriptStep(time=observation.time, velocity=self._wanted()))
        return self._steering.to_velocity(observation, self.script[-1].velocity)


def fly_adversary(
    scenario: Scenario, tactics: Tactics, on_tick: Callable[[Flight], None]
) -> tuple[Flight, list[ScriptStep]]:
    """Simulate a scenario with the adversary as the UGV's controller.

    Args:
        scenario: Scenario with its own seed; its script is ignored.
        tactics: Reactions of the adversary.
        on_tick: Called after each tick.

    Returns:
        The run, and the script that reproduces it.
    """
    flight = Flight(scenario, scenario.seed)
    pilots = make_pilots(scenario, scenario.seed)
    briefing = ugv_briefing(scenario, scenario.ugv[0].name, scenario.seed)
    adversary = Adversary(tactics, flight, briefing)
    pilots[briefing.vehicle] = UgvPilot(briefing, driver=adversary)
    flight.fly(InProcess(pilots), on_tick=lambda: on_tick(flight))
    return flight, adversary.script
