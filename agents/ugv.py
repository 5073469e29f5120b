"""The UGV's pilot: observation in, command out."""

from collections.abc import Callable
from functools import partial
from typing import Protocol

from agents.drivers.compiled import CompiledDriver, NavigateDriver
from agents.drivers.policy import Policy, PolicyDriver
from bus.errors import ScenarioError
from bus.messages.vehicle import (
    BackupTrajectory,
    UgvBriefing,
    UgvCommand,
    UgvObservation,
    UgvReport,
)
from bus.registry import DRIVERS, resolve


class Driver(Protocol):
    """Drives the UGV: an observation in, an acceleration [m/s²] out."""

    def drive(self, observation: UgvObservation) -> tuple[float, float]:
        """The acceleration [m/s²] for this observation."""


_MAKERS: dict[str, Callable[[UgvBriefing], Driver]] = {
    row.name: resolve(row.make) if row.make else partial(CompiledDriver, name=row.name)
    for row in DRIVERS.values()
    if row.provided
}


class UgvPilot:
    """Answers each observation with the driver's acceleration. Pure: no input or output of its own.

    Another driver may take the wheel in the middle of a flight; it begins with what it perceives then.

    Args:
        briefing: What the UGV is told when it joins.
        driver: Who drives instead of the briefing's driver.
        policy: A function of the user's own, for the driver `policy`.
        policy_name: What it is called in errors.

    Raises:
        ScenarioError: If the briefing names an unknown driver, or one that needs a policy where there is none.
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
        self._driver = driver or self._make(briefing.driver)

    def _make(self, name: str) -> Driver:
        if name in DRIVERS and DRIVERS[name].own:
            if self._policy is None:
                raise ScenarioError(
                    f"driver = {name!r}: needs a policy, given to the UGV as module:function"
                )
            return PolicyDriver(self._briefing, policy=self._policy, name=self._policy_name)
        if name not in _MAKERS:
            raise ScenarioError(f"driver = {name!r}: unknown; allowed: {', '.join(_MAKERS)}")
        return _MAKERS[name](self._briefing)

    def act(self, observation: UgvObservation) -> UgvCommand:
        """The command for this observation."""
        if observation.driver is not None:
            self._driver = self._make(observation.driver)
        acceleration, route = self._driver.drive(observation), None
        motions: tuple[BackupTrajectory, ...] = ()
        report: UgvReport | None = None
        if isinstance(self._driver, NavigateDriver):
            route = self._driver.new_route(observation.position)
            motions = self._driver.motions(observation.tick)
            report = self._driver.report()
        elif observation.driver is not None:
            route = ()  # that of the driver before is not driven any more
        return UgvCommand(
            tick=observation.tick,
            acceleration=acceleration,
            backup_trajectories=motions,
            route=route,
            report=report,
        )

    def forget_commands(self) -> None:
        """Forget the commands so far: they were not sent, or another process has sent them."""
        if isinstance(self._driver, NavigateDriver):
            self._driver.forget_commands()
