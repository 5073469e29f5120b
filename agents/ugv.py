"""The UGV's pilot: observation in, command out."""

from agents.drivers.table import DRIVERS, Driver
from bus.errors import ScenarioError
from bus.messages import UgvBriefing, UgvCommand, UgvObservation


class UgvPilot:
    """Answers each observation with the driver's acceleration. Pure: no input or output of its own.

    Raises:
        ScenarioError: If the briefing names an unknown driver.
    """

    def __init__(self, briefing: UgvBriefing, *, driver: Driver | None = None) -> None:
        if driver is None:
            if briefing.driver not in DRIVERS:
                raise ScenarioError(f"driver = {briefing.driver!r}: unknown; allowed: {', '.join(DRIVERS)}")
            driver = DRIVERS[briefing.driver](briefing)
        self._driver = driver

    def act(self, observation: UgvObservation) -> UgvCommand:
        """The command for this observation."""
        return UgvCommand(tick=observation.tick, acceleration=self._driver.drive(observation))
