"""Body of a UAV that a robot flies: its process reports the true state. SI units."""

import math
from typing import Protocol

import numpy as np

from bus.messages.robot import MAX_STATE_AGE
from sim.models.body import Influences, Motion, ReferenceTick

_ROUNDING = 1e-9
"""Relative tolerance of the age, a multiple of the tick."""


class _Timed(Protocol):
    """Scenario with a length of its ticks."""

    @property
    def dt(self) -> float:
        """Length of a tick [s]."""


class Reported:
    r"""Body whose true state is the newest reported one, extrapolated by its velocity.

    $$ p(t) = p_r + v_r \min(t - t_r, T), \quad T = 1\,\text{s} $$

    Older states are unknown: the body then stays where the extrapolation ended. Wind and position error of the scenario
    do not act, since the robot has its own.

    Args:
        scenario: Scenario of the run.
        _uav: Its UAV.
    """

    def __init__(self, scenario: _Timed, _uav: object) -> None:
        self._dt = scenario.dt
        self._still = (0.0, 0.0, 0.0)
        self.current = False
        """True if the state at this tick follows from a report that is recent enough."""

    def reset(self, start: Motion, _rng: np.random.Generator) -> None:
        """Begin a run at rest, without a report."""
        self.receive(Motion(start.position, self._still), math.inf)
        self.current = False

    def receive(self, state: Motion, age: float) -> None:
        """Receive a report.

        Args:
            state: State of the robot.
            age: Its age at the next tick [s].
        """
        self._newest, self._age, self._ticks = state, age, 0

    def step(self, _reference: ReferenceTick, _influences: Influences) -> Motion:
        """Advance by one tick and return the true motion at its end; the reference does not matter."""
        age = self._age + self._ticks * self._dt
        self._ticks += 1
        self.current = age <= MAX_STATE_AGE * (1.0 + _ROUNDING)
        (x, y, z), velocity = self._newest
        bridged = min(age, MAX_STATE_AGE)
        v_x, v_y, v_z = velocity
        place = (x + v_x * bridged, y + v_y * bridged, z + v_z * bridged)
        return Motion(place, velocity if self.current else self._still)
