"""Perception of each vehicle: the messages that reach its process at a tick, and its own state only.

Messages are stored, so that a process that rejoins receives them again.
"""

from abc import ABC, abstractmethod
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any, NamedTuple

from bus.messages.base import Vector
from bus.messages.buildings import Building
from bus.messages.ground import MapUpdate, TileReport
from bus.messages.links import LinkKind
from bus.messages.scenario import Law
from bus.messages.team import Request, TeamMessage
from bus.messages.vehicle import (
    Detection,
    Observation,
    RelativeInformation,
    Teleoperation,
    UavObservation,
    UgvObservation,
)
from sim.compiling.compile import FloatArray
from sim.server.team_radio import TeamRadio
from sim.world import World


@dataclass(slots=True)
class News:
    """News for a vehicle at one tick, in addition to its perception."""

    operator: tuple[Teleoperation, ...] = ()
    driver: str | None = None
    law: Law | None = None
    request: Request | None = None


_NO_NEWS = News()


class OwnState(NamedTuple):
    """Own state of a vehicle at one tick."""

    position: Vector
    velocity: Vector
    """Reference position [m] and velocity [m/s]."""
    vertical: Vector = (0.0, 0.0)
    """Altitude [m] and climb rate [m/s]; zero for a vehicle without an altitude."""


class Perception(ABC):
    """Perception of one vehicle, tick by tick: its own state, ground reports, and news.

    Args:
        world: World of the run.
        name: Name of the vehicle.
        episode: Number of the episode.
        team: Messages and numbers of the teams.
    """

    def __init__(self, world: World, name: str, episode: int, team: TeamRadio) -> None:
        self.name, self.row = name, world.names.index(name)
        self.news: dict[int, News] = {}
        """News by tick; only ticks with news."""
        self._world, self._episode, self._team = world, episode, team
        self._flies = bool(world.vertical[self.row]["flies"])
        self._dt, self._grounded = world.parameters.dt, world.scenario.has_ground
        self._ground: dict[int, tuple[TileReport, ...]] = {}
        self._now: tuple[Any, ...] = ()  # messages that have arrived at the world's tick
        self._arrived: dict[int, tuple[Any, ...]] = {}  # messages by tick of arrival

    def news_now(self) -> News:
        """Return the news of the world's tick, to be extended."""
        return self.news.setdefault(self._world.tick, News())

    @abstractmethod
    def receive(self, tick: int) -> None:
        """Receive this tick's messages and sensor reports; call once per tick."""

    def _see_ground(self, tick: int) -> None:
        seen = self._world.seen_ground(self.row)
        if seen:
            self._ground[tick] = seen

    def observe(self, *, over: bool) -> Observation:
        """Return the observation of the world's tick; `over`: no command is expected."""
        vehicle = self._world.vehicles[self.row]
        x, y = vehicle["reference_position"].tolist()
        v_x, v_y = vehicle["reference_velocity"].tolist()
        own = OwnState((x, y), (v_x, v_y))
        if self._flies:
            vertical = vehicle["vertical"]
            own = own._replace(vertical=(vertical["altitude"].item(), vertical["rate"].item()))
        return self._observation(self._world.tick, own, self._now, over=over)

    def past(
        self,
        begin: int,
        end: int,
        reference: FloatArray,
        heights: FloatArray,
        missed: Collection[int],
    ) -> tuple[Observation, ...]:
        """Return the observations from tick `begin` up to `end`, for a process that rejoins.

        Args:
            begin: First tick.
            end: Tick after the last one.
            reference: Reference position [m] and velocity [m/s] in between. Shape (ticks, 4).
            heights: Altitude [m] and climb rate [m/s] in between. Shape (ticks, 2).
            missed: Ticks whose observation was not sent: the vehicle receives only its own state, law and driver for
                them.
        """
        rows = zip(reference.tolist(), heights.tolist(), strict=True)
        return tuple(
            self._observation(tick, OwnState((x, y), (v_x, v_y), (z, rate)), known=False)
            if tick in missed
            else self._observation(
                tick, OwnState((x, y), (v_x, v_y), (z, rate)), self._arrived.get(tick, ())
            )
            for tick, ((x, y, v_x, v_y), (z, rate)) in enumerate(rows, begin)
        )

    def _common(self, tick: int, own: OwnState, *, known: bool, over: bool) -> dict[str, Any]:
        """Return the fields of `VehicleObservation`; arguments as in `_observation`."""
        return {
            "tick": tick,
            "time": tick * self._dt,
            "position": own.position,
            "velocity": own.velocity,
            "tile_reports": self._ground.get(tick, ()) if known else (),
            "committed_trajectory": self._world.flown(self.row)
            if tick == self._world.tick
            else None,
            "over": over,
            "episode": self._episode,
        }

    @abstractmethod
    def _observation(
        self,
        tick: int,
        own: OwnState,
        arrived: tuple[Any, ...] = (),
        *,
        known: bool = True,
        over: bool = False,
    ) -> Observation:
        """Return an observation.

        Args:
            tick: The tick.
            own: State of the vehicle at this tick.
            arrived: Messages that have arrived.
            known: True if the vehicle's process received them.
            over: True if no command is expected.
        """


