"""A run that is flown now, as the page's source."""

from collections.abc import Iterator

from bus.messages import Control, Drive, Message
from bus.session import Session
from outrider.view.operator import SILENCE, RunClient
from outrider.view.page.sources.protocol import SourceState


class Live:
    """A run that is flown now.

    Args:
        session: An operator's, or an observer's; then nothing can be steered.
    """

    def __init__(self, session: Session) -> None:
        self._client = RunClient(session)
        self.may_steer = self._client.may_steer

    def news(self) -> Iterator[Message]:
        """The messages since the last call, the newest of each kind."""
        return self._client.news()

    @property
    def factor(self) -> float:
        """Simulated seconds per second of wall time, lately."""
        return self._client.factor

    @property
    def standing(self) -> SourceState:
        """The run's state, with a line about what is wrong."""
        level, line = self._banner()
        client = self._client
        return SourceState(
            level=level, line=line, router=client.connected, simulator=client.present
        )

    def _banner(self) -> tuple[str, str]:
        client = self._client
        over = client.status is not None and client.status.over
        if not client.connected:
            if over:
                return "info", "The run is over, and its router has left. Waiting for the next one."
            cut_off = "this page is cut off from the run, and shows what it knew last."
            return "bad", f"The router is away: {cut_off}"
        if not client.present:
            if over:
                left = "The run is over and its simulator has left."
                return "info", f"{left} Waiting for the next one."
            if client.seen_simulator:
                gone = "The simulator is gone: its process has died or has lost its way."
                return "bad", f"{gone} Waiting for it to come back."
            return "info", "Waiting for a simulator to join the run."
        if over:
            return "info", "The run is over."
        if client.age > SILENCE:
            return "bad", f"The simulator has said nothing for {client.age:.0f} s."
        return "", ""

    def control(self, control: Control) -> bool:
        """Say something to the simulator; False if it cannot be said."""
        return self._client.control(control)

    def drive(self, vehicle: str, drive: Drive) -> bool:
        """Say something to a UGV; False if it cannot be said."""
        return self._client.drive(vehicle, drive)

    def close(self) -> None:
        """Say no more."""
        self._client.close()
