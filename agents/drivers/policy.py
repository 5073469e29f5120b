"""Any function at the wheel: a policy of the user's own."""

import math
from collections.abc import Callable

import numpy as np

from agents.drivers.steering import Steering
from bus.errors import ScenarioError
from bus.messages import UgvBriefing, UgvObservation

Policy = Callable[[UgvObservation, UgvBriefing], object]
"""What a UGV perceives and was told in, its acceleration x and y [m/s²] out: a pair, a list or an array of two numbers."""

_WIDEST = 80  # characters of what was returned that an error shows


def _one_line(text: str) -> str:
    flat = " ".join(text.split())
    return flat if len(flat) <= _WIDEST else f"{flat[:_WIDEST]} ..."


def _pair(answer: object) -> tuple[float, float] | None:
    """Two finite numbers; None where the answer is anything else."""
    try:
        array = np.asarray(answer)
        if array.shape != (2,) or array.dtype.kind not in "fiu":
            return None
        with np.errstate(over="ignore"):  # a long double may be too large: it is infinite then, and refused
            x, y = array.astype(np.float64).tolist()
    except Exception:  # noqa: BLE001 - what turns an answer into an array is the policy's own code, as a tensor's
        return None
    return (x, y) if math.isfinite(x) and math.isfinite(y) else None


class PolicyDriver:
    """Asks the policy at each observation, and keeps what it answers within the UGV's bounds.

    An answer longer than u_max is shortened to it, and one that would go beyond v_max is turned off there. What the policy
    remembers is its own affair: a process that joins again calls it with all observations from the first.

    Args:
        briefing: What the UGV is told when it joins.
        policy: The function.
        name: What it is called in errors, as `module:function`.
    """

    def __init__(self, briefing: UgvBriefing, *, policy: Policy, name: str) -> None:
        self._briefing = briefing
        self._steering = Steering(briefing)
        self._policy = policy
        self._name = name

    def drive(self, observation: UgvObservation) -> tuple[float, float]:
        """The acceleration [m/s²] for this observation.

        Raises:
            ScenarioError: If the policy raises, or answers anything but two finite numbers; one line with its name, the tick
                and the answer.
        """
        where = f"policy = {self._name!r}: tick {observation.tick}"
        try:
            answer = self._policy(observation, self._briefing)
        except Exception as error:
            raise ScenarioError(f"{where}: raised {_one_line(f'{type(error).__name__}: {error}')}") from error
        pair = _pair(answer)
        if pair is None:
            raise ScenarioError(
                f"{where}: returned {_one_line(repr(answer))}; allowed: two finite numbers, the acceleration x and y [m/s²]"
            )
        return self._steering.within(observation, pair)
