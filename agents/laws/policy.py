"""Learned policy that replaces a UAV's law, with the observation that the environment would give it."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from agents.asking import LARGEST, AskedPolicy, finite
from agents.team.roles import asked_role
from agents.uav_parameters import UavParameters
from bus.errors import ScenarioError
from bus.messages.base import Vector
from bus.messages.vehicle import UavBriefing, UavObservation
from bus.observations import ALTITUDE, GRADIENT, UAV, Row, clipped, names, team_table, without
from bus.ticks import DetectionRow, detection_rows
from sim.compiling.compile import FloatArray
from sim.models.field import coverage_gradient, sample
from sim.models.shadows import Occlusion

UavPolicy = Callable[[Any], object]
"""Function that maps a UAV's observations in a batch of worlds to its accelerations [m/s²].

Shape (worlds, 2); (worlds, 3) for a UAV that has an altitude. With `roles: "action"` in its setup, one more entry asks
for a role.

It may have a `setup`, the environment settings that define its observations (`SETUP`), and a method `fits`. `fits`
receives the briefing, raises a ValueError if the policy was made for another UAV, and returns warnings.
"""
SETUP: Mapping[str, Any] = {
    "estimate": False,
    "gradient": False,
    "omit": (),
    "coverage_patch": None,
    "dtype": np.float64,
    "duration": None,
    "roles": "rules",
}
"""Keys and defaults of a policy's setup, as in `outrider.vector_env`.

`duration` [s] is the length of its episodes; it replaces the age of a detection before the first one.
"""
_WORDS = {2: "two", 3: "three", 4: "four"}
_AXES = {2: "the acceleration x and y [m/s²]", 3: "the acceleration x, y and z [m/s²]"}


class TargetEstimate(NamedTuple):
    """Estimate of the UGV's position."""

    known: bool
    x: float
    y: float
    """Position [m]."""
    age: int
    """Ticks since the newest accepted measurement."""


def check_fit(briefing: UavBriefing, policy: UavPolicy, name: str) -> tuple[str, ...]:
    """Check whether a policy fits the UAV that it will fly.

    Returns:
        Warnings, one line each.

    Raises:
        ScenarioError: If its setup has an unknown key, or it was made for another UAV.
    """
    setup, fits = getattr(policy, "setup", {}), getattr(policy, "fits", None)
    unknown = [key for key in setup if key not in SETUP]
    if unknown:
        raise ScenarioError(
            f"uav_policy = {name!r}: setup: {unknown[0]!r}: unknown; allowed: {', '.join(SETUP)}"
        )
    try:
        warnings = () if fits is None else fits(briefing)
    except ValueError as error:
        raise ScenarioError(f"uav_policy = {name!r}: {briefing.vehicle}: {error}") from error
    return tuple(f"uav_policy = {name!r}: {briefing.vehicle}: {line}" for line in warnings)


