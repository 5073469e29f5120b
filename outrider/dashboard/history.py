"""What the charts and the tracks need of a run so far, in bounded memory."""

import math

from bus.messages import EscortTruth, Truth

_FIRST_STRIDE = 0.1
"""Simulated time between two rows at first [s]; doubles whenever the history is full."""

Row = tuple[float | None, ...]


class History:
    """Rows of numbers over simulated time, thinned out as the run goes on.

    A row is: time [s], real-time factor; x and y of each vehicle [m]; then for each escort the distance [m], e(t) [m²] and the
    error of the estimate [m] (None without one).

    Args:
        room: How many rows there are at most.
    """

    def __init__(self, room: int = 2400) -> None:
        self._room = room
        self._stride = _FIRST_STRIDE
        self.rows: list[Row] = []
        self.newest: Row = ()
        """The row of the latest truth, whether it was kept or not."""
        self.vehicles: tuple[str, ...] = ()
        self.escorts: tuple[tuple[str, str], ...] = ()
        self.generation = 0
        """Another number: the rows before are no longer those that are kept now."""

    def clear(self) -> None:
        """Forget everything: another flight begins."""
        self.rows, self.newest, self._stride = [], (), _FIRST_STRIDE
        self.generation += 1

    def add(self, truth: Truth, factor: float, dt: float) -> None:
        """Take down a truth.

        Args:
            truth: What is true now.
            factor: Simulated seconds per second of wall time.
            dt: Length of a tick [s]; the UAV reported one tick ago.
        """
        vehicles = tuple(truth.vehicles)
        escorts = tuple((escort.uav, escort.ugv) for escort in truth.escorts)
        if (vehicles, escorts) != (self.vehicles, self.escorts) or (self.newest and truth.time < (self.newest[0] or 0.0)):
            self.vehicles, self.escorts = vehicles, escorts
            self.clear()
        self.newest = _row(truth, factor, dt)
        if not self.rows or truth.time - (self.rows[-1][0] or 0.0) >= self._stride - 1e-9:
            self.rows.append(self.newest)
        if len(self.rows) > self._room:
            self.rows = self.rows[::2]
            self._stride *= 2.0
            self.generation += 1


def _row(truth: Truth, factor: float, dt: float) -> Row:
    row: list[float | None] = [round(truth.time, 4), round(factor, 3)]
    for vehicle in truth.vehicles.values():
        row += (round(vehicle.position[0], 3), round(vehicle.position[1], 3))
    for escort in truth.escorts:
        row += (round(escort.distance, 4), round(escort.coverage_error, 2), _estimate_error(truth, escort, dt))
    return tuple(row)


def _estimate_error(truth: Truth, escort: EscortTruth, dt: float) -> float | None:
    """How far the reported estimate is from where the UGV was when it was reported [m]."""
    ugv = truth.vehicles.get(escort.ugv)
    if escort.report is None or ugv is None:
        return None
    (x, y), (vx, vy), (guess_x, guess_y) = ugv.position, ugv.velocity, escort.report.estimate
    return round(math.hypot(guess_x - (x - vx * dt), guess_y - (y - vy * dt)), 4)
