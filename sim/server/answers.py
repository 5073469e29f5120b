"""The vehicles' answers: counted, held against their bounds, and their reports against the truth."""

import math
from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

from bus.messages import Command, MotionPlan, UavCommand, UavReport, VehicleStatus
from bus.ticks import Look
from sim.scenario.types import Scenario
from sim.server.assurance import Assurance
from sim.server.recorder import Recorder
from sim.world import World

_ROUNDING = 1e-9
"""So much longer, as a share, a command may be by rounding alone."""


def _largest(motions: Iterable[MotionPlan]) -> float:
    """The longest acceleration of these motions [m/s²]."""
    asked = ((one.acceleration, one.turning, one.braking) for one in motions)
    return max(math.hypot(x, y) for three in asked for x, y in three)


class _Tick(NamedTuple):
    """The answers of a tick, and what had reached the UAVs then."""

    tick: int
    commands: Mapping[str, Command]
    received: list[list[Look]]
    law: str
    watched: bool
    """True if a safety filter watches over that law."""


class Answers:
    """All that is known of a flight's answers, up to the last one that was settled.

    Nobody needs any of it to fly the next tick, so an answer is noted when it comes, and settled once the vehicles
    have the next observation to think about; at the latest before the world moves on.

    Args:
        scenario: What is flown.
        world, recorder: Of the flight.
        on_notice: Called with one line for a person.
    """

    def __init__(
        self,
        scenario: Scenario,
        world: World,
        recorder: Recorder,
        on_notice: Callable[[str], None],
    ) -> None:
        self._world, self._recorder, self._on_notice = world, recorder, on_notice
        self._disturbed = scenario.disturbed
        self.missing: dict[str, int] = dict.fromkeys(world.names, 0)
        """Ticks for which a vehicle had no new command."""
        self.stale: dict[str, int] = dict.fromkeys(world.names, 0)
        """Commands of a vehicle that were used after the tick they answer."""
        self.shortened: dict[str, int] = dict.fromkeys(world.names, 0)
        """Commands of a vehicle that were longer than its bound."""
        self.external: set[str] = set()
        """UAVs that a program of the user's own flies: it has seen its UGV and never reported an estimate.

        The scenario's law, and its certificate, tell nothing of them.
        """
        self.first_missing: int | None = None
        """The first tick at which a vehicle's command was missing or stale."""
        self.reports: list[UavReport | None] = [None] * len(world.uavs)
        """The last report of each UAV."""
        self.assurance = Assurance(scenario)
        """Checks the reports of the safety filters."""
        self._reporting = [False] * len(world.uavs)
        self._newest = dict.fromkeys(world.names, -1)  # the tick that each one's command answers
        self._bounds = dict(zip(world.names, world.bounds[:, 1].tolist(), strict=True))  # [m/s²]
        self._pairs: list[tuple[int, int]] = [(a, g) for a, g in world.escorts.tolist()]
        self._unsettled: _Tick | None = None

    def counted(self, name: str) -> VehicleStatus:
        """The counts of a vehicle that has joined."""
        return VehicleStatus(
            present=True,
            missing_commands=self.missing[name],
            stale_commands=self.stale[name],
            shortened_commands=self.shortened[name],
        )

    def note(
        self,
        tick: int,
        commands: Mapping[str, Command],
        received: list[list[Look]],
        law: str,
        *,
        watched: bool,
    ) -> None:
        """Keep the answers of a tick that has just been flown, to be settled before the next one is.

        Args:
            tick: Which.
            commands: The new command of each vehicle that has one.
            received: The detections that had reached each UAV.
            law: The UAVs' law.
            watched: Whether a safety filter watches over it.
        """
        self._unsettled = _Tick(tick, commands, received, law, watched)

    def settle(self) -> None:
        """Count what was noted last, and hold what the UAVs have said against the truth."""
        if self._unsettled is None:
            return
        last, self._unsettled = self._unsettled, None
        self._count(last.tick, last.commands)
        for uav, (a, _) in enumerate(self._pairs):
            command = last.commands.get(self._world.names[a])
            self.reports[uav] = None
            if isinstance(command, UavCommand):
                self._judge_report(uav, command, last)
                self.assurance.send(uav, command.tick, command.acceleration)
        self._check_reports(last)

    def end(self) -> None:
        """The flight is over, and its last state has been taken down: no vehicle is asked there any more."""
        self.settle()
        for uav in range(len(self._pairs)):
            self.assurance.end(uav, self._recorder.distance(self._world.tick, uav))

    def _count(self, tick: int, commands: Mapping[str, Command]) -> None:
        """Note whether each vehicle's process was in time, and whether it asked for more than its bound."""
        for name, bound in self._bounds.items():
            command = commands.get(name)
            if command is None:
                self.missing[name] += 1
            else:
                answered = self._newest[name] = command.tick
                if answered < tick:
                    self.stale[name] += 1
                size = math.hypot(*command.acceleration)
                if isinstance(command, UavCommand) and command.motions:
                    size = max(size, _largest(command.motions))
                if size > bound * (1.0 + _ROUNDING):
                    self._tell_shortened(name, command.tick, size, bound)
            if self._newest[name] < tick and self.first_missing is None:
                self.first_missing = tick

    def _tell_shortened(self, name: str, tick: int, size: float, bound: float) -> None:
        """Count a command of which the bound of (1) shortens anything, and tell of the first; units may be wrong."""
        self.shortened[name] += 1
        if self.shortened[name] == 1:
            self._on_notice(
                f"{name}: its command for tick {tick}, {size:.4g} m/s², is longer than its "
                f"bound {bound:.4g} m/s² and is shortened to it; more of these are only counted"
            )

    def _judge_report(self, uav: int, command: UavCommand, last: _Tick) -> None:
        """Take a UAV's report; a pilot of ours that has seen its UGV cannot lack it, so it tells whose pilot it is."""
        report = self.reports[uav] = command.report
        if report is not None and not (last.watched and report.certified is None):
            self._reporting[uav] = True
        if self._reporting[uav] or command.tick != last.tick or not last.received[uav]:
            return
        name = self._world.uavs[uav].name
        if name not in self.external:
            self.external.add(name)
            self.assurance.disregard(uav)
            self._on_notice(
                f"{name} sees its UGV and reports no estimate: a program of your own flies it, "
                f"of which the law {last.law} tells nothing"
            )

    def _check_reports(self, last: _Tick) -> None:
        """Hold what the UAVs have said of a tick against the truth.

        Those that a safety filter watches over: by the law, or around whatever flies them.
        """
        recorder, acted = self._recorder, self._world.commands
        states = recorder.states
        for uav, (a, g) in enumerate(self._pairs):
            report = self.reports[uav]
            if not last.watched and (report is None or report.certified is None):
                continue
            command, arrivals = last.commands.get(self._world.names[a]), []
            said = last.tick if command is None else command.tick
            for taken, x, y in last.received[uav] if command is not None else ():
                # without a command it has seen nothing of this tick
                d_x = states.item(taken, a, 0) - states.item(taken, g, 0)
                d_y = states.item(taken, a, 1) - states.item(taken, g, 1)
                arrivals.append((taken, math.hypot(x - d_x, y - d_y)))
            if self._disturbed:
                (x, y), (t_x, t_y) = states[last.tick, a, :2], recorder.told[last.tick, a, :2]
                self.assurance.track(uav, math.hypot(x - t_x, y - t_y))
            self.assurance.take(
                uav,
                last.tick,
                report,
                distance=recorder.distance(said, uav),
                arrivals=arrivals,
                acts=(acted.item(a, 0), acted.item(a, 1)),
                flown=self._world.flown(a),
                current=said == last.tick,
            )
