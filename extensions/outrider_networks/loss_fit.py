"""Fit of blackouts, bursts and loss: runs of nearly equal length, then a Gilbert-Elliott chain."""

import math
from itertools import product

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit

from outrider_networks.samples import Sample
from sim.compiling.compile import FloatArray, compiled

_IN_A_ROW = 3
"""Fewest consecutive losses that count as a blackout."""


def fit_blackouts(sample: Sample) -> tuple[dict[str, float], Sample]:
    """Return random blackouts, and the messages without them.

    Runs of losses in a Gilbert-Elliott chain have geometrically distributed lengths; blackouts are of equal length.
    """
    runs = sample.lost_runs
    long = runs[runs[:, 1] - runs[:, 0] >= _IN_A_ROW]
    lengths = long[:, 1] - long[:, 0]
    over = float(lengths.mean()) - _IN_A_ROW if lengths.size else 0.0
    if lengths.size < 3 or over < 2.0 or float(lengths.var()) > 0.25 * over * (1.0 + over):
        return {}, sample
    kept = np.ones(len(sample.delay), dtype=bool)
    for begin, end in long:
        kept[begin:end] = False
    between = float(kept.sum()) * sample.interval / lengths.size
    found = {
        "blackout_length": float(lengths.mean()) * sample.interval,
        "blackout_interval": max(between, 1e-3),
    }
    return found, sample._replace(delay=sample.delay[kept])


@compiled
def _log_likelihood(
    gone: FloatArray, bad_share: float, memory: float, loss: float, burst_loss: float
) -> float:
    """Return the log-likelihood of losses (1) and arrivals (0) under a Gilbert-Elliott chain."""
    in_bad = 1.0 - (1.0 - loss) * (1.0 - burst_loss)
    bad, total = bad_share, 0.0
    for k in range(gone.shape[0]):
        if gone[k] > 0.0:
            in_one, in_other = bad * in_bad, (1.0 - bad) * loss
        else:
            in_one, in_other = bad * (1.0 - in_bad), (1.0 - bad) * (1.0 - loss)
        chance = max(in_one + in_other, 1e-300)
        total += math.log(chance)
        bad = bad_share + memory * (in_one / chance - bad_share)
    return total


def _chain(x: FloatArray, free_loss: bool, free_burst: bool) -> tuple[float, float, float, float]:
    """Return share of the bad state, memory, loss and loss in bursts from log-odds x; fixed ones are 0 or 1."""
    bad, memory, loss, burst = expit(x).tolist()
    return bad, memory, loss if free_loss else 0.0, burst if free_burst else 1.0


def _unlikely(x: FloatArray, gone: FloatArray, free_loss: bool, free_burst: bool) -> float:
    """Return the negative log-likelihood of `_chain`."""
    return -_log_likelihood(gone, *_chain(x, free_loss, free_burst))


def fit_loss(sample: Sample) -> dict[str, float]:
    """Return loss and bursts; each parameter only if it improves the fit."""
    gone = np.isnan(sample.delay).astype(np.float64)
    share, n = float(gone.mean()), len(gone)
    if share in (0.0, 1.0):
        return {"loss": share}
    chain = (0.0, 0.0, share, 0.0)
    best = _log_likelihood(gone, *chain) - 0.5 * math.log(n)
    memory = min(max(1.0 - 1.0 / float(sample.bursts.mean()), 0.1), 0.999)
    steady = (memory, 0.5 * (1.0 + memory))
    for free_loss, free_burst, start in product((False, True), (False, True), steady):
        at = np.array([0.5 * share, start, 0.5 * share, 0.8])
        found = minimize(
            _unlikely,
            np.log(at / (1.0 - at)),
            args=(gone, free_loss, free_burst),
            method="Nelder-Mead",
            options={"xatol": 1e-3, "fatol": 1e-2, "maxiter": 400},
        )
        price = 0.5 * (2 + free_loss + free_burst) * math.log(n)
        if -found.fun - price > best:
            best, chain = -found.fun - price, _chain(found.x, free_loss, free_burst)
    bad, memory, loss, burst = chain
    if bad == 0.0:
        return {"loss": loss}
    rate = -math.log(memory) / sample.interval  # of both states together [1/s]
    return {
        "loss": loss,
        "burst_length": 1.0 / (rate * (1.0 - bad)),
        "burst_interval": 1.0 / (rate * bad),
        "burst_loss": burst,
    }
