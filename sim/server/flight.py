"""A flight: the world and the vehicles' answers, tick by tick, however the answers travel.

The same loop serves the pilots in this process and the three processes over the bus, so both fly the same bits.
"""

import logging
from collections.abc import Callable, Collection, Mapping
from typing import Protocol

import msgspec

from bus.messages.base import Vector
from bus.messages.control import Action, Change, Control
from bus.messages.ground import MapUpdate
from bus.messages.links import LinkKind, LinkSettings
from bus.messages.scenario import Law
from bus.messages.telemetry import EscortTruth, Status, Truth, VehicleTruth
from bus.messages.vehicle import (
    BackupTrajectory,
    Command,
    Observation,
    Teleoperation,
    UavCommand,
    UgvCommand,
)
from sim.compiling.compile import FloatArray
from sim.scenario.types import NO_UAV, Scenario, Uav
from sim.server.answers import Answers
from sim.server.perception import News, Perception, UavPerception, UgvPerception
from sim.server.radio import Radio
from sim.server.recorder import Recorder
from sim.world import World


class Exchange(Protocol):
    """Takes observations to the vehicles and brings commands back."""

    def begin(self, tick: int) -> None:
        """A tick begins; what operators want is done before its observations are made."""

    def publish(self, observations: Mapping[str, Observation]) -> None:
        """Give each vehicle its observation of this tick."""

    def collect(self, tick: int) -> Mapping[str, Command]:
        """The newest command of each vehicle that has a new one; none answers a later tick than this."""


_LOG = logging.getLogger("outrider.sim")
EXTERNAL = "external"
"""The law of a UAV, and the driver of a UGV, that is a program of the user's own."""


def law_title(scenario: Scenario, external: Collection[str]) -> str:
    """The scenario's law for a person: `external` where programs of the user's own fly instead, `no UAV` without any.

    Args:
        scenario: What is flown.
        external: The UAVs that such programs fly.
    """
    if not scenario.uav:
        return NO_UAV
    if len(external) == len(scenario.uav):
        return EXTERNAL
    own = " and ".join(sorted(external))
    return f"{scenario.law.name}, {own} {EXTERNAL}" if own else scenario.law.name


