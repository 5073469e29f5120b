"""Run of a scenario: the world and the vehicles' commands, tick by tick, independent of their transport.

The same loop serves pilots in this process and vehicles on the bus: both produce identical bits.
"""

import logging
from collections.abc import Callable, Collection, Mapping
from typing import Protocol

import numpy as np

from bus.messages.base import Vector
from bus.messages.control import Action, Change, Control
from bus.messages.links import LinkKind, LinkSettings
from bus.messages.scenario import Law
from bus.messages.team import Request
from bus.messages.telemetry import EscortTruth, Status, Truth, VehicleTruth
from bus.messages.vehicle import (
    Command,
    Observation,
    Teleoperation,
    UavCommand,
    UgvCommand,
)
from bus.registry import EXTERNAL
from sim.compiling.compile import FloatArray
from sim.engine.run_keys import check_seed
from sim.scenario.laws import law_title, with_law
from sim.scenario.types import NO_UAV, Scenario
from sim.scenario.vehicle_types import Uav
from sim.server.answers import Answers
from sim.server.clearance_watch import ClearanceWatch
from sim.server.perception import News, Perception, UavPerception, UgvPerception
from sim.server.radio import Radio
from sim.server.recorder import Recorder
from sim.server.robots import Robots
from sim.server.team_radio import TeamRadio
from sim.server.team_requests import check_request
from sim.world import World


class Exchange(Protocol):
    """Transport of observations to the vehicles, and of commands back."""

    def begin(self, tick: int) -> None:
        """Start a tick: apply operators' requests before its observations are made."""

    def publish(self, observations: Mapping[str, Observation]) -> None:
        """Send each vehicle its observation of this tick."""

    def collect(self, tick: int) -> Mapping[str, Command]:
        """Return the newest command of each vehicle with a new one; none answers a later tick."""


_LOG = logging.getLogger("outrider.sim")


def control_title(scenario: Scenario, external: Collection[str]) -> str:
    """Return the title of the UAVs' laws: `external` if the user's programs fly, `no UAV` if there are none.

    Args:
        scenario: Scenario of the run.
        external: UAVs flown by the user's own programs.
    """
    if not scenario.uav:
        return NO_UAV
    if len(external) == len(scenario.uav):
        return EXTERNAL
    title, own = law_title(scenario), " and ".join(sorted(external))
    return f"{title}, {own} {EXTERNAL}" if own else title


