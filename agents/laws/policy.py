"""A policy in the place of a UAV's law, on what the UAV knows: the observation that the environment would give it."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from agents.asking import LARGEST, AskedPolicy, pair
from agents.uav_parameters import UavParameters
from bus.errors import ScenarioError
from bus.messages.base import Vector
from bus.messages.vehicle import UavBriefing, UavObservation
from bus.observations import GRADIENT, UAV, Row, clipped
from bus.ticks import Look, looks_of
from sim.compiling.compile import FloatArray
from sim.models.field import coverage_gradient, sample

UavPolicy = Callable[[Any], object]
"""A UAV's observations in a batch of worlds in, its accelerations [m/s²] out, shape (worlds, 2).

It may have a `setup`, the settings of the environment whose observations it needs (`SETUP`), and a method `fits`, which
is given the briefing: it raises a ValueError where it is made for another UAV, and returns warnings.
"""
SETUP: Mapping[str, Any] = {
    "estimate": False,
    "gradient": False,
    "coverage_patch": None,
    "dtype": np.float64,
    "duration": None,
}
"""The keys of a policy's setup and their defaults: as of `outrider.vector_env`; `duration` [s] is the length of its
episodes, which stands for the age of a detection before there is one."""
_ALLOWED = (
    "two finite numbers for each world, here of shape (1, 2), the acceleration x and y [m/s²]"
)


class TargetEstimate(NamedTuple):
    """The estimate of the UGV."""

    known: bool
    x: float
    y: float
    """[m]"""
    age: int
    """Ticks since the newest detection that was not rejected."""


def check_fit(briefing: UavBriefing, policy: UavPolicy, name: str) -> tuple[str, ...]:
    """Hold a policy against the UAV that it is to fly.

    Returns:
        Warnings, one a line.

    Raises:
        ScenarioError: If its setup is none, or it is made for another UAV.
    """
    setup, fits = getattr(policy, "setup", {}), getattr(policy, "fits", None)
    unknown = [key for key in setup if key not in SETUP]
    if unknown:
        raise ScenarioError(
            f"uav_policy = {name!r}: setup: {unknown[0]!r} is unknown; allowed: {', '.join(SETUP)}"
        )
    try:
        warnings = () if fits is None else fits(briefing)
    except ValueError as error:
        raise ScenarioError(f"uav_policy = {name!r}: {briefing.vehicle}: {error}") from error
    return tuple(f"uav_policy = {name!r}: {briefing.vehicle}: {line}" for line in warnings)


class PolicyControl:
    """Asks the policy at each tick with the observation of its UAV.

    Row, estimate, gradient and coverage patch have the bits of the environment's. They are made from the observation,
    the filter's estimate and the UAV's own map, and from nothing else.

    Args:
        briefing: What the UAV is told when it joins.
        uav: Constants of the UAV.
        policy: The policy; it remembers one UAV's flight.
        name: Of the policy, in errors.

    Raises:
        ScenarioError: As `check_fit`.
    """

    def __init__(
        self, briefing: UavBriefing, uav: UavParameters, policy: UavPolicy, name: str
    ) -> None:
        check_fit(briefing, policy, name)
        self._uav, self._dt, self._area = uav, float(briefing.dt), briefing.area
        self._asked = AskedPolicy(policy, f"uav_policy = {name!r}", self._dt)
        self._setup = {**SETUP, **getattr(policy, "setup", {})}
        length = self._setup["duration"]
        self._never = np.inf if length is None else float(length)
        self._newest = -1
        patch = self._setup["coverage_patch"]
        self._pixels, self._scale = (0, 1.0) if patch is None else (int(patch[0]), float(patch[1]))

    def perceive(self, observation: UavObservation) -> None:
        """Take in the detections of a tick, answered or not."""
        for look in self._looks(observation):
            self._newest = max(self._newest, look.taken)

    def _looks(self, observation: UavObservation) -> Iterator[Look]:
        looks = looks_of(observation.detections, self._dt)
        return (look for look in looks if 0 <= look.taken <= observation.tick)

    def acceleration(
        self, observation: UavObservation, target: TargetEstimate, coverage: FloatArray
    ) -> Vector:
        """The acceleration [m/s²] for this observation, which has been perceived.

        Args:
            observation: What the UAV perceives.
            target: Its estimate of the UGV.
            coverage: Its own map. Shape (rows, columns).

        Raises:
            ScenarioError: If the policy raises, or answers anything but two finite numbers.
        """
        tick = observation.tick
        row = self._row(observation, target, coverage).astype(self._setup["dtype"])[None]
        seen = {"row": row, "coverage": self._patch(observation, coverage)} if self._pixels else row
        answer = self._asked.answer(tick, seen)
        found = pair(answer, (1, 2))
        if found is None or max(map(abs, found)) > LARGEST:
            raise self._asked.nonsense(tick, answer, _ALLOWED)
        return found

    def _row(
        self, observation: UavObservation, target: TargetEstimate, coverage: FloatArray
    ) -> Row:
        time, (x, y) = observation.tick * self._dt, observation.position
        best = max(self._looks(observation), key=lambda look: look.taken, default=None)
        newest = self._newest if best is None else best.taken
        age = self._never if newest < 0 else time - newest * self._dt
        seen = (0.0, 0.0, 0.0, age) if best is None else (1.0, best.x, best.y, age)
        if target.known and self._setup["estimate"]:
            seen = 1.0, x - target.x, y - target.y, target.age * self._dt
        own = np.array((time, x, y, *observation.velocity, *seen), dtype=np.float64)
        if not self._setup["gradient"]:
            return clipped(UAV, own, self._area, self._dt)
        whole = np.append(own, self._gradient(x, y, target, coverage))
        return clipped(UAV + GRADIENT, whole, self._area, self._dt)

    def _gradient(
        self, x: float, y: float, target: TargetEstimate, coverage: FloatArray
    ) -> tuple[float, float]:
        c = self._uav
        if not target.known:
            return 0.0, 0.0
        u_x, u_y, size = coverage_gradient(
            coverage,
            x,
            y,
            target.x,
            target.y,
            c.density_radius,
            c.desired_coverage,
            c.sensor,
            c.cell,
        )
        return (u_x / size, u_y / size) if size > 0.0 else (0.0, 0.0)

    def _patch(self, observation: UavObservation, coverage: FloatArray) -> FloatArray:
        picture: FloatArray = np.empty((1, self._pixels, self._pixels))
        c = self._uav
        sample(coverage, *observation.position, c.desired_coverage, c.cell, self._scale, picture[0])
        shown: FloatArray = picture.astype(self._setup["dtype"])
        return shown
