"""Whole run behind the variables of a co-simulation unit: world, links and all pilots in one process.

Outputs equal an observer's data. The operator's input crosses the operator's link.
"""

import msgspec

from bus.errors import ScenarioError
from bus.numbers import exact
from bus.registry import DRIVERS
from outrider.running.flying import InProcess, make_pilots
from outrider.running.user_code import own_code
from outrider_fmi.variables import (
    ALTITUDE,
    HEADING,
    OPERATOR,
    TRUE_ESCORT,
    TRUE_STATE,
    TWIST,
    Variable,
    of,
)
from outrider_fmi.vehicle_unit import Values, check_inputs, teleoperation_of, tick_at
from sim.scenario.checks import check_no_robot
from sim.scenario.kinematics import steers
from sim.scenario.types import Scenario
from sim.server.flight import Flight

_CERTIFIED = 6
"""Column of `Recorder.escorts`."""


def check_world(scenario: Scenario) -> None:
    """Reject a scenario that needs user code or another process.

    Raises:
        ScenarioError: If it needs one of them.
    """
    check_no_robot(scenario)
    for field, value in own_code(scenario).items():
        raise ScenarioError(
            f"{field} = {value!r}: a unit does not contain user code; allowed: scenarios without it"
        )
    for ugv in scenario.ugv:
        if not DRIVERS[ugv.driver].provided:
            raise ScenarioError(
                f"{ugv.name}: the driver {ugv.driver!r} runs in another process, which a unit does not start; allowed: "
                f"{', '.join(row.name for row in DRIVERS.values() if row.provided)}"
            )


class _Packed(msgspec.Struct, frozen=True):
    scenario: Scenario
    seed: int


def packed(scenario: Scenario) -> bytes:
    """Encode a run for a unit, in MessagePack because JSON lacks infinite bounds."""
    return msgspec.msgpack.encode(_Packed(scenario, scenario.seed))


def unpacked(flight: bytes) -> "WorldUnit":
    """Return the unit of an encoded run."""
    found = msgspec.msgpack.decode(flight, type=_Packed)
    return WorldUnit(found.scenario, found.seed)


class WorldUnit:
    """Run that advances one tick per step.

    Args:
        scenario: Scenario of the run.
        seed: Seed of all random numbers.

    Raises:
        ScenarioError: If the scenario needs more than a unit has.
    """

    def __init__(self, scenario: Scenario, seed: int) -> None:
        check_world(scenario)
        self._flight = Flight(scenario, seed)
        self._exchange = InProcess(make_pilots(scenario, seed))
        self.dt, self.duration = scenario.dt, scenario.duration
        """Length of a communication step, and duration of the run [s]."""
        self._driven = [ugv.name for ugv in scenario.ugv if DRIVERS[ugv.driver].operated]
        steering = {ugv.name for ugv in scenario.ugv if steers(ugv)}
        inputs = (of(name, TWIST if name in steering else OPERATOR) for name in self._driven)
        self.inputs: tuple[Variable, ...] = sum(inputs, ())
        states = (of(vehicle.name, TRUE_STATE) for vehicle in scenario.vehicles)
        heights = (of(uav.name, ALTITUDE) for uav in scenario.uav if scenario.has_altitude)
        escorts = (of(uav.name, TRUE_ESCORT) for uav in self._flight.world.uavs)
        headings = (of(name, HEADING) for name in self._flight.world.headings())
        self.outputs: tuple[Variable, ...] = sum((*states, *escorts, *heights, *headings), ())
        self.about = f"Run of the Outrider scenario {scenario.name!r}, seed {seed}"
        """Description for the importing tool."""

    def start(self) -> dict[str, float]:
        """Return the outputs before the first step."""
        return self._outputs()

    def step(self, time: float, size: float, values: Values) -> dict[str, float]:
        """Return the outputs at the end of a step; arguments as of `VehicleUnit.step`.

        Raises:
            ValueError: If the step is not the next tick, the run is over, or an input is invalid.
        """
        tick, flight = tick_at(time, size, self.dt), self._flight
        check_inputs(values)
        if flight.over:
            raise ValueError(
                f"a step from {exact(time)} s: the run ends at {exact(self.duration)} s; allowed: earlier steps"
            )
        if tick != flight.world.tick:
            raise ValueError(
                f"a step from {exact(time)} s; allowed: the next one, from {exact(flight.world.time)} s"
            )
        for name in self._driven:
            if values[f"{name}.operator.new"]:
                flight.teleoperate(name, teleoperation_of(values, f"{name}."))
        flight.fly_tick(self._exchange)
        return self._outputs()

    def _outputs(self) -> dict[str, float]:
        flight = self._flight
        flight.take_down()
        states, escorts = flight.recorder.states, flight.recorder.escorts
        now, before = states[-1].tolist(), states[-2:][0].tolist()
        applied = [[0.0, 0.0]] * len(now) if len(states) < 2 else [row[4:] for row in before]
        numbers = [value for k, row in enumerate(now) for value in (*row[:4], *applied[k])]
        for uav, row in enumerate(escorts[-1].tolist()):
            certified = len(escorts) > 1 and escorts[-2, uav, _CERTIFIED] == 1.0
            lost = flight.recorder.is_lost(flight.world.tick, uav)
            numbers += [row[0], row[1], certified, lost]
        numbers += flight.recorder.heights[-1, :, :2].ravel().tolist()
        numbers += flight.world.headings().values()
        return dict(zip((one.name for one in self.outputs), numbers, strict=True))
