"""Evaluation of the vehicles' commands: counts, bounds, and comparison of their reports with the true state."""

import math
from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

import numpy as np

from bus.messages.base import fitted
from bus.messages.decision import NotCertified
from bus.messages.scenario import Law
from bus.messages.team import Role
from bus.messages.telemetry import VehicleStatus
from bus.messages.vehicle import BackupTrajectory, Command, UavCommand, UavReport
from bus.numbers import above, exact
from bus.registry import LAWS
from sim.engine.monitor import Evidence
from sim.scenario.team import teams_of
from sim.scenario.types import Scenario
from sim.server.assurance import Assurance
from sim.server.recorder import Recorder
from sim.server.robots import Robots
from sim.server.team_radio import TeamRadio
from sim.server.team_watch import TeamWatch
from sim.world import World

_ROUNDING = 1e-6
"""Relative tolerance when a command is compared with its bound: policies may answer in single precision."""


def _largest(trajectories: Iterable[BackupTrajectory]) -> float:
    """Return the square of the largest acceleration of these trajectories [m²/s⁴]."""
    accelerations = ((one.acceleration, one.turning, one.braking) for one in trajectories)
    return max(x * x + y * y for three in accelerations for x, y in three)


def _is_certified(command: Command) -> bool | None:
    """Return whether a command's report certifies its tick; None: it has no report."""
    if isinstance(command, UavCommand):
        decision = None if command.report is None else command.report.decision
        return None if decision is None else decision.certified
    return None if command.report is None else command.report.certified


class Since(NamedTuple):
    """Tick from which on two assumptions have held for each UAV that it cannot check; None: it does not hold."""

    clear: tuple[int | None, ...]
    """Its UGV keeps its distance from buildings."""
    known: tuple[int | None, ...]
    """Its true state is known; without a robot, always."""

    def hold(self, uav: int, tick: int) -> tuple[bool, bool]:
        """Return whether each holds for a UAV at a tick up to this one."""
        clear, known = self.clear[uav], self.known[uav]
        return clear is not None and clear <= tick, known is not None and known <= tick


_Tick = tuple[int, Mapping[str, Command], Mapping[str, Law], Since]
"""Commands of one tick: the tick, the new commands, the UAVs' control laws, and their assumptions."""


