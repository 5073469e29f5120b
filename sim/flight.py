"""A flight: the world and the vehicles' answers, tick by tick, however the answers travel.

The same loop serves the pilots in this process and the three processes over the bus, so both fly the same bits.
"""

from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np

from bus.messages import (
    Command,
    Detection,
    EscortTruth,
    Observation,
    RelativeInformation,
    Truth,
    UavCommand,
    UavObservation,
    UavReport,
    UgvObservation,
    VehicleTruth,
)
from sim.compile import FloatArray
from sim.recorder import Recorder
from sim.scenario import Scenario
from sim.vehicles import brake
from sim.world import World


class Exchange(Protocol):
    """How observations reach the vehicles and commands come back."""

    def publish(self, observations: Mapping[str, Observation]) -> None:
        """Give each vehicle its observation of this tick."""

    def collect(self, tick: int) -> Mapping[str, Command]:
        """The commands for this tick; a vehicle without a usable one is missing."""


class Flight:
    """One run from its first tick to its last.

    Args:
        scenario: What is flown.
        seed: Of all random numbers.
    """

    def __init__(self, scenario: Scenario, seed: int) -> None:
        self.scenario = scenario
        self.seed = seed
        self.world = World(scenario, seed)
        self.recorder = Recorder(self.world)
        self.missing: dict[str, int] = dict.fromkeys(self.world.names, 0)
        """Ticks for which a vehicle had no usable command."""
        self.first_missing: int | None = None
        """The first such tick."""
        self.reports: list[UavReport | None] = [None] * len(self.world.uavs)
        """What each UAV last said of itself."""
        self._stopped = False
        self._ticks = scenario.ticks
        self._commands: FloatArray = np.zeros((len(self.world.names), 2))
        self._silent = np.zeros(len(self.world.names), dtype=np.int64)  # ticks since the last command
        self._hold_ticks = round(scenario.hold / scenario.dt)
        self._uav_row = {uav.name: k for k, uav in enumerate(self.world.uavs)}
        self._radio: dict[str, list[RelativeInformation]] = {name: [] for name in self.world.names}

    @property
    def complete(self) -> bool:
        """Whether the scenario's last tick has been flown."""
        return self.world.tick >= self._ticks

    @property
    def over(self) -> bool:
        """Whether nothing more is flown: complete, or stopped."""
        return self._stopped or self.complete

    def stop(self) -> None:
        """End the flight before the next command acts."""
        self._stopped = True

    def observations(self) -> dict[str, Observation]:
        """What each vehicle perceives at this tick: its own row and nothing else."""
        world = self.world
        tick, time, over = world.tick, world.time, self.over
        positions, velocities = world.position.tolist(), world.velocity.tolist()
        detections = world.detections.tolist()
        seen: dict[str, Observation] = {}
        for k, name in enumerate(world.names):
            position, velocity = tuple(positions[k]), tuple(velocities[k])
            if name in self._uav_row:
                found = detections[self._uav_row[name]]
                looks = (Detection(time=time, relative_position=tuple(found)),) if found[0] == found[0] else ()
                seen[name] = UavObservation(
                    tick=tick, time=time, position=position, velocity=velocity, detections=looks, over=over
                )
            else:
                radio = tuple(self._radio[name])
                seen[name] = UgvObservation(tick=tick, time=time, position=position, velocity=velocity, radio=radio, over=over)
        return seen

    def _take(self, k: int, name: str, command: Command | None) -> None:
        """Put a vehicle's command in its row; hold the last one for a while where there is none, then brake."""
        if command is not None:
            self._silent[k] = 0
            self._commands[k] = command.acceleration
            return
        self.missing[name] += 1
        if self.first_missing is None:
            self.first_missing = self.world.tick
        self._silent[k] += 1
        if self._silent[k] > self._hold_ticks:
            v_x, v_y = self.world.velocity[k].tolist()
            self._commands[k] = brake(v_x, v_y, float(self.world.bounds[k, 1]), self.scenario.dt)

    def apply(self, commands: Mapping[str, Command]) -> None:
        """Let these commands act for one tick; messages that the UAVs radio arrive at the next one."""
        for messages in self._radio.values():
            messages.clear()
        for k, name in enumerate(self.world.names):
            command = commands.get(name)
            self._take(k, name, command)
            uav = self._uav_row.get(name)
            if uav is not None:
                self.reports[uav] = None
                if isinstance(command, UavCommand):
                    self.reports[uav] = command.report
                    self._radio[self.world.uavs[uav].escorts].extend(command.radio)
        self.world.step(self._commands)

    def fly(self, exchange: Exchange, *, on_tick: Callable[[], None] | None = None) -> None:
        """Fly to the end.

        Args:
            exchange: How observations and commands travel.
            on_tick: Called after each tick.
        """
        while not self.over:
            exchange.publish(self.observations())
            self.recorder.record(self.reports)  # while the vehicles think
            commands = exchange.collect(self.world.tick)
            if self._stopped:
                break
            self.apply(commands)
            if on_tick is not None:
                on_tick()
        self.recorder.record(self.reports)
        exchange.publish(self.observations())

    def truth(self) -> Truth:
        """Everything but the grid, for observers."""
        world = self.world
        rows = zip(world.position.tolist(), world.velocity.tolist(), world.acceleration.tolist(), strict=True)
        measures, detections = world.measure().tolist(), world.detections.tolist()
        return Truth(
            tick=world.tick,
            time=world.time,
            vehicles={
                name: VehicleTruth(position=tuple(p), velocity=tuple(v), acceleration=tuple(u))
                for name, (p, v, u) in zip(world.names, rows, strict=True)
            },
            escorts=tuple(
                EscortTruth(
                    uav=uav.name,
                    ugv=uav.escorts,
                    distance=measures[k][0],
                    coverage_error=max(0.0, measures[k][1]),
                    detection=tuple(detections[k]) if detections[k][0] == detections[k][0] else None,
                    report=self.reports[k],
                )
                for k, uav in enumerate(world.uavs)
            ),
        )


def warm_up(scenario: Scenario) -> None:
    """Let all that a flight compiles be compiled or loaded, with a world that nobody sees."""
    flight = Flight(scenario, scenario.seed)
    flight.recorder.record(flight.reports)
    flight.apply({})
    flight.observations()
