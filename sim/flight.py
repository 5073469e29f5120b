"""A flight: the world and the vehicles' answers, tick by tick, however the answers travel.

The same loop serves the pilots in this process and the three processes over the bus, so both fly the same bits.
"""

from array import array
from collections import defaultdict
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from bus.messages import (
    Command,
    Detection,
    Drive,
    EscortTruth,
    Law,
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


@dataclass(slots=True)
class News:
    """What a vehicle is told at one tick besides what it perceives."""

    operator: tuple[Drive, ...] = ()
    driver: str | None = None
    law: Law | None = None


_NO_NEWS = News()


class Exchange(Protocol):
    """How observations reach the vehicles and commands come back."""

    def begin(self, tick: int) -> None:
        """A tick begins; what operators want is done before its observations are made."""

    def publish(self, observations: Mapping[str, Observation]) -> None:
        """Give each vehicle its observation of this tick."""

    def collect(self, tick: int) -> Mapping[str, Command]:
        """The newest command of each vehicle that has a new one; none answers a later tick than this."""


def _looks(time: float, found: list[float]) -> tuple[Detection, ...]:
    """The detection of one tick, if there was one."""
    return (Detection(time=time, relative_position=(found[0], found[1])),) if found[0] == found[0] else ()


class Flight:
    """One run from its first tick to its last.

    Args:
        scenario: What is flown.
        seed: Of all random numbers.
        episode: Which flight of the run it is.
    """

    def __init__(self, scenario: Scenario, seed: int, *, episode: int = 0) -> None:
        self.scenario = scenario
        self.seed = seed
        self.episode = episode
        self.law = scenario.law
        """What the UAVs fly now."""
        self.drivers = {ugv.name: ugv.driver for ugv in scenario.ugv}
        """Who drives each UGV now."""
        self._news: dict[str, dict[int, News]] = defaultdict(dict)
        self.world = World(scenario, seed)
        self.recorder = Recorder(self.world)
        self.missing: dict[str, int] = dict.fromkeys(self.world.names, 0)
        """Ticks for which a vehicle had no new command."""
        self.stale: dict[str, int] = dict.fromkeys(self.world.names, 0)
        """Commands of a vehicle that were used after the tick they answer."""
        self.first_missing: int | None = None
        """The first tick at which a vehicle's command was missing or stale."""
        self.reports: list[UavReport | None] = [None] * len(self.world.uavs)
        """What each UAV last said of itself."""
        self._stopped = self._abandoned = False
        self._ticks = scenario.ticks
        self.commands: FloatArray = np.zeros((len(self.world.names), 2))
        """What each vehicle was asked for in the last tick, before the bounds [m/s²]; shape (vehicles, 2)."""
        self._answered = [-1] * len(self.world.names)  # the tick that each vehicle's newest command answers
        self._hold_ticks = round(scenario.hold / scenario.dt)
        self._uav_row = {uav.name: k for k, uav in enumerate(self.world.uavs)}
        self._radio: dict[str, list[RelativeInformation]] = {name: [] for name in self.world.names}
        self._heard = {ugv.name: array("d") for ugv in scenario.ugv}  # tick, time, relative position, error; message by message

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

    def abandon(self) -> None:
        """End the flight at once, and tell the vehicles nothing: another begins."""
        self._stopped = self._abandoned = True

    def _news_of(self, name: str) -> News:
        return self._news[name].setdefault(self.world.tick, News())

    def say(self, ugv: str, words: Drive) -> None:
        """An operator's words reach a UGV with the coming observation."""
        news = self._news_of(ugv)
        news.operator = (*news.operator, words)

    def seat(self, ugv: str, driver: str) -> None:
        """Another driver takes a UGV's wheel with the coming observation."""
        self._news_of(ugv).driver = self.drivers[ugv] = driver

    def order(self, law: Law) -> None:
        """The UAVs fly another law from the coming observation on."""
        self.law = law
        for uav in self.world.uavs:
            self._news_of(uav.name).law = law

    def observations(self) -> dict[str, Observation]:
        """What each vehicle perceives at this tick: its own row and nothing else."""
        world = self.world
        tick, time, over = world.tick, world.time, self.over
        positions, velocities = world.position.tolist(), world.velocity.tolist()
        detections = world.detections.tolist()
        seen: dict[str, Observation] = {}
        for k, name in enumerate(world.names):
            position, velocity = tuple(positions[k]), tuple(velocities[k])
            news = self._news[name].get(tick, _NO_NEWS) if self._news else _NO_NEWS
            if name in self._uav_row:
                seen[name] = UavObservation(
                    tick=tick,
                    time=time,
                    position=position,
                    velocity=velocity,
                    detections=_looks(time, detections[self._uav_row[name]]),
                    law=news.law,
                    over=over,
                    episode=self.episode,
                )
            else:
                seen[name] = UgvObservation(
                    tick=tick,
                    time=time,
                    position=position,
                    velocity=velocity,
                    radio=tuple(self._radio[name]),
                    operator=news.operator,
                    driver=news.driver,
                    over=over,
                    episode=self.episode,
                )
        return seen

    def past(self, name: str, begin: int, end: int, unheard: Collection[int]) -> tuple[Observation, ...]:
        """What a vehicle has perceived from tick `begin` up to `end`, for a process that joins again.

        Args:
            name: The vehicle.
            begin: First tick.
            end: The tick after the last one; all must have been recorded.
            unheard: Ticks whose observation it was not sent: of those it is told its own motion, law and driver and nothing else.
        """
        k, dt = self.world.names.index(name), self.world.parameters.dt
        states = self.recorder.states[begin:end, k, :4].tolist()
        uav = self._uav_row.get(name)
        found = self.recorder.escorts[begin:end, uav, 2:4].tolist() if uav is not None else []
        heard = self._heard_between(name, begin, end) if uav is None else {}
        seen: list[Observation] = []
        for tick, (x, y, v_x, v_y) in enumerate(states, begin):
            time, known = tick * dt, tick not in unheard
            news = self._news[name].get(tick, _NO_NEWS)
            if uav is not None:
                seen.append(
                    UavObservation(
                        tick=tick,
                        time=time,
                        position=(x, y),
                        velocity=(v_x, v_y),
                        detections=_looks(time, found[tick - begin]) if known else (),
                        law=news.law,
                        episode=self.episode,
                    )
                )
            else:
                seen.append(
                    UgvObservation(
                        tick=tick,
                        time=time,
                        position=(x, y),
                        velocity=(v_x, v_y),
                        radio=tuple(heard.get(tick, ())) if known else (),
                        operator=news.operator if known else (),
                        driver=news.driver,
                        episode=self.episode,
                    )
                )
        return tuple(seen)

    def _heard_between(self, name: str, begin: int, end: int) -> dict[int, list[RelativeInformation]]:
        messages: dict[int, list[RelativeInformation]] = {}
        rows = np.frombuffer(self._heard[name]).reshape(-1, 5)
        for tick, time, x, y, error in rows[(rows[:, 0] >= begin) & (rows[:, 0] < end)].tolist():
            message = RelativeInformation(time=time, relative_position=(x, y), coverage_error=error)
            messages.setdefault(int(tick), []).append(message)
        return messages

    def _take(self, k: int, name: str, command: Command | None) -> None:
        """Put a vehicle's command in its row; hold the last one for a while where there is no new one, then brake."""
        tick = self.world.tick
        if command is not None:
            self._answered[k] = command.tick
            self.commands[k] = command.acceleration
            self.stale[name] += command.tick < tick
        else:
            self.missing[name] += 1
        age = tick - self._answered[k]
        if age and self.first_missing is None:
            self.first_missing = tick
        if age > self._hold_ticks:
            v_x, v_y = self.world.velocity[k].tolist()
            self.commands[k] = brake(v_x, v_y, float(self.world.bounds[k, 1]), self.scenario.dt)

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
                    self._pass_on(self.world.uavs[uav].escorts, command.radio)
        self.world.step(self.commands)

    def _pass_on(self, ugv: str, messages: tuple[RelativeInformation, ...]) -> None:
        """What a UAV has radioed reaches its UGV at the next tick."""
        self._radio[ugv].extend(messages)
        for message in messages:
            row = (self.world.tick + 1, message.time, *message.relative_position, message.coverage_error)
            self._heard[ugv].extend(row)

    def _goes_on(self) -> bool:
        """Whether nobody has stopped it meanwhile."""
        return not self._stopped

    def fly(self, exchange: Exchange, *, on_tick: Callable[[], None] | None = None) -> None:
        """Fly to the end.

        Args:
            exchange: How observations and commands travel.
            on_tick: Called after each tick.
        """
        while not self.over:
            exchange.begin(self.world.tick)
            if not self._goes_on():
                break
            exchange.publish(self.observations())
            self.recorder.record(self.reports)  # while the vehicles think
            commands = exchange.collect(self.world.tick)
            if not self._goes_on():
                break
            self.apply(commands)
            if on_tick is not None:
                on_tick()
        self.recorder.record(self.reports)
        if not self._abandoned:
            exchange.publish(self.observations())

    def truth(self) -> Truth:
        """Everything but the grid, for observers."""
        world = self.world
        arrays = (world.position, world.velocity, world.acceleration, self.commands)
        rows = zip(*(rows.tolist() for rows in arrays), strict=True)
        measures, detections = world.measure().tolist(), world.detections.tolist()
        return Truth(
            tick=world.tick,
            time=world.time,
            vehicles={
                name: VehicleTruth(position=tuple(p), velocity=tuple(v), acceleration=tuple(u), command=tuple(c))
                for name, (p, v, u, c) in zip(world.names, rows, strict=True)
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
