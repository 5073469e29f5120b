"""Calls of a user's policy, once per tick, with errors reported on one line."""

import logging
import math
import time
from collections.abc import Callable

import numpy as np

from bus.errors import ScenarioError, error_with_place, shortened

_LOG = logging.getLogger("outrider.policy")
LARGEST = 1e6
"""Largest component that a message may carry [m/s], [m/s²]; replaces an infinite bound."""


def finite(answer: object, shape: tuple[int, ...]) -> list[float] | None:
    """Return the finite numbers of an array of the given shape; None if the answer is anything else."""
    try:
        array = np.asarray(answer)
        if array.shape != shape or array.dtype.kind not in "fiu":
            return None
        # A long double may exceed float64: it becomes infinite and is rejected below.
        with np.errstate(over="ignore"):
            values: list[float] = array.astype(np.float64).ravel().tolist()
    except Exception:  # noqa: BLE001 - the conversion may run the policy's own code, for example of a tensor
        return None
    return values if all(map(math.isfinite, values)) else None


def pair(answer: object) -> tuple[float, float] | None:
    """Return two finite numbers; None if the answer is anything else."""
    values = finite(answer, (2,))
    return None if values is None else (values[0], values[1])


class AskedPolicy:
    """User's policy, with a name for error messages.

    Args:
        policy: The function.
        name: Field and name, for example `policy = 'module:function'`.
        dt: Length of a tick [s].
    """

    def __init__(self, policy: Callable[..., object], name: str, dt: float) -> None:
        self._policy, self._name, self._dt = policy, name, dt
        self._warm = self._slow = False

    def where(self, tick: int) -> str:
        """Return the policy's name and the tick, for error messages."""
        return f"{self._name}: tick {tick}"

    def answer(self, tick: int, *given: object) -> object:
        """Call the policy and return its answer.

        Raises:
            ScenarioError: If the policy raises; one line with its name and the tick.
        """
        started = time.perf_counter()
        try:
            answer = self._policy(*given)
        except ScenarioError as error:
            raise ScenarioError(f"{self.where(tick)}: {error}") from error
        except Exception as error:
            raise ScenarioError(
                f"{self.where(tick)}: raised {shortened(error_with_place(error))}"
            ) from error
        self._check_duration(tick, time.perf_counter() - started)
        return answer

    def invalid_answer(self, tick: int, answer: object, allowed: str) -> ScenarioError:
        """Return the error for an unusable answer."""
        return ScenarioError(
            f"{self.where(tick)}: returned {shortened(repr(answer), 80)}; allowed: {allowed}"
        )

    def _check_duration(self, tick: int, seconds: float) -> None:
        """Warn once if the policy needs longer than a tick; the first call is exempt, since it may compile."""
        if self._warm and not self._slow and seconds > self._dt:
            self._slow = True
            _LOG.warning(
                "%s: took %.2f s to answer, longer than the tick of %g s; lockstep waits, in real time the "
                "answer is late",
                self.where(tick),
                seconds,
                self._dt,
            )
        self._warm = True