class Flight:
    """One run, from its first tick to its last.

    Args:
        scenario: Scenario to run.
        seed: Seed of all random numbers, together with the secret.
        secret: Secret of the run; empty: none. It is sent to no vehicle, operator or observer.
        episode: Number of the episode.
        on_notice: Called with one line for the user.
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
        self.seed = check_seed(seed)
        self.secret = secret
        self.episode = episode
        self.law = scenario.law
        """Control law that an operator has selected last; at first the scenario's."""
        self.laws = {uav.name: scenario.law_of(uav) for uav in scenario.uav}
        """Current control law of each UAV."""
        self.drivers = {ugv.name: ugv.driver for ugv in scenario.ugv}
        """Current driver of each UGV."""
        self.world = world = World(scenario, seed, secret=secret)
        self.recorder = Recorder(self.world)
        self.team = TeamRadio(self.world)
        """Numbers and messages of the teams."""
        self.perceptions: dict[str, Perception] = {
            vehicle.name: (UavPerception if isinstance(vehicle, Uav) else UgvPerception)(
                self.world, vehicle.name, episode, self.team
            )
            for vehicle in scenario.vehicles
        }
        """Perception of each vehicle, in name order."""
        self.on_notice = on_notice
        self.robots = Robots(scenario, self.world, on_notice)
        """States of the robots that fly UAVs."""
        self._answers = Answers(scenario, world, self.recorder, self.team, self.robots, on_notice)
        self._clearance = ClearanceWatch(scenario, self.world)
        self.routes: dict[str, tuple[Vector, ...]] = {}
        """Planned route of each UGV, as last reported: its corners [m]; for observers."""
        self.degradations: list[Change] = []
        """Changes of links during the run, with their ticks."""
        self._stopped = self._abandoned = False
        self._ticks = scenario.ticks
        self._uav_row = {uav.name: k for k, uav in enumerate(self.world.uavs)}
        self.radio = Radio(self.world)
        """Sender of the UAVs' radio messages."""
        self._received_tick = -1

    @property
    def commands(self) -> FloatArray:
        """Return the command of each vehicle in the last tick, before the bounds [m/s²]; shape (vehicles, 2)."""
        return self.world.commands

    @property
    def answers(self) -> Answers:
        """Return the evaluation of the vehicles' commands, up to the last tick."""
        self._answers.evaluate()
        return self._answers

    @property
    def flown(self) -> Scenario:
        """Return the scenario with the current control laws."""
        current = {uav.name: self.scenario.law_of(uav) for uav in self.scenario.uav}
        return self.scenario if self.laws == current else with_law(self.scenario, self.law)

    @property
    def law_name(self) -> str:
        """Return the title of the control laws; see `control_title`."""
        return control_title(self.scenario, self.answers.external)

    @property
    def complete(self) -> bool:
        """True if the scenario's last tick has been simulated."""
        return self.world.tick >= self._ticks

    @property
    def over(self) -> bool:
        """True if the run has ended: complete, or stopped."""
        return self._stopped or self.complete

    def stop(self) -> None:
        """End the run before the next command takes effect."""
        self._stopped = True

    def abandon(self) -> None:
        """End the run at once, without a last observation: another run starts."""
        self._stopped = self._abandoned = True

    def teleoperate(self, ugv: str, message: Teleoperation) -> None:
        """Send an operator's message over the link to a UGV; it arrives now or later."""
        tick, links = self.world.tick, self.world.links
        links.send_object(links.row(LinkKind.OPERATOR, ugv), tick, message, tick)

    def assign_driver(self, ugv: str, driver: str) -> None:
        """Change the driver of a UGV from the next observation on."""
        self.perceptions[ugv].news_now().driver = self.drivers[ugv] = driver
        if notice := self._clearance.assign(ugv, driver):
            self.on_notice(notice)

    def assign_law(self, law: Law) -> None:
        """Record that all UAVs fly this law."""
        self.law, self.laws = law, dict.fromkeys(self.laws, law)

    def order(self, law: Law) -> None:
        """Change the control law of all UAVs from the next observation on."""
        self.assign_law(law)
        for uav in self.world.uavs:
            self.perceptions[uav.name].news_now().law = law
            self.answers.assurance.excuse(self._uav_row[uav.name])

    def request(self, uav: str, request: Request) -> None:
        """Send an operator's request to a UAV of a team with its next observation.

        Raises:
            ScenarioError: If the UAV has no team, or cannot do this in its role.
        """
        check_request(self.scenario, uav, request, self.answers.roles().get(uav))
        self.perceptions[uav].news_now().request = request

    def rejoin(self, name: str) -> None:
        """Handle a vehicle's process that has rejoined: its new pilot knows only the past that it receives."""
        self.answers.rejoined(name)

    def status(self) -> Status:
        """Return the status of the run; the server adds its pace and the state of the vehicles' processes."""
        reasons = self.answers.reasons()
        return Status(
            scenario=self.scenario.name,
            seed=self.seed,
            tick=self.world.tick,
            ticks=self.scenario.ticks,
            time=self.world.time,
            realtime_factor=0.0,
            law=self.law.name,
            laws={name: law.name for name, law in self.laws.items() if law.name != self.law.name},
            drivers=dict(self.drivers),
            certified={name: reason is None for name, reason in reasons.items()},
            uncertified={name: reason for name, reason in reasons.items() if reason is not None},
            certificates=self.answers.assurance.status(),
            roles=self.answers.roles(),
            team=self.answers.teams.status(),
            mission=self.world.mission,
            warnings=(*self._clearance.notices.values(), *self.robots.notices.values()),
            links=self.world.links.status(),
            vehicles={name: self.answers.counted(name) for name in self.world.names},
            over=self.over,
        )

    def news(self, tick: int) -> dict[str, News]:
        """Return the news of a tick by vehicle; only vehicles with news."""
        return {name: one.news[tick] for name, one in self.perceptions.items() if tick in one.news}

    def degrade(self, kind: LinkKind, vehicle: str | None, settings: LinkSettings) -> None:
        """Change the settings of links from now on.

        Raises:
            ScenarioError: If the settings are invalid, or this vehicle has no such link.
        """
        self.world.change_links(kind, vehicle, settings)
        control = Control(action=Action.LINK, link=kind, vehicle=vehicle, settings=settings)
        self.degradations.append(Change(tick=self.world.tick, control=control))

    def _receive(self) -> None:
        """Receive what has arrived over the links at this tick; repeated calls have no effect."""
        tick = self.world.tick
        if self._received_tick == tick:
            return
        self._received_tick = tick
        for perception in self.perceptions.values():
            perception.receive(tick)

    def observations(self) -> dict[str, Observation]:
        """Return the observation of each vehicle at this tick."""
        self._receive()
        over = self.over
        return {name: one.observe(over=over) for name, one in self.perceptions.items()}

    def past(
        self, name: str, begin: int, end: int, missed: Collection[int]
    ) -> tuple[Observation, ...]:
        """Return the observations of a vehicle from tick `begin` up to `end`, for a process that rejoins.

        Args:
            name: The vehicle.
            begin: First tick.
            end: Tick after the last one; all must have been recorded.
            missed: Ticks whose observation was not sent.
        """
        perception = self.perceptions[name]
        reference = self.recorder.reference[begin:end, perception.row]
        row, vertical = self._uav_row.get(name), np.zeros((end - begin, 2))
        if row is not None and self.recorder.heights.size:
            vertical = self.recorder.heights[begin:end, row, :2]
        return perception.past(begin, end, reference, vertical, missed)

    def apply(self, commands: Mapping[str, Command]) -> None:
        """Send these commands, and advance by one tick under the commands that have arrived.

        Radio messages of the UAVs arrive at the next tick at the earliest.
        """
        self._receive()
        self.take_down()  # reports of this tick are compared with its record
        world = self.world
        for k, name in enumerate(world.names):
            command = commands.get(name)
            if world.ground is not None and name not in self._uav_row:
                report = command.report if isinstance(command, UgvCommand) else None
                if self._answers.excuses(name, command):
                    world.record_claim(k, None)
                world.record_claim(k, report if command and command.tick == world.tick else None)
            if command is None:
                continue
            vertical = command.vertical_acceleration if isinstance(command, UavCommand) else 0.0
            world.send(k, command.tick, command.acceleration, command.backup_trajectories, vertical)
            if isinstance(command, UavCommand):
                self.radio.send(k, command)
                self.team.send(name, command)
                self.robots.receive(name, command)
            elif command.route is not None:
                self.routes[name] = command.route
        self._clearance.update(commands)
        self.robots.update()
        world.advance()
        self.team.use_charge()
        self._answers.record(world.tick - 1, commands, self.laws, self._clearance.since())

    def take_down(self) -> None:
        """Evaluate the commands of the previous tick and record this one; repeated calls at a tick have no effect.

        The result is needed only before the world advances: call it while the vehicles compute.
        """
        self._answers.evaluate()
        self.recorder.record(self._answers.reports, self._answers.revoked)

    def _is_running(self) -> bool:
        """True unless the run has been stopped."""
        return not self._stopped

    def fly_tick(self, exchange: Exchange) -> bool:
        """Simulate one tick; return False, without simulating it, if the run was stopped meanwhile."""
        tick = self.world.tick
        exchange.begin(tick)
        if not self._is_running():
            return False
        exchange.publish(self.observations())
        commands = exchange.collect(tick)
        if not self._is_running():
            return False
        self.apply(commands)
        if self.complete:
            self._close()
        return True

    def _close(self) -> None:
        """Evaluate and record the last state, for which no vehicle sends a command."""
        self.take_down()
        self._answers.end()

    def fly(self, exchange: Exchange, *, on_tick: Callable[[], None] | None = None) -> None:
        """Simulate to the end.

        Args:
            exchange: Transport of observations and commands.
            on_tick: Called after each tick.
        """
        while not self.over and self.fly_tick(exchange):
            if on_tick is not None:
                on_tick()
        self._close()
        if not self._abandoned:
            exchange.publish(self.observations())

    def truth(self) -> Truth:
        """Return the true state without the coverage grid, for observers."""
        world = self.world
        arrays = (world.position, world.velocity, world.acceleration, self.commands)
        rows = zip(*(rows.tolist() for rows in arrays), strict=True)
        self.take_down()
        measures = self.recorder.escorts[world.tick, :, :2].tolist()
        detections = [None if np.isnan(x) else (x, y) for x, y in world.detections.tolist()]
        heights, headings = world.vertical_truth(), world.headings()
        radii = self.recorder.heights[world.tick, :, 3].tolist()
        return Truth(
            tick=world.tick,
            time=world.time,
            vehicles={
                name: VehicleTruth(
                    position=tuple(p),
                    velocity=tuple(v),
                    acceleration=tuple(u),
                    command=tuple(c),
                    heading=headings.get(name),
                    known=self.robots.is_known(name),
                    **heights.get(name, {}),
                )
                for name, (p, v, u, c) in zip(world.names, rows, strict=True)
            },
            escorts=tuple(
                EscortTruth(
                    uav=uav.name,
                    ugv=uav.escorts,
                    distance=measures[k][0],
                    sight_radius=radii[k] if radii else None,
                    teamed=self.scenario.team is not None,
                    coverage_error=max(0.0, measures[k][1]),
                    detection=detections[k],
                    report=self.answers.reports[k],
                    revoked=self.answers.revoked[k],
                )
                for k, uav in enumerate(world.uavs)
            ),
        )
