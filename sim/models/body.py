"""Body of a UAV outside the compiled tick: a model of its true motion below the reference state. SI units.

The commands move the reference state by (1). In each tick the simulator passes the reference's motion to the body, with
wind and position error, and receives the true motion. Their difference is the tracking error, as for the inner loop of
`sim.models.inner_loop`. A body lives in the simulator; no vehicle receives anything from it.

Runs are reproducible only if the body is a pure function of its arguments and its random numbers. The body of
`sim.models.reported` is the state that a robot's process reports.
"""

from typing import NamedTuple, Protocol

import numpy as np

Vector3 = tuple[float, float, float]
"""East, north, up."""


class Motion(NamedTuple):
    """Position and velocity at one instant."""

    position: Vector3
    """Position in the area, and altitude [m]; the altitude of a UAV in the plane is 0."""
    velocity: Vector3
    """Velocity [m/s]."""


class ReferenceTick(NamedTuple):
    """Motion of the reference in one tick, with a constant acceleration except at walls."""

    start: Motion
    """State at the start of the tick."""
    end: Motion
    """State at its end."""


class Influences(NamedTuple):
    """Causes of a tracking error, constant within a tick."""

    wind: tuple[float, float]
    """Acceleration of the wind [m/s²]."""
    position_error: tuple[float, float]
    """Error of the measured own position [m]: the body measures its true position plus this error."""


class Body(Protocol):
    """Body of one UAV, constructed from a `Scenario` and its `Uav`. A row of `bus.registry.BODIES` names the class."""

    def reset(self, start: Motion, rng: np.random.Generator) -> None:
        """Begin a run.

        Args:
            start: Motion of the reference at tick 0, which is also the true motion.
            rng: Random numbers of this body in this run; no other part draws from them.
        """

    def step(self, reference: ReferenceTick, influences: Influences) -> Motion:
        """Advance by one tick of `Scenario.dt` and return the true motion at its end.

        Args:
            reference: Motion of the reference in the tick.
            influences: Wind and position error in the tick.

        Raises:
            OutriderError: If the body cannot fly on: the cause in one line, without vehicle and time.
        """
        ...