class PolicyControl:
    """Policy control of one UAV: calls the policy at each tick with the UAV's observation.

    Row, estimate, gradient and coverage patch equal the environment's bit for bit. They are computed only from the
    observation, the filter's estimate and the UAV's own map.

    Args:
        briefing: Briefing of the UAV.
        uav: Constants of the UAV.
        policy: Policy; it may keep state of one UAV's flight.
        name: Name of the policy in errors.

    Raises:
        ScenarioError: As in `check_fit`.
    """

    def __init__(
        self, briefing: UavBriefing, uav: UavParameters, policy: UavPolicy, name: str
    ) -> None:
        check_fit(briefing, policy, name)
        self._uav, self._dt, self._area = uav, float(briefing.dt), briefing.area
        self._asked = AskedPolicy(policy, f"uav_policy = {name!r}", self._dt)
        self._setup = {**SETUP, **getattr(policy, "setup", {})}
        length = self._setup["duration"]
        self.never = np.inf if length is None else float(length)
        """Age of what was never received [s]."""
        self._newest = -1
        self.sensor = uav.sensor
        """Sensor of the UAV at its altitude."""
        self.occlusion: Occlusion | None = None
        """Known buildings as the UAV sees them; None: there are none."""
        self._climbs = briefing.altitude is not None
        self._table = UAV
        if self._climbs:
            self._table += ALTITUDE
        if self._setup["gradient"]:
            self._table += GRADIENT
        self._table += team_table(len(briefing.mates))
        self._asks_role = bool(briefing.mates) and self._setup["roles"] == "action"
        self.request = 0
        """Request for a role in the last answer, see `TeamInputs`; it counts in the next tick."""
        self.team: FloatArray = np.zeros(0)
        """Team entries of the row in this tick, see `agents.team.row`; empty: it has no team."""
        kept = names(without(self._table, self._setup["omit"]))
        self._columns = [k for k, name in enumerate(names(self._table)) if name in kept]
        self.vertical = 0.0
        """Vertical acceleration of the last answer [m/s²]; 0 for a UAV that flies in the plane."""
        patch = self._setup["coverage_patch"]
        self._pixels, self._scale = (0, 1.0) if patch is None else (int(patch[0]), float(patch[1]))

    def perceive(self, observation: UavObservation) -> None:
        """Record the detections of a tick, whether or not it is answered."""
        for detection in self._detections(observation):
            self._newest = max(self._newest, detection.taken)

    def _detections(self, observation: UavObservation) -> Iterator[DetectionRow]:
        detections = detection_rows(observation.detections, self._dt)
        return (detection for detection in detections if 0 <= detection.taken <= observation.tick)

    def acceleration(
        self, observation: UavObservation, target: TargetEstimate, coverage: FloatArray
    ) -> Vector:
        """Return the acceleration [m/s²] for this observation, after `perceive`.

        Args:
            observation: Observation of the UAV.
            target: Estimate of the UGV.
            coverage: The UAV's own coverage map. Shape (rows, columns).

        Raises:
            ScenarioError: If the policy raises, or does not return two finite numbers; a third one for a UAV that has
                an altitude is `vertical`, and a last one, if it asks for a role, is `request`.
        """
        tick = observation.tick
        row = self._row(observation, target, coverage).astype(self._setup["dtype"])[None]
        seen = {"row": row, "coverage": self._patch(observation, coverage)} if self._pixels else row
        answer = self._asked.answer(tick, seen)
        axes = 3 if self._climbs else 2
        count = axes + self._asks_role
        found = finite(answer, (1, count))
        if found is None or max(map(abs, found)) > LARGEST:
            wanted = _AXES[axes] + (", and the request for a role" if self._asks_role else "")
            allowed = f"{_WORDS[count]} finite numbers for each world, here of shape (1, {count}), {wanted}"
            raise self._asked.invalid_answer(tick, answer, allowed)
        self.vertical = found[2] if self._climbs else 0.0
        self.request = asked_role(found[-1]) if self._asks_role else 0
        return found[0], found[1]

    def _row(
        self, observation: UavObservation, target: TargetEstimate, coverage: FloatArray
    ) -> Row:
        time, (x, y) = observation.tick * self._dt, observation.position
        best = max(
            self._detections(observation), key=lambda detection: detection.taken, default=None
        )
        newest = self._newest if best is None else best.taken
        age = self.never if newest < 0 else time - newest * self._dt
        seen = (0.0, 0.0, 0.0, age) if best is None else (1.0, best.x, best.y, age)
        if target.known and self._setup["estimate"]:
            seen = 1.0, x - target.x, y - target.y, target.age * self._dt
        entries = [time, x, y, *observation.velocity, *seen]
        if self._climbs:
            entries += [observation.altitude or 0.0, observation.climb_rate]
        if self._setup["gradient"]:
            entries += self._gradient(x, y, target, coverage)
        entries += self.team.tolist()
        row = clipped(self._table, np.array(entries, dtype=np.float64), self._area, self._dt)
        return row[self._columns]

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
            self.sensor,
            c.cell,
            self.occlusion,
        )
        return (u_x / size, u_y / size) if size > 0.0 else (0.0, 0.0)

    def _patch(self, observation: UavObservation, coverage: FloatArray) -> FloatArray:
        picture: FloatArray = np.empty((1, self._pixels, self._pixels))
        c = self._uav
        sample(coverage, *observation.position, c.desired_coverage, c.cell, self._scale, picture[0])
        shown: FloatArray = picture.astype(self._setup["dtype"])
        return shown