class Flight:
    """One run from its first tick to its last.

    Args:
        scenario: What is flown.
        seed: Of all random numbers, with the secret.
        secret: Of the run; empty: none. No vehicle, operator or observer is told.
        episode: Which flight of the run it is.
        on_notice: Called with one line for a person.
    """

    def __init__(
        self,
        scenario: Scenario,
        seed: int,
        *,
        secret: str = "",
        episode: int = 0,
        on_notice: Callable[[str], None] = _LOG.warning,
    ) -> None:
        self.scenario = scenario
        self.seed = seed
        self.secret = secret
        self.episode = episode
        self.law = scenario.law
        """The law that the UAVs fly now."""
        self.drivers = {ugv.name: ugv.driver for ugv in scenario.ugv}
        """The driver of each UGV now."""
        self.world = World(scenario, seed, secret=secret)
        self.recorder = Recorder(self.world)
        self.perceptions: dict[str, Perception] = {
            vehicle.name: (UavPerception if isinstance(vehicle, Uav) else UgvPerception)(
                self.world, vehicle.name, episode
            )
            for vehicle in scenario.vehicles
        }
        """The perception of each vehicle, in name order."""
        self.on_notice = on_notice
        self._answers = Answers(scenario, self.world, self.recorder, on_notice)
        self.routes: dict[str, tuple[Vector, ...]] = {}
        """The way that each UGV has told that it plans, by its corners [m]; for observers."""
        self.degradations: list[Change] = []
        """Changes of links in flight, with their ticks."""
        self._stopped = self._abandoned = False
        self._ticks = scenario.ticks
        self._uav_row = {uav.name: k for k, uav in enumerate(self.world.uavs)}
        self.radio = Radio(self.world)
        """Sends what the UAVs radio."""
        self._listened = -1

    @property
    def commands(self) -> FloatArray:
        """The command of each vehicle in the last tick, before the bounds [m/s²]; shape (vehicles, 2)."""
        return self.world.commands

    @property
    def answers(self) -> Answers:
        """All that is known of the vehicles' answers, up to the last tick."""
        self._answers.settle()
        return self._answers

    @property
    def flown(self) -> Scenario:
        """The scenario with the law that the UAVs fly now."""
        return msgspec.structs.replace(self.scenario, law=self.law)

    @property
    def law_name(self) -> str:
        """The law for a person, as `law_title` gives it."""
        return law_title(self.scenario, self.answers.external)

    @property
    def complete(self) -> bool:
        """True once the scenario's last tick has been flown."""
        return self.world.tick >= self._ticks

    @property
    def over(self) -> bool:
        """True once nothing more is flown: complete, or stopped."""
        return self._stopped or self.complete

    def stop(self) -> None:
        """End the flight before the next command acts."""
        self._stopped = True

    def abandon(self) -> None:
        """End the flight at once, and tell the vehicles nothing: another begins."""
        self._stopped = self._abandoned = True

    def say(self, ugv: str, words: Teleoperation) -> None:
        """An operator says something to a UGV; its link brings it there, at once or later."""
        tick, links = self.world.tick, self.world.links
        links.send_object(links.row(LinkKind.OPERATOR, ugv), tick, words, tick)

    def assign_driver(self, ugv: str, driver: str) -> None:
        """Another driver takes a UGV's wheel with the coming observation."""
        self.perceptions[ugv].news_now().driver = self.drivers[ugv] = driver

    def order(self, law: Law) -> None:
        """The UAVs fly another law from the coming observation on."""
        self.law = law
        for uav in self.world.uavs:
            self.perceptions[uav.name].news_now().law = law
            self.answers.assurance.excuse(self._uav_row[uav.name])

    def rejoin(self, name: str) -> None:
        """A vehicle's process has joined again: a new pilot, which knows what it is told of its past."""
        if name in self._uav_row:
            self.answers.assurance.excuse(self._uav_row[name])

    def status(self) -> Status:
        """The status of the flight; the server adds its pace and the state of the vehicles' processes."""
        told = zip(self.world.uavs, self.answers.reports, strict=True)
        decisions = {
            uav.name: report.decision
            for uav, report in told
            if report is not None and report.decision is not None
        }
        return Status(
            scenario=self.scenario.name,
            seed=self.seed,
            tick=self.world.tick,
            ticks=self.scenario.ticks,
            time=self.world.time,
            realtime_factor=0.0,
            law=self.law.name,
            drivers=dict(self.drivers),
            certified={name: one.certified for name, one in decisions.items()},
            uncertified={
                name: one.reason for name, one in decisions.items() if one.reason is not None
            },
            certificates=self.answers.assurance.status(),
            mission=self.world.mission,
            links=self.world.links.status(),
            vehicles={name: self.answers.counted(name) for name in self.world.names},
            over=self.over,
        )

    def news(self, tick: int) -> dict[str, News]:
        """The news of a tick, by vehicle; only those that were told something."""
        return {name: one.news[tick] for name, one in self.perceptions.items() if tick in one.news}

    def degrade(self, kind: LinkKind, vehicle: str | None, settings: LinkSettings) -> None:
        """Links have other settings from now on.

        Raises:
            ScenarioError: If the settings are impossible, or this vehicle has no such link.
        """
        self.world.change_links(kind, vehicle, settings)
        control = Control(action=Action.LINK, link=kind, vehicle=vehicle, settings=settings)
        self.degradations.append(Change(tick=self.world.tick, control=control))

    def _listen(self) -> None:
        """Take in what has crossed the links for this tick, once."""
        tick = self.world.tick
        if self._listened == tick:
            return
        self._listened = tick
        for perception in self.perceptions.values():
            perception.receive(tick)

    def observations(self) -> dict[str, Observation]:
        """The observation of each vehicle at this tick."""
        self._listen()
        over, observations = self.over, {}
        for name, perception in self.perceptions.items():
            observations[name] = perception.observe(over=over)
        return observations

    def past(
        self, name: str, begin: int, end: int, missed: Collection[int]
    ) -> tuple[Observation, ...]:
        """The observations of a vehicle from tick `begin` up to `end`, for a process that joins again.

        Args:
            name: The vehicle.
            begin: First tick.
            end: The tick after the last one; all must have been recorded.
            missed: Ticks whose observation it was not sent.
        """
        perception = self.perceptions[name]
        told = self.recorder.told[begin:end, perception.row]
        return perception.past(begin, end, told, missed)

    def apply(self, commands: Mapping[str, Command]) -> None:
        """Let these commands set out, and what has arrived act for one tick.

        What the UAVs radio arrives at the next one.
        """
        self._listen()
        self.take_down()  # what is said of this tick is held against it
        world = self.world
        for k, name in enumerate(world.names):
            command = commands.get(name)
            if world.ground is not None and name not in self._uav_row:
                report = command.report if isinstance(command, UgvCommand) else None
                world.note_claim(k, report if command and command.tick == world.tick else None)
            if command is None:
                continue
            world.send(k, command.tick, command.acceleration, command.backup_trajectories)
            if isinstance(command, UavCommand):
                self.radio.send(k, command)
            elif command.route is not None:
                self.routes[name] = command.route
        tick = world.tick
        world.advance()
        self._answers.note(tick, commands, self.law.name)

    def take_down(self) -> None:
        """Settle the answers to the tick before and record this one; again at the same tick it changes nothing.

        Nobody needs it before the world moves on, so it is best done while the vehicles think.
        """
        self._answers.settle()
        self.recorder.record(self._answers.reports)

    def _goes_on(self) -> bool:
        """True if nobody has stopped it meanwhile."""
        return not self._stopped

    def fly_tick(self, exchange: Exchange) -> bool:
        """Fly one tick; False if it was stopped meanwhile, and nothing was flown."""
        tick = self.world.tick
        exchange.begin(tick)
        if not self._goes_on():
            return False
        exchange.publish(self.observations())
        commands = exchange.collect(tick)
        if not self._goes_on():
            return False
        self.apply(commands)
        if self.complete:
            self._close()
        return True

    def _close(self) -> None:
        """Settle what is known of the last state, at which no vehicle is asked any more."""
        self.take_down()
        self._answers.end()

    def fly(self, exchange: Exchange, *, on_tick: Callable[[], None] | None = None) -> None:
        """Fly to the end.

        Args:
            exchange: How observations and commands travel.
            on_tick: Called after each tick.
        """
        while not self.over and self.fly_tick(exchange):
            if on_tick is not None:
                on_tick()
        self._close()
        if not self._abandoned:
            exchange.publish(self.observations())

    def truth(self) -> Truth:
        """Everything but the grid, for observers."""
        world = self.world
        arrays = (world.position, world.velocity, world.acceleration, self.commands)
        rows = zip(*(rows.tolist() for rows in arrays), strict=True)
        self.take_down()
        measures = self.recorder.escorts[world.tick, :, :2].tolist()
        detections = world.detections.tolist()
        return Truth(
            tick=world.tick,
            time=world.time,
            vehicles={
                name: VehicleTruth(
                    position=tuple(p), velocity=tuple(v), acceleration=tuple(u), command=tuple(c)
                )
                for name, (p, v, u, c) in zip(world.names, rows, strict=True)
            },
            escorts=tuple(
                EscortTruth(
                    uav=uav.name,
                    ugv=uav.escorts,
                    distance=measures[k][0],
                    coverage_error=max(0.0, measures[k][1]),
                    detection=tuple(detections[k])
                    if detections[k][0] == detections[k][0]
                    else None,
                    report=self.answers.reports[k],
                )
                for k, uav in enumerate(world.uavs)
            ),
        )


