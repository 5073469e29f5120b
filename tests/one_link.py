"""One radio link that carries Python objects, for the tests."""

from collections.abc import Sequence
from typing import Any

from bus.messages.links import LinkKind, LinkSettings, LinkStatus
from sim.channel.links import Links
from sim.channel.recorded import RecordedLink
from sim.models.randomness import Key


def conserved(status: LinkStatus) -> bool:
    """Return whether every message sent or duplicated is delivered, lost, queued or in transit."""
    left = status.delivered + sum(status.lost.values()) + status.queued + status.in_transit
    return status.sent + status.duplicated == left


class OneLink:
    """The only link of a `Links`."""

    def __init__(
        self, settings: LinkSettings, *, dt: float, key: Key, traces: Sequence[RecordedLink] = ()
    ) -> None:
        self.links = Links({(LinkKind.OPERATOR, "ugv_0"): settings}, dt=dt, traces=traces)
        self.links.records["key"] = key

    def send(self, tick: int, message: object, stamp: float) -> None:
        self.links.send_object(0, tick, message, stamp)

    def arrivals(self, tick: int) -> list[Any]:
        return self.links.arrivals(0, tick)

    def change(self, settings: LinkSettings) -> None:
        self.links.change(0, settings)

    def counters(self) -> LinkStatus:
        (status,) = self.links.status().values()
        return status
