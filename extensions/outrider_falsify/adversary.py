"""A UGV that sees everything and answers what the UAV does; what it did is a script that does the same again."""

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
    """Towards zero, so that bounds are kept, to so many digits: a scenario that people can read."""
    scale = 10.0**digits
    return math.trunc(number * scale) / scale


@dataclass(frozen=True, slots=True, kw_only=True)
class Tactics:
    """The UGV's answers, by how far away the UAV is and whether it comes or goes."""

    far: float
    """From this distance on it counts as far [m]."""
    fast: float
    """Faster than this it counts as coming or going [m/s]."""
    period: int
    """Ticks between two decisions."""
    table: tuple[tuple[float, float], ...]
    """Angle from straight away [rad] and speed [m/s], while it is near and flies off, neither, comes.

    Then while it is far.
    """


class Adversary:
    """The driver, with the whole truth before it.

    Args:
        tactics: What it answers.
        flight: Where the truth is.
        told: The UGV's briefing.
    """

    def __init__(self, tactics: Tactics, flight: Flight, told: UgvBriefing) -> None:
        self._tactics, self._world = tactics, flight.world
        self._steering = Steering(told)
        self.script: list[ScriptStep] = []
        """Its commands so far."""

    def _wanted(self) -> Vector:
        c, ((a, g),) = self._tactics, self._world.escorts.tolist()
        p_a = self._world.position[a].tolist()
        p_g = self._world.position[g].tolist()
        v_a = self._world.velocity[a].tolist()
        x, y = p_a[0] - p_g[0], p_a[1] - p_g[1]
        distance = math.hypot(x, y)
        outward = (v_a[0] * x + v_a[1] * y) / distance if distance > 0.0 else 0.0
        motion = 0 if outward > c.fast else (2 if outward < -c.fast else 1)
        angle, speed = c.table[motion + (3 if distance >= c.far else 0)]
        angle += math.atan2(-y, -x)
        return cut(speed * math.cos(angle), 4), cut(speed * math.sin(angle), 4)

    def drive(self, observation: UgvObservation) -> Vector:
        """The acceleration [m/s²], to the velocity that a script would hold at this tick."""
        if observation.tick % self._tactics.period == 0:
            self.script.append(ScriptStep(time=observation.time, velocity=self._wanted()))
        return self._steering.to_velocity(observation, self.script[-1].velocity)


def fly_adversary(
    scenario: Scenario, tactics: Tactics, on_tick: Callable[[Flight], None]
) -> tuple[Flight, list[ScriptStep]]:
    """Fly a scenario with the adversary at the UGV's wheel.

    Args:
        scenario: What is flown, with its own seed; its script is not.
        tactics: The adversary's.
        on_tick: Called after each tick.

    Returns:
        The flight, and the script with which the scenario flies the same.
    """
    flight = Flight(scenario, scenario.seed)
    pilots = make_pilots(scenario, scenario.seed)
    told = ugv_briefing(scenario, scenario.ugv[0].name, scenario.seed)
    adversary = Adversary(tactics, flight, told)
    pilots[told.vehicle] = UgvPilot(told, driver=adversary)
    flight.fly(InProcess(pilots), on_tick=lambda: on_tick(flight))
    return flight, adversary.script
