"""Distance that the UGVs of a run keep from buildings under the drivers in control, which the UAVs do not know."""

from collections.abc import Mapping

from bus.messages.vehicle import Command, UgvCommand
from sim.engine.briefing import clearance_notice
from sim.scenario.clearance import guaranteed_clearance
from sim.scenario.types import Scenario
from sim.world import World

_ITSELF = "navigate"
"""Driver that certifies, in each of its reports, that it keeps its distance."""


class ClearanceWatch:
    """Record of the ticks at which each UAV's UGV keeps the distance from buildings that certificates assume.

    After a change of driver, the UGV keeps it from the first report on in which its new driver certifies it.

    Args:
        scenario: Scenario of the run.
        world: World of the run.
    """

    def __init__(self, scenario: Scenario, world: World) -> None:
        self._scenario, self._world = scenario, world
        self._rows = {ugv.name: world.names.index(ugv.name) for ugv in scenario.ugv}
        self._drivers = {ugv.name: ugv.driver for ugv in scenario.ugv}
        self._since: list[int | None] = [None] * len(world.uavs)
        self.notices: dict[str, str] = {}
        """Warning for each UGV whose driver has ended its clearance."""

    def assign(self, ugv: str, driver: str) -> str:
        """Change the driver of a UGV from this tick on; return a warning if this ends its clearance, else empty."""
        self._drivers[ugv] = driver
        self._world.guarantee_clearance(self._rows[ugv], kept=False)
        self.notices.pop(ugv, None)
        notice = clearance_notice(self._scenario, ugv, driver)
        if notice:
            self.notices[ugv] = notice
        return notice

    def update(self, commands: Mapping[str, Command]) -> None:
        """Record the tick that these commands answer, before the world advances."""
        for ugv in self._scenario.ugv:
            command = commands.get(ugv.name)
            if self._drivers[ugv.name] != _ITSELF or not isinstance(command, UgvCommand):
                continue
            if not guaranteed_clearance(self._scenario, ugv, _ITSELF):
                continue
            if command.report is None:  # the user's own program drives
                self._world.guarantee_clearance(self._rows[ugv.name], kept=False)
            elif command.report.certified and command.tick == self._world.tick:
                self._world.guarantee_clearance(self._rows[ugv.name], kept=True)
        for uav, since in enumerate(self._since):
            kept = self._world.keeps_clearance(uav)
            self._since[uav] = None if not kept else self._world.tick if since is None else since

    def since(self) -> tuple[int | None, ...]:
        """Return the tick from which on each UAV's UGV has kept its distance; None: it does not keep it."""
        return tuple(self._since)
