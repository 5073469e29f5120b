"""What the environment pays for: the weights, and each vehicle's reward as a sum of named terms."""

import dataclasses
import math
from dataclasses import dataclass
from typing import NamedTuple


@dataclass(frozen=True, slots=True, kw_only=True)
class RewardWeights:
    """How much each term counts. All are costs or gains as their names say, and not negative.

    Losing sight must never pay: where it ends the episode, the ticks that are left are charged as out of sight, so
    `out_of_sight` should be at least `uncovered`.

    Raises:
        ValueError: If a weight is negative or not finite.
    """

    uncovered: float = 1.0
    """UAV: cost of e(t) / e_full, the share of ground around its UGV that is unseen [1/s]."""
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

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if not 0.0 <= value < math.inf:
                raise ValueError(f"RewardWeights.{field.name} = {value!r}: must be finite and not negative")


class UavTerms(NamedTuple):
    """A UAV's reward of one tick, term by term."""

    uncovered: float = 0.0
    sight_lost: float = 0.0
    out_of_sight: float = 0.0
    effort: float = 0.0


class UgvTerms(NamedTuple):
    """A UGV's reward of one tick, term by term."""

    progress: float = 0.0
    goal: float = 0.0
    effort: float = 0.0


def full_error(r_o: float, desired: float) -> float:
    r"""e(t) of (4) where nothing is seen and the border is far [m²].

    $$ e_{full} = C^{*2} \int \phi\,dq = 2 \pi r_o^2 C^{*2} \left(\tfrac12 - \frac{2}{\pi^2}\right) $$

    Args:
        r_o: Radius of the density (9) [m].
        desired: C*.
    """
    return 2.0 * math.pi * r_o * r_o * desired * desired * (0.5 - 2.0 / math.pi**2)