class UavPerception(Perception):
    """Perception of a UAV: detections of the UGV that it escorts."""

    def __init__(self, world: World, name: str, episode: int, team: TeamRadio) -> None:
        super().__init__(world, name, episode, team)
        self._uav = [uav.name for uav in world.uavs].index(name)
        self._buildings: dict[int, tuple[Building, ...]] = {}  # by tick of discovery
        self._messages: dict[int, tuple[TeamMessage, ...]] = {}  # of team-mates, by tick of arrival

    def receive(self, tick: int) -> None:
        """Receive this tick's messages and sensor reports; call once per tick."""
        if self._grounded:
            self._see_ground(tick)
        if found := self._world.discovered(self._uav):
            self._buildings[tick] = found
        self._now = self._world.received(self._uav)
        if self._now:
            self._arrived[tick] = self._now
        if messages := self._team.received(self.name, tick):
            self._messages[tick] = messages

    def _observation(
        self,
        tick: int,
        own: OwnState,
        arrived: tuple[Detection, ...] = (),
        *,
        known: bool = True,
        over: bool = False,
    ) -> UavObservation:
        news = self.news.get(tick, _NO_NEWS)
        common = self._common(tick, own, known=known, over=over)
        if self._flies:
            common["altitude"], common["climb_rate"] = own.vertical
        found = self._buildings.get(tick, ()) if known else ()
        return UavObservation(
            **common,
            detections=arrived,
            buildings=found,
            law=news.law,
            team=self._messages.get(tick, ()) if known else (),
            charge=self._team.charge(self.name, tick),
            number=self._team.number(self.name, tick),
            request=news.request,
        )


class UgvPerception(Perception):
    """Perception of a UGV: operators' messages, and radio messages of the UAVs that escort it."""

    def __init__(self, world: World, name: str, episode: int, team: TeamRadio) -> None:
        super().__init__(world, name, episode, team)
        self._operators = world.links.row(LinkKind.OPERATOR, name)
        escorts = [uav.name for uav in world.uavs if uav.escorts == name]
        self._radios = [world.links.row(LinkKind.RADIO, uav) for uav in escorts]
        self._headings: dict[int, float] = {}  # by tick, of a UGV that steers
        self.blocks: dict[int, tuple[MapUpdate, ...]] = {}
        """Map updates received by radio, by tick."""

    def receive(self, tick: int) -> None:
        """Receive this tick's messages and sensor reports; call once per tick."""
        if self._grounded:
            self._see_ground(tick)
        heading = self._world.heading(self.row)
        if heading is not None:
            self._headings[tick] = heading
        links = self._world.links
        commands = links.arrivals(self._operators, tick)
        if commands:
            self.news_now().operator = tuple(commands)
        self._now = ()
        for radio in self._radios:
            for message in links.arrivals(radio, tick):
                self._receive_message(tick, message)

    def _receive_message(self, tick: int, message: object) -> None:
        if isinstance(message, RelativeInformation):
            self._now = (*self._now, message)
            self._arrived[tick] = self._now
        elif isinstance(message, MapUpdate):
            self.blocks[tick] = (*self.blocks.get(tick, ()), message)
            self._world.receive_block(self.row, message)

    def _observation(
        self,
        tick: int,
        own: OwnState,
        arrived: tuple[RelativeInformation, ...] = (),
        *,
        known: bool = True,
        over: bool = False,
    ) -> UgvObservation:
        news = self.news.get(tick, _NO_NEWS)
        return UgvObservation(
            **self._common(tick, own, known=known, over=over),
            heading=self._headings.get(tick),
            radio=arrived,
            map_updates=self.blocks.get(tick, ()) if known else (),
            operator=news.operator if known else (),
            driver=news.driver,
        )
