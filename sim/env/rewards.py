"""Rewards: the weights, and each vehicle's reward as a sum of named terms."""

import dataclasses
import math
from dataclasses import dataclass

from sim.compiling.compile import compiled


@dataclass(frozen=True, slots=True, kw_only=True)
class RewardWeights:
    """The weight of each term. All are costs or gains as their names say, and not negative.

    Losing sight must never pay: where it ends the episode, the ticks that are left are charged as out of sight, so
    `out_of_sight` should be at least `uncovered`.

    Raises:
        ValueError: If a weight is negative or not finite.
    """

    uncovered: float = 1.0
    """UAV: cost of e(t) / e_full, the share of ground around its UGV that is unseen [1/s]."""
    seen: float = 0.0
    """UAV: gain for e(t) / e_full falling by what it sees.

    Without `uncovered` e(t) itself is not needed, which is faster.
    """
    sight_lost: float = 10.0
    """UAV: cost each time that the distance reaches r_v."""
    out_of_sight: float = 2.0
    """UAV: cost while the distance is r_v or more, and for the rest of an episode that ends by it [1/s]."""
    progress: float = 1.0
    """UGV: gain for coming nearer to its goal [1/m]."""
    goal: float = 5.0
    """UGV: gain for each goal reached."""
    effort: float = 0.0
    """Both: cost of the squared acceleration [s³/m²]."""
    told: float = 0.0
    """UAV: gain for each square metre of ground of which its UGV is told for the first time by radio [1/m²]."""
    hit: float = 0.0
    """UGV: cost for each hazard that it runs into."""
    still: float = 0.0
    """UGV: cost while it stands still before it has arrived, on ground with hazards [1/s]."""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if not 0.0 <= value < math.inf:
                raise ValueError(
                    f"RewardWeights.{field.name} = {value!r}: must be finite and not negative"
                )


UAV_TERMS: tuple[str, ...] = ("uncovered", "seen", "sight_lost", "out_of_sight", "effort", "told")
UGV_TERMS: tuple[str, ...] = ("progress", "goal", "effort", "hit", "still")
"""Terms of a vehicle's reward of one tick."""

MISSION_TERMS = ("told", "hit", "still")
"""Those that are always 0 on ground without hazards."""


def full_error(r_o: float, desired: float) -> float:
    r"""e(t) of (4) where nothing is seen and the border is far [m²].

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
    told: float,
) -> tuple[float, float, float, float, float, float]:
    """A UAV's reward of one tick, in the order of `UAV_TERMS`.

    Args:
        weights: What is paid for.
        error: e(t) [m²].
        gain: How far its last look made e(t) fall [m²].
        full: `full_error` [m²].
        lost: Whether the distance is r_v or more.
        was_lost: Whether it was at the tick before.
        ticks_lost: Ticks that are charged if it is out of sight: one, and the rest of the episode where it ends by
            that.
        acceleration: As applied [m/s²].
        dt: Length of a tick [s].
        told: Ground of which its UGV has been told for the first time [m²].
    """
    u_x, u_y = acceleration
    return (
        -weights.uncovered * error / full * dt,
        weights.seen * gain / full,
        -weights.sight_lost if lost and not was_lost else 0.0,
        -weights.out_of_sight * ticks_lost * dt if lost else 0.0,
        -weights.effort * (u_x * u_x + u_y * u_y) * dt,
        weights.told * told,
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
    """A UGV's reward of one tick, in the order of `UGV_TERMS`.

    Args:
        weights: What is paid for.
        nearer: How much nearer it came to its goal [m].
        arrivals: Goals reached in this tick.
        acceleration: As applied [m/s²].
        dt: Length of a tick [s].
        hits: Hazards that it has run into in this tick.
        still: 1 if it stood still in this tick before it had arrived.
    """
    u_x, u_y = acceleration
    return (
        weights.progress * nearer,
        weights.goal * arrivals,
        -weights.effort * (u_x * u_x + u_y * u_y) * dt,
        -weights.hit * hits,
        -weights.still * still * dt,
    )
