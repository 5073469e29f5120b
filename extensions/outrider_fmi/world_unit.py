"""A whole flight behind the variables of a co-simulation unit: world, links and all pilots, as in one process.

It tells what an observer is told. An operator's wish crosses the operator's link, as everybody's.
"""

import msgspec

from bus.errors import ScenarioError
from bus.messages.vehicle import Teleoperation
from bus.registry import DRIVERS
from outrider.running.flying import InProcess, make_pilots
from outrider.running.user_code import own_code
from outrider_fmi.variables import OPERATOR, TRUE_ESCORT, TRUE_STATE, Variable, of
from outrider_fmi.vehicle_unit import Values, check_inputs, pair, tick_at
from sim.scenario.types import Scenario
from sim.server.flight import Flight

_CERTIFIED = 6
"""Column of `Recorder.escorts`."""


def check_world(scenario: Scenario) -> None:
    """Refuse a scenario that needs code of the user's own.

    Raises:
        ScenarioError: If it does.
    """
    for field, value in own_code(scenario).items():
        raise ScenarioError(
            f"{field} = {value!r}: a unit does not carry code of your own; allowed: scenarios without it"
        )
    for ugv in scenario.ugv:
        if not DRIVERS[ugv.driver].provided:
            raise ScenarioError(
                f"{ugv.name}: the driver {ugv.driver!r} is another process, which a unit does not start; allowed: "
                f"{', '.join(row.name for row in DRIVERS.values() if row.provided)}"
            )


class _Packed(msgspec.Struct, frozen=True):
    scenario: Scenario
    seed: int


def packed(scenario: Scenario) -> bytes:
    """A flight as a unit carries it, in MessagePack: JSON has no infinite bounds."""
    return msgspec.msgpack.encode(_Packed(scenario, scenario.seed))


def unpacked(flight: bytes) -> "WorldUnit":
    """The unit of such a flight."""
    found = msgspec.msgpack.decode(flight, type=_Packed)
    return WorldUnit(found.scenario, found.seed)


class WorldUnit:
    """A flight, a tick a step.

    Args:
        scenario: What is flown.
        seed: Of all random numbers.

    Raises:
        ScenarioError: If it needs more than a unit has.
    """

    def __init__(self, scenario: Scenario, seed: int) -> None:
        check_world(scenario)
        self._flight = Flight(scenario, seed)
        self._exchange = InProcess(make_pilots(scenario, seed))
        self.dt, self.duration = scenario.dt, scenario.duration
        """Of a communication step and of the flight [s]."""
        self._driven = [ugv.name for ugv in scenario.ugv if DRIVERS[ugv.driver].operated]
        self.inputs: tuple[Variable, ...] = sum((of(name, OPERATOR) for name in self._driven), ())
        states = (of(vehicle.name, TRUE_STATE) for vehicle in scenario.vehicles)
        escorts = (of(uav.name, TRUE_ESCORT) for uav in self._flight.world.uavs)
        self.outputs: tuple[Variable, ...] = sum((*states, *escorts), ())
        self.about = f"The flight {scenario.name!r} of Outrider, seed {seed}"
        """Description for whoever imports it."""

    def start(self) -> dict[str, float]:
        """The outputs before the first step."""
        return self._told()

    def step(self, time: float, size: float, values: Values) -> dict[str, float]:
        """The outputs at the end of a step; arguments as of `VehicleUnit.step`.

        Raises:
            ValueError: If it is not the next tick, there is none any more, or an input is not what it may be.
        """
        tick, flight = tick_at(time, size, self.dt), self._flight
        check_inputs(values)
        if flight.over:
            raise ValueError(
                f"the flight is over at {self.duration:g} s; allowed: steps up to there"
            )
        if tick != flight.world.tick:
            raise ValueError(
                f"a step from {time:g} s; allowed: the next one, from {flight.world.time:g} s"
            )
        for name in self._driven:
            if values[f"{name}.operator.new"]:
                wanted = pair(values, f"{name}.operator.velocity")
                flight.teleoperate(name, Teleoperation(operator="fmi", velocity=wanted))
        flight.fly_tick(self._exchange)
        return self._told()

    def _told(self) -> dict[str, float]:
        flight = self._flight
        flight.recorder.record(flight.answers.reports)
        states, escorts = flight.recorder.states, flight.recorder.escorts
        now, before = states[-1].tolist(), states[-2:][0].tolist()
        applied = [[0.0, 0.0]] * len(now) if len(states) < 2 else [row[4:] for row in before]
        numbers = [value for k, row in enumerate(now) for value in (*row[:4], *applied[k])]
        for uav, row in enumerate(escorts[-1].tolist()):
            certified = len(escorts) > 1 and escorts[-2, uav, _CERTIFIED] == 1.0
            lost = row[0] >= flight.scenario.visibility.radius
            numbers += [row[0], row[1], certified, lost]
        return dict(zip((one.name for one in self.outputs), numbers, strict=True))
