"""Rewards of the vehicles: sums of weighted terms."""

import dataclasses
import math
from dataclasses import dataclass

from sim.compiling.compile import compiled


@dataclass(frozen=True, slots=True, kw_only=True)
class RewardWeights:
    """Weight of each reward term. The names tell whether it is a cost or a gain; no weight is negative.

    Losing sight must never pay: if it ends the episode, the remaining ticks count as out of sight. `out_of_sight`
    should therefore be at least `uncovered`.

    Raises:
        ValueError: If a weight is negative or not finite.
    """

    uncovered: float = 1.0
    """UAV: cost of e(t) / e_full, the share of uncovered ground around its UGV [1/s]."""
    seen: float = 0.0
    """UAV: gain for the decrease of e(t) / e_full by its sensor.

    Without `uncovered`, e(t) itself is not computed, which is faster.
    """
    sight_lost: float = 10.0
    """UAV: cost each time that the UGV gets out of sight: of all UAVs of its team, or of a UAV without one."""
    out_of_sight: float = 2.0
    """UAV: cost while the UGV is out of sight, and for the rest of an episode that ends because of it [1/s]."""
    progress: float = 1.0
    """UGV: gain for progress towards its goal [1/m]."""
    goal: float = 5.0
    """UGV: gain for each goal reached."""
    effort: float = 0.0
    """Both: cost of the squared acceleration [s³/m²]."""
    reported: float = 0.0
    """UAV: gain for each square metre of ground that its UGV receives by radio for the first time [1/m²]."""
    hit: float = 0.0
    """UGV: cost for each hazard hit."""
    still: float = 0.0
    """UGV: cost while it stands still before arrival, on ground with hazards [1/s]."""
    team: bool = False
    """UAV: True to share the reward: each UAV of a team receives the mean over its team."""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if not 0.0 <= value < math.inf:
                raise ValueError(
                    f"RewardWeights.{field.name} = {value!r}: out of range; allowed: finite and not negative"
                )


UAV_TERMS: tuple[str, ...] = (
    "uncovered",
    "seen",
    "sight_lost",
    "out_of_sight",
    "effort",
    "reported",
)
UGV_TERMS: tuple[str, ...] = ("progress", "goal", "effort", "hit", "still")
"""Terms of a vehicle's reward in one tick."""

MISSION_TERMS = ("reported", "hit", "still")
"""Terms that are always 0 on ground without hazards."""


def full_error(r_o: float, desired: float) -> float:
    r"""Return e(t) of (4) without any coverage, far from the border [m²].

    $$ e_{full} = C^{*2} \int \phi\,dq = 2 \pi r_o^2 C^{*2} \left(\tfrac12 - \frac{2}{\pi^2}\right) $$

    Args:
        r_o: Radius of the density (9) [m].
        desired: C*.
    """
    return 2.0 * math.pi * r_o * r_o * desired * desired * (0.5 - 2.0 / math.pi**2)


@compiled
def uav_terms(
    weights: RewardWeights,
    error: float,
    gain: float,
    full: float,
    lost: bool,
    was_lost: bool,
    ticks_lost: int,
    acceleration: tuple[float, float],
    dt: float,
    reported: float,
) -> tuple[float, float, float, float, float, float]:
    """Return a UAV's reward terms of one tick, in the order of `UAV_TERMS`.

    Args:
        weights: Weights of the terms.
        error: Coverage error e(t) [m²].
        gain: Decrease of e(t) by its last sensor update [m²].
        full: `full_error` [m²].
        lost: True if the UGV is out of sight: of all UAVs of its team, or of a UAV without one.
        was_lost: True if it was at the previous tick.
        ticks_lost: Ticks charged while out of sight: one, or the rest of the episode if it ends because of that.
        acceleration: Applied acceleration [m/s²].
        dt: Duration of a tick [s].
        reported: Ground that its UGV has received for the first time [m²].
    """
    u_x, u_y = acceleration
    return (
        -weights.uncovered * error / full * dt,
        weights.seen * gain / full,
        -weights.sight_lost if lost and not was_lost else 0.0,
        -weights.out_of_sight * ticks_lost * dt if lost else 0.0,
        -weights.effort * (u_x * u_x + u_y * u_y) * dt,
        weights.reported * reported,
    )


@compiled
def ugv_terms(
    weights: RewardWeights,
    nearer: float,
    arrivals: int,
    acceleration: tuple[float, float],
    dt: float,
    hits: int,
    still: int,
) -> tuple[float, float, float, float, float]:
    """Return a UGV's reward terms of one tick, in the order of `UGV_TERMS`.

    Args:
        weights: Weights of the terms.
        nearer: Progress towards its goal [m].
        arrivals: Goals reached in this tick.
        acceleration: Applied acceleration [m/s²].
        dt: Duration of a tick [s].
        hits: Hazards hit in this tick.
        still: 1 if it stood still in this tick before arrival.
    """
    u_x, u_y = acceleration
    return (
        weights.progress * nearer,
        weights.goal * arrivals,
        -weights.effort * (u_x * u_x + u_y * u_y) * dt,
        -weights.hit * hits,
        -weights.still * still * dt,
    )
