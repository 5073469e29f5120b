"""Verdict on a flight of a team, from its UAVs' reports and the true state."""

import math
from collections.abc import Callable

from bus.messages.team import Role
from sim.server.flight import Flight

_LATE = 2
"""Ticks that the leash allows in addition, since roles and sight are known at whole ticks only."""


def return_ticks(flight: Flight) -> int:
    """Return the ticks within which a scout that turns back sees the UGV, by the leash; see docs/explanation/teams.md.

    Turn, flight and stop take L/v_a + 5v_a/(2u_a) + 2dt; L: the scouts' range.
    """
    scenario = flight.scenario
    team, uav, dt = scenario.team, scenario.uav[0], scenario.dt
    length = 0.0 if team is None or team.scout_range is None else team.scout_range
    time = length / uav.max_speed + 5.0 * uav.max_speed / (2.0 * uav.max_acceleration)
    delay = scenario.links.commands.delay
    return math.ceil((time + delay) / dt) + 2 + _LATE


class TeamJudge:
    """Counts of what a team's guarantee excludes, and of what it leaves open.

    A team is complete in a tick in which the UAVs with the g largest numbers are certified guards. From then on and
    before g losses, a tick without a certified guard contradicts the theorem. A loss is the end of the process, of the
    charge or of the certificate of one of these UAVs; the last is counted as `certificate_broken` if all assumptions
    hold.

    Args:
        flight: Run of the team.
        away: Return whether a vehicle has no process.
    """

    def __init__(self, flight: Flight, away: Callable[[str], bool]) -> None:
        self._flight, self._away = flight, away
        self._names = [uav.name for uav in flight.world.uavs]
        self._guards = flight.scenario.team.guards if flight.scenario.team else 0
        self._complete, self._losses = False, set[str]()
        self._certified_before: set[str] = set()
        self._returns = return_ticks(flight)
        self._ranges = all(uav.endurance is None for uav in flight.scenario.uav)
        self._turned: dict[str, int] = {}
        self._scouted: set[str] = set()
        self.ticks = self.certified = 0
        """Ticks, and ticks with a certified guard."""
        self.unguarded = 0
        """Ticks without a certified guard that contradict the theorem."""
        self.excused = 0
        """Ticks without a certified guard after a complete team and at least g losses."""
        self.farthest = 0.0
        """Largest distance of a certified guard [m]."""
        self.returned = self.leash_missed = 0
        """Scouts that have turned back, and those that did not see the UGV within the time of the leash."""
        self.slowest = 0.0
        """Largest share of that time after which they saw the UGV."""

    def see(self) -> None:
        """Judge the last tick."""
        flight = self._flight
        reports, revoked = flight.answers.reports, flight.answers.revoked
        tick = flight.world.tick - 1
        distance = flight.recorder.escorts[tick, :, 0].tolist()
        roles = {
            name: report.role for name, report in zip(self._names, reports, strict=True) if report
        }
        guards = {
            name
            for name, report, reason in zip(self._names, reports, revoked, strict=True)
            if report
            and report.role is Role.GUARD
            and report.decision is not None
            and report.decision.certified
            and reason is None
        }
        far = dict(zip(self._names, distance, strict=True))
        self.ticks += 1
        self.certified += bool(guards)
        self.farthest = max([self.farthest, *(far[name] for name in guards)])
        self._judge_guards(tick, guards, roles)
        if self._ranges:
            self._judge_leash(tick, roles)

    def _judge_guards(self, tick: int, guards: set[str], roles: dict[str, Role | None]) -> None:
        number = {name: self._flight.team.number(name, tick) for name in self._names}
        ranked = sorted(self._names, key=number.__getitem__, reverse=True)
        top = [name for name in ranked[: self._guards] if number[name] > 0]
        ended = self._certified_before - guards
        self._losses |= {
            name
            for name in top
            if self._away(name) or name in ended or roles.get(name) is Role.AWAY
        }
        if len(top) == self._guards and guards.issuperset(top):
            self._complete = True
            self._losses.clear()
        if self._complete and not guards:
            if len(self._losses) < self._guards:
                self.unguarded += 1
            else:
                self.excused += 1
        self._certified_before = guards

    def _judge_leash(self, tick: int, roles: dict[str, Role | None]) -> None:
        for row, name in enumerate(self._names):
            role = roles.get(name)
            if self._away(name) or role not in (Role.RELIEF, Role.GUARD):
                self._turned.pop(name, None)
            elif name in self._scouted and role is Role.RELIEF:
                self._turned[name] = tick
            if name in self._turned:
                seen = not self._flight.recorder.is_lost(tick, row)
                share = (tick - self._turned[name]) / self._returns
                if seen or share >= 1.0:
                    self.returned += 1
                    self.leash_missed += not seen
                    self.slowest = max(self.slowest, share)
                    del self._turned[name]
        self._scouted = {name for name, role in roles.items() if role is Role.SCOUT}
