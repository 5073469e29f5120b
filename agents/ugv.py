"""Pilot of the UGV: maps observations to commands."""

from collections.abc import Callable
from functools import partial
from typing import Protocol

from agents.drivers.compiled import CompiledDriver, NavigateDriver, briefed_grid, update_grid
from agents.drivers.policy import Policy, PolicyDriver
from bus.errors import ScenarioError
from bus.messages.vehicle import (
    BackupTrajectory,
    UgvBriefing,
    UgvCommand,
    UgvObservation,
    UgvReport,
)
from bus.registry import DRIVERS, maker_of, usable


class Driver(Protocol):
    """Controller of a UGV: maps an observation to an acceleration [m/s²]."""

    def drive(self, observation: UgvObservation) -> tuple[float, float]:
        """Return the acceleration [m/s²] for this observation."""


_MAKERS: dict[str, Callable[..., Driver]] = usable(
    (row for row in DRIVERS.values() if row.provided),
    lambda row: maker_of(row) if row.make else partial(CompiledDriver, name=row.name),
)


class UgvPilot:
    """Pilot of a UGV: answers each observation with its driver's acceleration. It performs no input or output.

    The driver may change during the flight; the new driver starts from the current observation. The occupancy grid
    belongs to the pilot: it contains all reports since the start, whatever the driver was.

    Args:
        briefing: Briefing of the UGV.
        driver: Driver to use instead of the briefing's.
        policy: User's function for the driver `policy`.
        policy_name: Name of the policy in errors.

    Raises:
        ScenarioError: If the briefing names an unknown driver, or a driver that needs a policy and none is given, or if
            the area has too many tiles.
    """

    def __init__(
        self,
        briefing: UgvBriefing,
        *,
        driver: Driver | None = None,
        policy: Policy | None = None,
        policy_name: str = "policy",
    ) -> None:
        self._briefing = briefing
        self._policy, self._policy_name = policy, policy_name
        self._grid = briefed_grid(briefing)
        self._driver = driver or self._make(briefing.driver)

    def _make(self, name: str) -> Driver:
        if name in DRIVERS and DRIVERS[name].own:
            if self._policy is None:
                raise ScenarioError(
                    f"driver = {name!r}: needs a policy, given to the UGV as module:function"
                )
            return PolicyDriver(
                self._briefing, policy=self._policy, name=self._policy_name, grid=self._grid
            )
        if name not in _MAKERS:
            raise ScenarioError(f"driver = {name!r}: unknown; allowed: {', '.join(_MAKERS)}")
        if DRIVERS[name].module:
            return _MAKERS[name](self._briefing, grid=self._grid)
        return _MAKERS[name](self._briefing)

    def perceive(self, observation: UgvObservation) -> None:
        """Update the occupancy grid and the driver, also from an observation that is too late to answer."""
        if observation.tile_reports or observation.map_updates:
            update_grid(self._grid, observation)
        if observation.driver is not None:
            self._driver = self._make(observation.driver)

    def act(self, observation: UgvObservation) -> UgvCommand:
        """Return the command for this observation."""
        self.perceive(observation)
        acceleration, route = self._driver.drive(observation), None
        backups: tuple[BackupTrajectory, ...] = ()
        report: UgvReport | None = None
        if isinstance(self._driver, NavigateDriver):
            route = self._driver.new_route(observation.position)
            backups = self._driver.backup_trajectories(observation.tick)
            report = self._driver.report()
        elif observation.driver is not None:
            route = ()  # the previous driver's route is no longer driven
        return UgvCommand(
            tick=observation.tick,
            acceleration=acceleration,
            backup_trajectories=backups,
            route=route,
            report=report,
        )

    def forget_commands(self) -> None:
        """Forget the commands so far: they were not sent, or another process sent them."""
        if isinstance(self._driver, NavigateDriver):
            self._driver.forget_commands()
