"""A run that is flown now, as the page's source."""

from outrider.view.operator import SILENCE, RunClient
from outrider_dashboard.sources.protocol import SourceState


class Live(RunClient):
    """A run that is flown now: its client, which says how it stands in words too."""

    @property
    def standing(self) -> SourceState:
        """The run's state, with a line about what is wrong."""
        level, line = self._banner()
        return SourceState(
            level=level, line=line, router=self.connected, simulator=self.simulator.there
        )

    def _banner(self) -> tuple[str, str]:
        over = self.status is not None and self.status.over
        if not self.connected:
            if over:
                return "info", "The run is over, and its router has left. Waiting for the next one."
            cut_off = "this page is cut off from the run, and shows what it knew last."
            return "bad", f"The router is away: {cut_off}"
        if not self.simulator.there:
            if over:
                left = "The run is over and its simulator has left."
                return "info", f"{left} Waiting for the next one."
            if self.simulator.joined > 0.0:
                gone = "The simulator is gone: its process has died or has lost its way."
                return "bad", f"{gone} Waiting for it to come back."
            return "info", "Waiting for a simulator to join the run."
        if over:
            return "info", "The run is over."
        if self.age > SILENCE:
            return "bad", f"The simulator has said nothing for {self.age:.0f} s."
        return "", ""
