"""Live run as a source of the page."""

from outrider.view.operator import SILENCE, RunClient
from outrider_dashboard.sources.protocol import SourceState


class LiveRun(RunClient):
    """Client of a live run that also describes its state for the page."""

    @property
    def state(self) -> SourceState:
        """State of the run, with a line for the banner."""
        level, line = self._banner()
        return SourceState(
            level=level, line=line, router=self.connected, simulator=self.simulator.there
        )

    def _banner(self) -> tuple[str, str]:
        over = self.status is not None and self.status.over
        if not self.connected:
            if over:
                return (
                    "info",
                    "The run is over and its router has stopped. Waiting for the next run.",
                )
            return "bad", "The router is disconnected. The page shows the last known state."
        if not self.simulator.there:
            if over:
                stopped = "The run is over and its simulator has stopped."
                return "info", f"{stopped} Waiting for the next run."
            if self.simulator.joined > 0.0:
                return "bad", "The simulator is disconnected. Waiting for it to reconnect."
            return "info", "Waiting for a simulator to join the run."
        if over:
            return "info", "The run is over."
        if self.age > SILENCE:
            return "bad", f"No message from the simulator for {self.age:.0f} s."
        return "", ""