_BUSY = LinkSettings(delay=0.4, jitter=0.3, bandwidth=5.0, queue=1)


def warm_up(scenario: Scenario) -> None:
    """Let all that a flight compiles be compiled or loaded, with a world that nobody sees.

    Operators may change links in flight, with messages in their queues and under way.
    """
    flight = Flight(scenario, scenario.seed)
    world, links = flight.world, flight.world.links
    objects = (LinkKind.RADIO, LinkKind.OPERATOR)
    carried = [row for row, (kind, _) in enumerate(links.names) if kind in objects]
    flight.take_down()
    if scenario.has_ground:
        block = MapUpdate(row=0, column=0, tiles=world.known_block(0, 0, 0))
        for ugv in scenario.ugv:
            world.receive_block(world.names.index(ugv.name), block)
    for settings in (_BUSY, LinkSettings()):
        for kind in LinkKind:
            flight.degrade(kind, None, settings)
        for _ in range(3):
            flight.observations()
            for k in range(len(world.names)):
                motion = BackupTrajectory(begins=world.tick, parent=-1, acceleration=(0.0, 0.0))
                world.send(k, world.tick, (0.0, 0.0), (motion,))
            for row in carried:
                for _ in range(3):
                    links.send_object(row, world.tick + 1, None, world.tick)
            flight.apply({})
    flight.take_down()
    flight.answers.end()
