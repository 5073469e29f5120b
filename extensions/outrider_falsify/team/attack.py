"""Adversary of a team: it sees the true state, ends processes, blacks out the link and asks for relief without need."""

import random
from collections import defaultdict
from collections.abc import Iterable, Mapping
from typing import Protocol

import msgspec
import numpy as np

from bus.messages.links import LinkKind
from bus.messages.team import Role
from bus.messages.vehicle import Command, UavCommand, UgvBriefing
from outrider.running.deaths import MortalPilots
from outrider_falsify.adversary import Adversary, Tactics
from outrider_falsify.team.events import Event, EventKind, Events
from outrider_falsify.team.genome import TeamTactics
from sim.scenario.team import briefed_team
from sim.server.flight import Flight

_QUIET = 1.0
"""Time at the start without events [s]."""
_FULL_LEASH = 0.95
"""Share of the scouts' range from which a scout counts as being at the end of its leash."""


class TeamView:
    """True state of a team.

    Args:
        flight: Run of the team.
    """

    def __init__(self, flight: Flight) -> None:
        self._flight = flight
        self.names = [uav.name for uav in flight.world.uavs]
        teams = (briefed_team(flight.scenario, uav) for uav in flight.scenario.uav)
        ranges = [team.scout_range for team in teams if team and team.scout_range is not None]
        self._range = min(ranges, default=np.inf)

    def newest(self) -> str:
        """Return the UAV with the largest number; of equal numbers, the first."""
        return max(self.names, key=self._flight.team.number)

    def distances(self) -> list[float]:
        """Return the distance of each UAV from its UGV [m]."""
        world = self._flight.world
        a, g = world.escorts.T
        return [float(d) for d in np.linalg.norm(world.position[a] - world.position[g], axis=1)]

    def scouts(self) -> list[str]:
        """Return the scouts, as last reported."""
        roles = self._flight.answers.roles()
        return [name for name in self.names if roles.get(name) is Role.SCOUT]

    def at_full_leash(self) -> bool:
        """Return whether a scout is at the end of its leash."""
        far = dict(zip(self.names, self.distances(), strict=True))
        return any(far[name] >= _FULL_LEASH * self._range for name in self.scouts())


class TeamUgv(Adversary):
    """UGV that reacts to the farthest UAV or to the newest guard.

    Args:
        tactics: Reactions to the UAV.
        flight: Run that holds the true state.
        briefing: The UGV's briefing.
        flees: True to react to the farthest UAV.
    """

    def __init__(
        self, tactics: Tactics, flight: Flight, briefing: UgvBriefing, *, flees: bool
    ) -> None:
        super().__init__(tactics, flight, briefing)
        self._view, self._rows, self._flees = TeamView(flight), flight.world.escorts[:, 0], flees

    def opponent(self) -> int:
        """Return the row of the UAV to which it reacts, among the vehicles."""
        view = self._view
        far = dict(zip(view.names, view.distances(), strict=True))
        name = max(far, key=far.__getitem__) if self._flees else view.newest()
        return int(self._rows[view.names.index(name)])


class Attacker(Protocol):
    """Source of the events of a flight."""

    def before(self, tick: int) -> Iterable[Event]:
        """Return the events before the UAVs answer a tick."""

    def after(self, tick: int, commands: Mapping[str, Command]) -> Iterable[Event]:
        """Return the events after they have answered, before their commands are sent."""


class Repetition:
    """Recorded events.

    Args:
        events: The events.
    """

    def __init__(self, events: Events) -> None:
        self._events: defaultdict[int, list[Event]] = defaultdict(list)
        for event in events:
            self._events[event.tick].append(event)

    def before(self, tick: int) -> Iterable[Event]:
        """Return the deaths of a tick."""
        return [event for event in self._events[tick] if event.kind is EventKind.DEATH]

    def after(self, tick: int, commands: Mapping[str, Command]) -> Iterable[Event]:
        """Return the other events of a tick."""
        return [event for event in self._events[tick] if event.kind is not EventKind.DEATH]


