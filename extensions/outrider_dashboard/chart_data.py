"""Data of the charts and paths of a run, in bounded memory."""

import math
from collections import deque
from collections.abc import Callable

from bus.messages.links import LinkStatus
from bus.messages.team import Role
from bus.messages.telemetry import EscortTruth, Status, Truth

_FIRST_STRIDE = 0.1
"""Initial simulated time between two rows [s]; doubles whenever the history is full."""

_MAX_ROWS = 2400
"""Maximum number of rows."""

_LOSS_WINDOW = 1.0
"""Minimum simulated time over which the share of lost messages is averaged [s]."""

Row = tuple[float | None, ...]
_ROLES = list(Role)


class LossRates:
    """Recent share of lost messages on each link, from the counters of successive statuses."""

    def __init__(self) -> None:
        self._samples: deque[tuple[float, dict[str, LinkStatus]]] = deque()

    def update(self, status: Status) -> None:
        """Record the link counters of a status."""
        samples = self._samples
        if samples and (
            status.time < samples[-1][0] or samples[-1][1].keys() != status.links.keys()
        ):
            samples.clear()
        if not samples or samples[-1][1] != status.links:
            samples.append((status.time, status.links))
        while len(samples) > 2 and samples[1][0] <= status.time - _LOSS_WINDOW:
            samples.popleft()

    def share(self, link: str) -> float | None:
        """Return the recent share of lost messages of a link; None if none were sent."""
        sent = self._increase(link, 0, lambda now: now.sent)
        lost = self._increase(link, 0, lambda now: sum(now.lost.values()))
        return min(1.0, lost / sent) if sent else None

    def has_blackout(self, at: float, *vehicles: str) -> bool:
        """Return True if one of these vehicles has a blackout at a time [s].

        The blackout is a planned one, or a random one that has dropped messages.
        """
        if not self._samples:
            return False
        links = {
            name: link
            for name, link in self._samples[-1][1].items()
            if name.split("/")[0] in vehicles
        }
        planned = [
            row
            for link in links.values()
            if link.settings is not None
            for row in link.settings.blackouts
        ]
        if any(start <= at < start + length for start, length in planned):
            return True
        samples = self._samples
        recent = len(samples) > 1 and max(at, samples[-1][0]) - samples[-2][0] <= 2.0 * _LOSS_WINDOW
        return recent and any(
            self._increase(name, -2, lambda now: now.lost.get("blackout", 0)) for name in links
        )

    def _increase(self, link: str, since: int, count: Callable[[LinkStatus], int]) -> int:
        if len(self._samples) < 2 or link not in self._samples[-1][1]:
            return 0
        return count(self._samples[-1][1][link]) - count(self._samples[since][1][link])


class ChartData:
    """Rows of numbers over simulated time, thinned out as the run proceeds.

    Columns: time [s], real-time factor; x and y of each vehicle [m]; then for each escort the distance [m], e(t) [m²],
    the estimation error [m], the age of the newest detection [s] (None without one), the recent share of lost
    detections, 1 during a blackout, else 0, and the distance within which the UGV is visible [m] (None: always r_v, or
    a building hides it), and the code of the role in a team (0: none).
    """

    def __init__(self) -> None:
        self._stride = _FIRST_STRIDE
        self.rows: list[Row] = []
        self.newest: Row = ()
        """Row of the latest truth, whether or not it was stored."""
        self.vehicles: tuple[str, ...] = ()
        self.escorts: tuple[tuple[str, str], ...] = ()
        self.losses = LossRates()
        self.generation = 0
        """Counter that increases when stored rows are dropped or replaced."""

    def add(self, truth: Truth, factor: float, dt: float) -> None:
        """Add the row of a truth.

        Args:
            truth: True state of the run.
            factor: Simulated seconds per second of wall time.
            dt: Duration of a tick [s]; the UAV's report is one tick old.
        """
        vehicles = tuple(truth.vehicles)
        escorts = tuple((escort.uav, escort.ugv) for escort in truth.escorts)
        if (vehicles, escorts) != (self.vehicles, self.escorts) or (
            self.newest and truth.time < (self.newest[0] or 0.0)
        ):
            self.vehicles, self.escorts = vehicles, escorts
            self.rows, self._stride = [], _FIRST_STRIDE  # another run begins
            self.generation += 1
        self.newest = _row(truth, factor, dt, self.losses)
        if not self.rows or truth.time - (self.rows[-1][0] or 0.0) >= self._stride - 1e-9:
            self.rows.append(self.newest)
        if len(self.rows) > _MAX_ROWS:
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
            float(losses.has_blackout(truth.time, escort.uav, escort.ugv)),
            round(escort.sight_radius, 3) if escort.sight_radius else None,
            _role(escort),
        )
    return tuple(row)


def _role(escort: EscortTruth) -> int:
    """Return the code of the UAV's role in its team; 0: none."""
    role = None if escort.report is None else escort.report.role
    return 0 if role is None else 1 + _ROLES.index(role)


def _estimate_error(truth: Truth, escort: EscortTruth, dt: float) -> float | None:
    """Return the distance between the reported estimate and the UGV's position at that tick [m]."""
    ugv = truth.vehicles.get(escort.ugv)
    if escort.report is None or ugv is None:
        return None
    (x, y), (vx, vy), (guess_x, guess_y) = ugv.position, ugv.velocity, escort.report.estimate
    return round(math.hypot(guess_x - (x - vx * dt), guess_y - (y - vy * dt)), 4)