class Answers:
    """Evaluation of the commands of a run, up to the last tick.

    The next tick does not need the results. A command is therefore recorded on arrival, and evaluated while the
    vehicles compute their next one; at the latest before the world advances.

    Args:
        scenario: Scenario of the run.
        world, recorder: World and recorder of the run.
        team: Numbers and messages of its teams.
        robots: Reported states of its robots.
        on_notice: Called with one line for the user.
    """

    def __init__(
        self,
        scenario: Scenario,
        world: World,
        recorder: Recorder,
        team: TeamRadio,
        robots: Robots,
        on_notice: Callable[[str], None],
    ) -> None:
        self._world, self._recorder, self._on_notice = world, recorder, on_notice
        self._robots = robots
        self._disturbed = scenario.disturbed
        self.missing: dict[str, int] = dict.fromkeys(world.names, 0)
        """Ticks without a new command, by vehicle."""
        self.stale: dict[str, int] = dict.fromkeys(world.names, 0)
        """Commands used after the tick that they answer, by vehicle."""
        self.shortened: dict[str, int] = dict.fromkeys(world.names, 0)
        """Commands that exceeded the vehicle's bound, by vehicle."""
        self.external: set[str] = set()
        """UAVs flown by the user's own program: they have received detections and never reported an estimate.

        The scenario's control law and its certificate do not apply to them.
        """
        self.first_missing: int | None = None
        """First tick at which a command was missing or stale; None: none so far."""
        self.reports: list[UavReport | None] = [None] * len(world.uavs)
        """Latest report of each UAV."""
        self.revoked: list[NotCertified | None] = [None] * len(world.uavs)
        """Reason why the certificate in this report does not hold, which the UAV cannot know; None: no such reason."""
        self.assurance = Assurance(scenario)
        """Checks of the safety filters' reports."""
        self.teams = TeamWatch(scenario, team, recorder)
        """Checks of the teams."""
        self._teamed = bool(teams_of(scenario))
        self._filtering = [False] * len(world.uavs)  # True: the last report held a decision
        self._reporting = [False] * len(world.uavs)
        limits = np.square(world.vehicles["max_acceleration"] * (1.0 + _ROUNDING)).tolist()
        self._limits = dict(
            zip(world.names, limits, strict=True)
        )  # bound on the squared acceleration [m²/s⁴]
        self._uavs = [uav.name for uav in world.uavs]
        flown = world.arrays[1].flown[0, :, 0]
        self._evidence = Evidence(recorder.arrivals, world.vehicles, flown)
        self._recorded: _Tick | None = None
        self._rejoined: dict[str, int] = {}
        """Tick at which each vehicle's process has rejoined, until its new pilot has reported."""

    def rejoined(self, name: str) -> None:
        """Allow the first report of a vehicle's new pilot to end a certificate: it has sent no plan yet."""
        self._rejoined[name] = self._world.tick

    def excuses(self, name: str, command: Command | None) -> bool:
        """Return whether a certificate may end with this command, as the vehicle's process has rejoined.

        The former pilot's answer to the tick of the rejoining may be the one that counts. The new pilot's first report
        is therefore the first that is not certified, or that answers a later tick.

        Args:
            name: Name of the vehicle.
            command: Its new command; None: none.
        """
        since = self._rejoined.get(name)
        if since is None:
            return False
        certified = None if command is None else _is_certified(command)
        if (
            command is not None
            and certified is not None
            and (not certified or command.tick > since)
        ):
            del self._rejoined[name]
        return True

    def reasons(self) -> dict[str, NotCertified | None]:
        """Return the reason why each UAV with a safety filter is not certified; None: it is."""
        given = zip(self._uavs, self.reports, self.revoked, strict=True)
        return {
            uav: revoked or report.decision.reason
            for uav, report, revoked in given
            if report is not None and report.decision is not None
        }

    def roles(self) -> dict[str, Role]:
        """Return the role of each UAV in a team, as last reported."""
        given = zip(self._uavs, self.reports, strict=True)
        return {uav: report.role for uav, report in given if report and report.role is not None}

    def counted(self, name: str) -> VehicleStatus:
        """Return the command counters of a vehicle that has joined."""
        return VehicleStatus(
            present=True,
            missing_commands=self.missing[name],
            stale_commands=self.stale[name],
            shortened_commands=self.shortened[name],
            unreported_ticks=self._robots.unreported[name],
            rejected=dict(self._robots.rejected[name]),
            last_fault=fitted(self._robots.faults[name]),
        )

    def record(
        self,
        tick: int,
        commands: Mapping[str, Command],
        laws: Mapping[str, Law],
        clear: tuple[int | None, ...],
    ) -> None:
        """Record the commands of the tick just simulated; `evaluate` counts them.

        Args:
            tick: The tick.
            commands: New command of each vehicle that sent one.
            laws: Control law of each UAV.
            clear: As in `Since`.
        """
        self._recorded = tick, commands, laws, Since(clear, self._robots.since())

    def evaluate(self) -> None:
        """Count the recorded commands, and compare the UAVs' reports with the true state."""
        last = self._recorded
        if last is None:
            return
        self._recorded = None
        tick, commands, laws, since = last
        self._count(tick, commands)
        for uav, name in enumerate(self._uavs):
            command = commands.get(name)
            answer = command if isinstance(command, UavCommand) else None
            self._check_report(uav, answer, tick, laws[name].name, since)
        if self._teamed:
            answers = map(commands.get, self._uavs)
            current = [answer is not None and answer.tick == tick for answer in answers]
            self.teams.record(tick, current, self.reports, self.revoked)

    def end(self) -> None:
        """Finish the run, after its last state was recorded: no vehicle sends a command for it."""
        self.evaluate()
        for uav in range(len(self._uavs)):
            lost, clear = (
                self._recorder.is_lost(self._world.tick, uav),
                self._world.keeps_clearance(uav),
            )
            if not self._robots.is_known(self._uavs[uav]):
                self.assurance.excuse(uav)
            self.assurance.end(uav, lost, clear=clear)

    def _count(self, tick: int, commands: Mapping[str, Command]) -> None:
        """Count late commands, and commands with a component above the vehicle's bound."""
        for name, limit in self._limits.items():
            command = commands.get(name)
            if command is None or command.tick < tick:
                self.first_missing = tick if self.first_missing is None else self.first_missing
                (self.missing if command is None else self.stale)[name] += 1
            if command is None:
                continue
            u_x, u_y = command.acceleration
            # an action of the environments is in the square around the disc of (1), and no fault
            size = max(u_x * u_x, u_y * u_y)
            if command.backup_trajectories:
                size = max(size, _largest(command.backup_trajectories))
            if size > limit:
                self._count_shortened(name, command.tick, math.sqrt(size))

    def _count_shortened(self, name: str, tick: int, size: float) -> None:
        """Count a command that the bound of (1) shortens, and report the first; it may be an error of units."""
        self.shortened[name] += 1
        if self.shortened[name] == 1:
            bound = float(self._world.vehicles[self._world.names.index(name)]["max_acceleration"])
            self._on_notice(
                f"{name}: its command for tick {tick}, {above(size, bound)} m/s², exceeds its "
                f"bound {exact(bound)} m/s² and is shortened; further ones are only counted"
            )

    def _check_report(
        self, uav: int, command: UavCommand | None, tick: int, law: str, since: Since
    ) -> None:
        """Compare a UAV's report of a tick with the true state."""
        report = self.reports[uav] = None if command is None else command.report
        watched = LAWS[law].watched
        if self._teamed:  # a UAV of a team has a filter in some of its roles, whatever the law
            if report is not None:
                self._filtering[uav] = report.decision is not None
            watched = self._filtering[uav]
        if report is not None and not (watched and report.decision is None):
            self._reporting[uav] = True
        elif command is not None and not self._reporting[uav]:
            self._check_pilot(uav, command, tick, law)
        judged = watched or (report is not None and report.decision is not None)
        if self._disturbed and judged and since.hold(uav, tick)[1]:
            self.assurance.track(uav, self._recorder.tracking_error_at(tick, uav))
        if self.excuses(self._uavs[uav], command):
            self.assurance.excuse(uav)
        said = tick if command is None else command.tick
        lost = self._recorder.is_lost(said, uav)
        clear, known = since.hold(uav, said)
        self.assurance.record(
            uav, tick, command, self._evidence, lost, watched=watched, clear=clear, known=known
        )
        certified = report is not None and report.decision is not None and report.decision.certified
        reason = NotCertified.NO_ROBOT_STATE if not known else NotCertified.NO_CLEARANCE
        self.revoked[uav] = reason if certified and not (clear and known) else None

    def _check_pilot(self, uav: int, command: UavCommand, tick: int, law: str) -> None:
        """Detect a UAV flown by the user's program: Outrider's pilot always reports once it has a detection."""
        name = self._uavs[uav]
        if command.tick != tick or not self._recorder.has_seen(uav) or name in self.external:
            return
        self.external.add(name)
        self.assurance.disregard(uav)
        self._on_notice(
            f"{name} receives detections but reports no estimate: your own program flies it, and the law "
            f"{law} does not apply to it"
        )
