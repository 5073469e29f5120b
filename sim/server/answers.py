"""The vehicles' answers: counted, held against their bounds, and their reports against the truth."""

import math
from collections.abc import Callable, Iterable, Mapping

import numpy as np

from bus.messages.telemetry import VehicleStatus
from bus.messages.vehicle import BackupTrajectory, Command, UavCommand, UavReport
from bus.registry import LAWS
from sim.scenario.types import Scenario
from sim.server.assurance import Assurance
from sim.server.recorder import Recorder
from sim.world import World

_ROUNDING = 1e-9
"""So much longer, as a share, a command may be by rounding alone."""


def _largest(motions: Iterable[BackupTrajectory]) -> float:
    """The square of the longest acceleration of these motions [m²/s⁴]."""
    asked = ((one.acceleration, one.turning, one.braking) for one in motions)
    return max(x * x + y * y for three in asked for x, y in three)


_Tick = tuple[int, Mapping[str, Command], str]
"""The answers of a tick: which it is, the new commands, and the UAVs' law."""


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
        limits = np.square(world.vehicles["max_acceleration"] * (1.0 + _ROUNDING)).tolist()
        self._limits = dict(zip(world.names, limits, strict=True))  # of a command's square [m²/s⁴]
        self._uavs = [uav.name for uav in world.uavs]
        flown = world.arrays[1].flown[0, :, 0]
        self._evidence = recorder.arrivals, world.vehicles, flown
        self._unsettled: _Tick | None = None

    def counted(self, name: str) -> VehicleStatus:
        """The counts of a vehicle that has joined."""
        return VehicleStatus(
            present=True,
            missing_commands=self.missing[name],
            stale_commands=self.stale[name],
            shortened_commands=self.shortened[name],
        )

    def note(self, tick: int, commands: Mapping[str, Command], law: str) -> None:
        """Keep the answers of a tick that has just been flown, to be settled before the next one is.

        Args:
            tick: Which.
            commands: The new command of each vehicle that has one.
            law: The UAVs' law.
        """
        self._unsettled = tick, commands, law

    def settle(self) -> None:
        """Count what was noted last, and hold what the UAVs have said against the truth."""
        last = self._unsettled
        if last is None:
            return
        self._unsettled = None
        tick, commands, law = last
        self._count(tick, commands)
        for uav, name in enumerate(self._uavs):
            command = commands.get(name)
            self._judge(uav, command if isinstance(command, UavCommand) else None, tick, law)

    def end(self) -> None:
        """The flight is over, and its last state has been taken down: no vehicle is asked there any more."""
        self.settle()
        for uav in range(len(self._uavs)):
            self.assurance.end(uav, self._recorder.distance(self._world.tick, uav))

    def _count(self, tick: int, commands: Mapping[str, Command]) -> None:
        """Note whether each vehicle's process was in time, and whether it asked for more than its bound."""
        for name, limit in self._limits.items():
            command = commands.get(name)
            if command is None or command.tick < tick:
                self.first_missing = tick if self.first_missing is None else self.first_missing
                (self.missing if command is None else self.stale)[name] += 1
            if command is None:
                continue
            u_x, u_y = command.acceleration
            size = u_x * u_x + u_y * u_y
            if command.backup_trajectories:
                size = max(size, _largest(command.backup_trajectories))
            if size > limit:
                self._tell_shortened(name, command.tick, math.sqrt(size))

    def _tell_shortened(self, name: str, tick: int, size: float) -> None:
        """Count a command of which the bound of (1) shortens anything, and tell of the first; units may be wrong."""
        self.shortened[name] += 1
        if self.shortened[name] == 1:
            bound = float(self._world.vehicles[self._world.names.index(name)]["max_acceleration"])
            self._on_notice(
                f"{name}: its command for tick {tick}, {size:.4g} m/s², is longer than its "
                f"bound {bound:.4g} m/s² and is shortened to it; more of these are only counted"
            )

    def _judge(self, uav: int, command: UavCommand | None, tick: int, law: str) -> None:
        """Hold what a UAV has said of a tick against the truth."""
        watched = LAWS[law].watched
        report = self.reports[uav] = None if command is None else command.report
        if report is not None and not (watched and report.decision is None):
            self._reporting[uav] = True
        elif command is not None and not self._reporting[uav]:
            self._judge_pilot(uav, command, tick, law)
        if self._disturbed and (watched or (report and report.decision is not None)):
            self.assurance.track(uav, self._recorder.tracking_error_at(tick, uav))
        said = tick if command is None else command.tick
        distance = self._recorder.distance(said, uav)
        self.assurance.take(uav, tick, command, self._evidence, distance, watched=watched)

    def _judge_pilot(self, uav: int, command: UavCommand, tick: int, law: str) -> None:
        """A pilot of ours that has seen its UGV cannot lack a report, so it tells whose pilot it is."""
        name = self._uavs[uav]
        if command.tick != tick or not self._recorder.has_seen(uav) or name in self.external:
            return
        self.external.add(name)
        self.assurance.disregard(uav)
        self._on_notice(
            f"{name} sees its UGV and reports no estimate: a program of your own flies it, of which the law "
            f"{law} tells nothing"
        )
