"""Bodies outside the compiled tick: Python advances them between the motion of the references and the observations."""

import math
from collections.abc import Iterable

import numpy as np

from bus import plugins
from bus.errors import OutriderError
from bus.registry import BODIES, maker_of
from sim.compiling.compile import IntArray
from sim.compiling.records import RecordArray
from sim.engine.run_keys import keys_of_places
from sim.engine.world_state import BatchState
from sim.models.body import Body, Influences, Motion, ReferenceTick
from sim.models.randomness import BODY
from sim.models.reported import Reported
from sim.scenario.types import Scenario
from sim.scenario.vehicle_types import Uav


class Bodies:
    """Bodies of all UAVs in all worlds, except those that the compiled tick moves.

    Args:
        scenario: Scenario of each world.
        worlds: Number of worlds.
        secret: Secret of all random numbers, combined with each world's seed; empty: none.

    Raises:
        ScenarioError: If a package that a body needs is missing.
        OutriderError: If a body cannot be made for another reason.
    """

    def __init__(self, scenario: Scenario, worlds: int, secret: str = "") -> None:
        self._dt, self._secret = scenario.dt, secret
        self._uavs = [
            (row, one)
            for row, one in enumerate(scenario.vehicles)
            if isinstance(one, Uav) and BODIES[one.body].make
        ]
        self._bodies = [[_made(scenario, one) for _, one in self._uavs] for _ in range(worlds)]
        self._starts: dict[tuple[int, int], Motion] = {}

    def reported(self, world: int) -> dict[str, Reported]:
        """Return the bodies of a world that robots fly, by UAV."""
        bodies = zip(self._uavs, self._bodies[world], strict=True)
        return {uav.name: body for (_, uav), body in bodies if isinstance(body, Reported)}

    def begin(self, state: BatchState, worlds: IntArray, seeds: Iterable[int]) -> None:
        """Place the bodies of these worlds at the initial reference states.

        Args:
            state: State of all worlds, which have been reset.
            worlds: Indices of the worlds.
            seeds: Seed of each of them.
        """
        keys = keys_of_places(seeds, [(BODY, row) for row, _ in self._uavs], self._secret)
        for n, k in enumerate(worlds.tolist()):
            for b, (row, _) in enumerate(self._uavs):
                start = _reference(state.vehicles[k, row])
                self._starts[k, b] = start
                rng = np.random.Generator(np.random.Philox(key=keys[n, b]))
                self._bodies[k][b].reset(start, rng)

    def step(self, state: BatchState, worlds: IntArray) -> None:
        """Advance the bodies of these worlds, whose references have moved, and set the tracking errors.

        Raises:
            OutriderError: If a body cannot fly on; the message names the UAV and the time.
        """
        for k in worlds.tolist():
            for b, (row, uav) in enumerate(self._uavs):
                vehicle = state.vehicles[k, row]
                disturbance = vehicle["disturbance"]
                reference = ReferenceTick(self._starts[k, b], _reference(vehicle))
                influences = Influences(
                    tuple(disturbance["wind"].tolist()),
                    tuple(disturbance["position_error"].tolist()),
                )
                try:
                    with plugins.foreign():
                        true = self._bodies[k][b].step(reference, influences)
                    _check(true)
                except OutriderError as error:
                    time = state.ticks.item(k) * self._dt
                    raise OutriderError(
                        f"{uav.name} at {time:.2f} s: body {uav.body!r}: {error}"
                    ) from error
                self._starts[k, b] = reference.end
                body = self._bodies[k][b]
                disturbance["unknown"] = isinstance(body, Reported) and not body.current
                for i in range(2):
                    disturbance["error"][i] = true.position[i] - reference.end.position[i]
                    disturbance["error_rate"][i] = true.velocity[i] - reference.end.velocity[i]


def bodies_of(scenario: Scenario, worlds: int, secret: str) -> Bodies | None:
    """Return the bodies of worlds; None if the compiled tick moves all UAVs. Arguments as in `Bodies`."""
    if any(BODIES[uav.body].make for uav in scenario.uav):
        return Bodies(scenario, worlds, secret)
    return None


def _made(scenario: Scenario, uav: Uav) -> Body:
    make = maker_of(BODIES[uav.body])
    with plugins.foreign(f"{uav.name}: body {uav.body!r}"):
        body: Body = make(scenario, uav)
    return body


def _reference(vehicle: RecordArray) -> Motion:
    """Return the reference state of a vehicle."""
    x, y = vehicle["reference_position"].tolist()
    v_x, v_y = vehicle["reference_velocity"].tolist()
    vertical = vehicle["vertical"]
    return Motion((x, y, float(vertical["altitude"])), (v_x, v_y, float(vertical["rate"])))


def _check(motion: Motion) -> None:
    """Check the state that a body returns.

    Raises:
        OutriderError: If a number is not finite.
    """
    if not all(map(math.isfinite, (*motion.position, *motion.velocity))):
        raise OutriderError(
            f"position {motion.position}, velocity {motion.velocity}: not a state; allowed: finite numbers"
        )
