"""The data of charts and tracks of a run so far, in bounded memory."""

import math
from collections import deque
from collections.abc import Callable

from bus.messages.links import LinkStatus
from bus.messages.telemetry import EscortTruth, Status, Truth

_FIRST_STRIDE = 0.1
"""Simulated time between two rows at first [s]; doubles whenever the history is full."""

_ROOM = 2400
"""So many rows are kept at most."""

_LATELY = 1.0
"""Simulated time over which the share of lost messages is taken at least [s]."""

Row = tuple[float | None, ...]


class LossRates:
    """Shares of messages that were lost lately, from the counters of one status after the other."""

    def __init__(self) -> None:
        self._told: deque[tuple[float, dict[str, LinkStatus]]] = deque()

    def take(self, status: Status) -> None:
        """Take down how the links have done so far."""
        told = self._told
        if told and (status.time < told[-1][0] or told[-1][1].keys() != status.links.keys()):
            told.clear()
        if not told or told[-1][1] != status.links:
            told.append((status.time, status.links))
        while len(told) > 2 and told[1][0] <= status.time - _LATELY:
            told.popleft()

    def share(self, link: str) -> float | None:
        """The share of a link's messages that was lost lately; None where nothing was sent."""
        sent = self._grown(link, 0, lambda now: now.sent)
        lost = self._grown(link, 0, lambda now: sum(now.lost.values()))
        return min(1.0, lost / sent) if sent else None

    def dark(self, at: float, *vehicles: str) -> bool:
        """True if a blackout is on for one of these vehicles at a time [s].

        A planned one, or one that has taken something.
        """
        if not self._told:
            return False
        links = {
            name: link for name, link in self._told[-1][1].items() if name.split("/")[0] in vehicles
        }
        planned = [
            row
            for link in links.values()
            if link.settings is not None
            for row in link.settings.blackouts
        ]
        if any(start <= at < start + length for start, length in planned):
            return True
        lately = (
            len(self._told) > 1 and max(at, self._told[-1][0]) - self._told[-2][0] <= 2.0 * _LATELY
        )
        return lately and any(
            self._grown(name, -2, lambda now: now.lost.get("blackout", 0)) for name in links
        )

    def _grown(self, link: str, since: int, count: Callable[[LinkStatus], int]) -> int:
        if len(self._told) < 2 or link not in self._told[-1][1]:
            return 0
        return count(self._told[-1][1][link]) - count(self._told[since][1][link])


class ChartData:
    """Rows of numbers over simulated time, thinned out as the run goes on.

    A row is: time [s], real-time factor; x and y of each vehicle [m]; then for each escort the distance [m], e(t) [m²],
    the error of the estimate [m] and the age of its newest detection [s] (None without one), the share of detections
    lost lately, and 1 where there is a blackout.
    """

    def __init__(self) -> None:
        self._stride = _FIRST_STRIDE
        self.rows: list[Row] = []
        self.newest: Row = ()
        """The row of the latest truth, whether it was kept or not."""
        self.vehicles: tuple[str, ...] = ()
        self.escorts: tuple[tuple[str, str], ...] = ()
        self.losses = LossRates()
        self.generation = 0
        """Another number: the rows before are no longer those that are kept now."""

    def add(self, truth: Truth, factor: float, dt: float) -> None:
        """Take down a truth.

        Args:
            truth: What is true now.
            factor: Simulated seconds per second of wall time.
            dt: Length of a tick [s]; the UAV reported one tick ago.
        """
        vehicles = tuple(truth.vehicles)
        escorts = tuple((escort.uav, escort.ugv) for escort in truth.escorts)
        if (vehicles, escorts) != (self.vehicles, self.escorts) or (
            self.newest and truth.time < (self.newest[0] or 0.0)
        ):
            self.vehicles, self.escorts = vehicles, escorts
            self.rows, self._stride = [], _FIRST_STRIDE  # another flight begins
            self.generation += 1
        self.newest = _row(truth, factor, dt, self.losses)
        if not self.rows or truth.time - (self.rows[-1][0] or 0.0) >= self._stride - 1e-9:
            self.rows.append(self.newest)
        if len(self.rows) > _ROOM:
            self.rows = self.rows[::2]
            self._stride *= 2.0
            self.generation += 1


def _row(truth: Truth, factor: float, dt: float, losses: LossRates) -> Row:
    row: list[float | None] = [round(truth.time, 4), round(factor, 3)]
    for vehicle in truth.vehicles.values():
        row += (round(vehicle.position[0], 3), round(vehicle.position[1], 3))
    for escort in truth.escorts:
        row += (
            round(escort.distance, 4),
            round(escort.coverage_error, 2),
            _estimate_error(truth, escort, dt),
        )
        lost = losses.share(f"{escort.uav}/detections")
        row += (
            None if escort.report is None else round(escort.report.age, 3),
            None if lost is None else round(lost, 2),
            float(losses.dark(truth.time, escort.uav, escort.ugv)),
        )
    return tuple(row)


def _estimate_error(truth: Truth, escort: EscortTruth, dt: float) -> float | None:
    """Distance of the reported estimate from the UGV's place when it was reported [m]."""
    ugv = truth.vehicles.get(escort.ugv)
    if escort.report is None or ugv is None:
        return None
    (x, y), (vx, vy), (guess_x, guess_y) = ugv.position, ugv.velocity, escort.report.estimate
    return round(math.hypot(guess_x - (x - vx * dt), guess_y - (y - vy * dt)), 4)