class TeamAdversary:
    """Adversary with tactics.

    Args:
        tactics: The tactics.
        flight: Run that holds the true state.
        seed: Seed of its choices.
    """

    def __init__(self, tactics: TeamTactics, flight: Flight, seed: int) -> None:
        self._tactics, self._flight = tactics, flight
        self._view, self._random = TeamView(flight), random.Random(seed)  # noqa: S311 - no secret
        self._first = round(_QUIET / flight.scenario.dt)
        self._mates = self._view.names

    def _chance(self, probability: float) -> bool:
        return probability > 0.0 and self._random.random() < probability

    def _death(self, tick: int, name: str) -> Event:
        ticks = self._random.randint(1 + self._tactics.absence // 2, 1 + self._tactics.absence)
        return Event(tick=tick, kind=EventKind.DEATH, vehicle=name, ticks=ticks)

    def _blackout(self, tick: int) -> Event:
        ticks = self._random.randint(1 + self._tactics.dark // 2, 1 + self._tactics.dark)
        return Event(tick=tick, kind=EventKind.BLACKOUT, ticks=ticks)

    def before(self, tick: int) -> Iterable[Event]:
        """Return deaths at random, and events while a scout is at the end of its leash."""
        if tick < self._first:
            return
        tactics = self._tactics
        if self._chance(tactics.kill_any):
            yield self._death(tick, self._random.choice(self._mates))
        if (tactics.kill_at_leash or tactics.dark_at_leash) and self._view.at_full_leash():
            if self._chance(tactics.kill_at_leash):
                yield self._death(tick, self._view.newest())
            if self._chance(tactics.dark_at_leash):
                yield self._blackout(tick)

    def after(self, tick: int, commands: Mapping[str, Command]) -> Iterable[Event]:
        """Return events in the tick of an acceptance or of a request, and requests without need."""
        if tick < self._first:
            return
        tactics, newest = self._tactics, self._view.newest()
        for name in self._mates:
            command = commands.get(name)
            if not isinstance(command, UavCommand):
                continue
            if command.number > self._flight.team.number(name):
                if self._chance(tactics.kill_new):
                    yield self._death(tick, name)
                if name != newest and self._chance(tactics.kill_old):
                    yield self._death(tick, newest)
                if self._chance(tactics.dark_new):
                    yield self._blackout(tick)
            message = command.team
            if message is None:
                continue
            if message.asks is not None:
                if self._chance(tactics.kill_at_request):
                    yield self._death(tick, message.asks)
                if self._chance(tactics.dark_at_request):
                    yield self._blackout(tick)
            elif self._chance(tactics.requests):
                asked = self._random.choice([mate for mate in self._mates if mate != name])
                yield Event(tick=tick, kind=EventKind.REQUEST, vehicle=name, asked=asked)


class AttackedPilots(MortalPilots):
    """Pilots under attack.

    Args:
        flight: Run of the pilots.
        attacker: Source of the events.
    """

    def __init__(self, flight: Flight, attacker: Attacker) -> None:
        super().__init__(flight, self._deaths)
        self._attacker = attacker
        self._link = flight.scenario.links.team
        self._dark_until = 0
        self.events: list[Event] = []
        """Events so far."""

    def _deaths(self, tick: int) -> Mapping[str, int]:
        deaths = {}
        for event in self._attacker.before(tick):
            if event.kind is EventKind.DEATH:
                if not self.away(event.vehicle):
                    self.events.append(event)
                    deaths[event.vehicle] = event.ticks
            else:
                self._black_out(event)
        return deaths

    def collect(self, tick: int) -> dict[str, Command]:
        """Return the commands of the pilots that are alive, as far as the adversary lets them pass."""
        if tick == self._dark_until and tick > 0:
            self.flight.degrade(LinkKind.TEAM, None, self._link)
        commands = super().collect(tick)
        for event in list(self._attacker.after(tick, commands)):
            if event.kind is EventKind.DEATH:
                if not self.away(event.vehicle):
                    self.events.append(event)
                    self.kill(event.vehicle, tick, event.ticks)
                    commands.pop(event.vehicle, None)
            elif event.kind is EventKind.BLACKOUT:
                self._black_out(event)
            else:
                self._request(event, commands)
        return commands

    def _black_out(self, event: Event) -> None:
        """Lose all messages to team-mates from this tick on, unless a blackout lasts."""
        if event.tick < self._dark_until:
            return
        self.events.append(event)
        self._dark_until = event.tick + max(1, event.ticks)
        self.flight.degrade(LinkKind.TEAM, None, msgspec.structs.replace(self._link, loss=1.0))

    def _request(self, event: Event, commands: dict[str, Command]) -> None:
        """Let a message ask for relief."""
        command = commands.get(event.vehicle)
        if isinstance(command, UavCommand) and command.team is not None:
            self.events.append(event)
            message = msgspec.structs.replace(command.team, asks=event.asked)
            commands[event.vehicle] = msgspec.structs.replace(command, team=message)
