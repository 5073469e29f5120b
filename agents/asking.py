"""A policy of the user's own, asked once a tick: its errors become one line."""

import logging
import math
import time
from collections.abc import Callable

import numpy as np

from bus.errors import ScenarioError, error_with_place, shortened

_LOG = logging.getLogger("outrider.policy")
LARGEST = 1e6
"""No message carries a larger component [m/s], [m/s²]: the bound of a vehicle that has none."""


def pair(answer: object, shape: tuple[int, ...] = (2,)) -> tuple[float, float] | None:
    """Two finite numbers, in an array of this shape; None where the answer is anything else."""
    try:
        array = np.asarray(answer)
        if array.shape != shape or array.dtype.kind not in "fiu":
            return None
        # A long double may be too large: it is infinite then, and refused.
        with np.errstate(over="ignore"):
            x, y = array.astype(np.float64).ravel().tolist()
    except Exception:  # noqa: BLE001 - what turns an answer into an array is the policy's own code, as a tensor's
        return None
    return (x, y) if math.isfinite(x) and math.isfinite(y) else None


class AskedPolicy:
    """A policy with its name for errors.

    Args:
        policy: The function.
        name: The field and the name, as `policy = 'module:function'`.
        dt: Length of a tick [s].
    """

    def __init__(self, policy: Callable[..., object], name: str, dt: float) -> None:
        self._policy, self._name, self._dt = policy, name, dt
        self._warm = self._slow = False

    def where(self, tick: int) -> str:
        """The policy at a tick, for errors."""
        return f"{self._name}: tick {tick}"

    def answer(self, tick: int, *given: object) -> object:
        """Return what the policy answers at a tick.

        Raises:
            ScenarioError: If it raises; one line with its name and the tick.
        """
        begun = time.perf_counter()
        try:
            answer = self._policy(*given)
        except ScenarioError as error:
            raise ScenarioError(f"{self.where(tick)}: {error}") from error
        except Exception as error:
            raise ScenarioError(
                f"{self.where(tick)}: raised {shortened(error_with_place(error))}"
            ) from error
        self._mind_time(tick, time.perf_counter() - begun)
        return answer

    def nonsense(self, tick: int, answer: object, allowed: str) -> ScenarioError:
        """Return the error for an answer that cannot be flown."""
        return ScenarioError(
            f"{self.where(tick)}: returned {shortened(repr(answer), 80)}; allowed: {allowed}"
        )

    def _mind_time(self, tick: int, seconds: float) -> None:
        """Say once that the policy is too slow for a clock; its first answer may take as long as it likes."""
        if self._warm and not self._slow and seconds > self._dt:
            self._slow = True
            _LOG.warning(
                "%s: took %.2f s to answer, longer than a tick of %g s: lockstep waits for it, in real time it "
                "comes too late",
                self.where(tick),
                seconds,
                self._dt,
            )
        self._warm = True
