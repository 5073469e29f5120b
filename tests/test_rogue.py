"""The rogue: a UAV that uses its observations and computing power to learn what it must not know.

It knows this program, so it tries every seed that gives its key, its failed detections and their noise. With the seed
it would know p_delta without noise, and the other pilot's key.
"""

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import blake2b

import numpy as np
import numpy.typing as npt
import pytest

from bus.messages.vehicle import Observation, UavObservation
from bus.observations import UAV, by_name
from outrider.envs.env_pilots import pilots
from outrider.envs.parallel import parallel_env
from outrider.running.flying import InProcess, make_pilots
from sim.compiling.compile import FloatArray, IntArray, compiled
from sim.engine.briefing import uav_briefing
from sim.engine.run_keys import derive_key
from sim.models.randomness import (
    DETECTION_CHANCE,
    DETECTION_NOISE,
    PILOT,
    Key,
    WordArray,
    cut_normal_vector,
    uniform,
    words_of,
)
from sim.scenario.loading import load_scenario
from sim.server.flight import Flight

SCENARIO = load_scenario(
    "escort", overrides=["duration=10.0", "detections.noise=0.2", "detections.dropout=0.08"]
)
SEED = 1_234_567
"""The seed of the run: within the search, and not so large that the search takes long."""
SEEDS = 2**21
"""Number of seeds that a search tries, that of the run among them."""
SECRET = bytes(range(100, 116)).hex()
ROW = 0
"""Index of uav_0 among the vehicles."""
EVIDENCE = KEY, FLAGS, DETECTIONS = range(3)
"""The evidence of a search: the key in the briefing, the successful detections, their positions."""
PURPOSE = (PILOT, DETECTION_CHANCE, DETECTION_NOISE)
"""Purpose of the keys for each kind of evidence."""
SOME = 2**16
"""Seeds whose keys are in memory at the same time."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Observed:
    """All data of one UAV that depend on the seed of the run."""

    key: Key
    ticks: IntArray
    """Ticks of the detection attempts. Shape (attempts,)."""
    found: npt.NDArray[np.bool_]
    """True where a detection attempt succeeded. Shape (attempts,)."""
    detected: FloatArray
    """Detected p_delta [m]; NaN where an attempt failed. Shape (attempts, 2)."""
    sigma: float
    cut: float
    fastest: float
    """Largest change of p_delta in a tick [m]."""


def _keys(seeds: range, purpose: int, vehicle: int, secret: str) -> WordArray:
    """Return the keys of the runs of these seeds, derived like in `sim.engine.run_keys`. Shape (seeds, 2)."""
    messages = np.zeros(len(seeds), dtype=[("seed", "<u8"), ("purpose", "<u4"), ("vehicle", "<u4")])
    messages["seed"], messages["purpose"], messages["vehicle"] = seeds, purpose, vehicle
    prefix = blake2b(digest_size=16, key=bytes.fromhex(secret), person=b"outrider")
    digests = []
    for message in messages.view("V16").tolist():
        digest = prefix.copy()
        digest.update(message)
        digests.append(digest.digest())
    return np.frombuffer(b"".join(digests), dtype="<u8").astype(np.uint64).reshape(-1, 2)


@compiled
def _try_seeds(
    evidence: int,
    keys: WordArray,
    key: Key,
    ticks: IntArray,
    found: npt.NDArray[np.bool_],
    detected: FloatArray,
    sigma: float,
    cut: float,
    fastest: float,
    hits: npt.NDArray[np.bool_],
) -> None:
    """Write to `hits` which of the keys agree with one kind of evidence. Shape (keys,)."""
    for k in range(keys.shape[0]):
        tried = keys[k, 0], keys[k, 1]
        if evidence == KEY:
            fits = tried[0] == key[0] and tried[1] == key[1]
        elif evidence == FLAGS:
            # for any dropout rate, it separates failed from successful attempts
            low, high = (0.0, 1.0)
            for n in range(ticks.shape[0]):
                drawn = uniform(tried, DETECTION_CHANCE, ticks[n], 0)
                if found[n]:
                    low = max(low, drawn)
                else:
                    high = min(high, drawn)
                if low >= high:
                    break
            fits = low < high
        else:
            fits, last, x, y = True, -1, 0.0, 0.0
            for n in range(ticks.shape[0]):
                if not found[n]:
                    continue
                n_x, n_y = cut_normal_vector(sigma, cut, tried, DETECTION_NOISE, ticks[n], 0)
                p_x, p_y = detected[n, 0] - n_x, detected[n, 1] - n_y
                if last >= 0 and math.hypot(p_x - x, p_y - y) > fastest * (ticks[n] - last) + 1e-9:
                    fits = False
                    break
                last, x, y = ticks[n], p_x, p_y
        hits[k] = fits


def _search(data: Observed, evidence: int, secret: str, first: int, seeds: int) -> list[int]:
    """Return the seeds that agree with one kind of evidence."""
    ticks, found = data.ticks, data.found
    if (
        evidence == FLAGS
    ):  # start with the failed attempts: they exclude most seeds after a few draws
        both = zip(ticks[~found].tolist(), ticks[found].tolist(), strict=False)
        ticks = np.array([tick for pair in both for tick in pair])
        found = np.arange(len(ticks)) % 2 == 1
    columns = (data.key, ticks, found, data.detected, data.sigma, data.cut, data.fastest)
    fitting: list[int] = []
    for begin in range(first, first + seeds, SOME):
        some = range(begin, min(begin + SOME, first + seeds))
        hits = np.zeros(len(some), dtype=np.bool_)
        _try_seeds(evidence, _keys(some, PURPOSE[evidence], ROW, secret), *columns, hits)
        fitting += [some[k] for k in np.flatnonzero(hits).tolist()]
    return fitting


class _Bugged(InProcess):
    """An exchange that records the observations of uav_0."""

    def __init__(self, flight: Flight) -> None:
        super().__init__(make_pilots(flight.scenario, flight.seed, secret=flight.secret))
        self.received: list[UavObservation] = []

    def publish(self, observations: Mapping[str, Observation]) -> None:
        super().publish(observations)
        mine = observations["uav_0"]
        assert isinstance(mine, UavObservation)
        self.received.append(mine)


def _observed(secret: str, ticks: IntArray, detected: FloatArray) -> Observed:
    me = uav_briefing(SCENARIO, "uav_0", SEED, secret)
    assert me.detector.truncation is not None
    return Observed(
        key=words_of(me.key),
        ticks=ticks,
        found=~np.isnan(detected[:, 0]),
        detected=detected,
        sigma=me.detector.noise,
        cut=me.detector.truncation,
        fastest=(me.limits.max_speed + me.target_limits.max_speed) * me.dt,  # type: ignore[operator]
    )


@functools.cache
def _from_bus(secret: str) -> tuple[Observed, FloatArray]:
    """Return the data from the bus, and the true p_delta."""
    flight = Flight(SCENARIO, SEED, secret=secret)
    bug = _Bugged(flight)
    flight.fly(bug)
    unseen = (math.nan, math.nan)
    detected = np.array(
        [
            seen.detections[0].relative_position if seen.detections else unseen
            for seen in bug.received
        ]
    )
    states = flight.recorder.states[:, :, :2]
    return _observed(secret, np.arange(len(detected)), detected), states[:, 0] - states[:, 1]


def _from_rows(secret: str) -> Observed:
    """Return the data from the environment's rows."""
    env = parallel_env(SCENARIO, secret=secret)
    seen, _ = env.reset(seed=SEED)
    fly, rows = pilots(env), [seen["uav_0"]]
    while env.agents:
        seen, *_ = env.step({name: fly[name](seen[name]) for name in env.agents})
        rows.append(seen["uav_0"])
    entries = by_name(UAV, np.array(rows))
    detected = np.column_stack([entries["relative_x"], entries["relative_y"]])
    detected[entries["detected"] == 0.0] = math.nan
    return _observed(secret, np.arange(len(detected)), detected)


def _without_noise(data: Observed, seed: int, secret: str) -> FloatArray:
    """Return the successful detections without the noise of this seed. Shape (detections, 2)."""
    key = words_of(derive_key(seed, DETECTION_NOISE, ROW, secret))
    noise = [
        cut_normal_vector(data.sigma, data.cut, key, DETECTION_NOISE, tick, 0)
        for tick in data.ticks.tolist()
    ]
    return (data.detected - np.array(noise))[data.found]


KNOWN = pytest.mark.parametrize(
    "secret", ["", SECRET], ids=["without a secret", "with a secret that it knows"]
)


@KNOWN
def test_the_rows_of_the_environment_show_no_more_than_the_bus(secret: str) -> None:
    data, rows = _from_bus(secret)[0], _from_rows(secret)
    assert np.array_equal(data.detected, rows.detected, equal_nan=True)  # so one search covers both
    assert (data.key, data.ticks.tolist()) == (rows.key, rows.ticks.tolist())


def test_in_a_run_with_a_secret_the_rogue_finds_no_seed() -> None:
    assert SEEDS > SEED
    data, _ = _from_bus(SECRET)
    assert 5 < (~data.found).sum() < 40
    for evidence in EVIDENCE:  # all kinds together agree with no more seeds than each alone
        assert _search(data, evidence, "", 0, SEEDS) == []


@pytest.mark.parametrize("evidence", EVIDENCE, ids=["key", "flags", "positions"])
@KNOWN
def test_rogue_finds_seed_and_true_position_without_a_secret(evidence, secret):
    data, true = _from_bus(secret)
    assert _search(data, evidence, secret, SEED - 50_000, 100_000) == [SEED]
    assert _without_noise(data, SEED, secret) == pytest.approx(true[data.found], abs=1e-12)
    # the detections themselves do not show it
    assert np.abs(data.detected - true)[data.found].max() > 0.1


def test_secret_with_one_wrong_bit_finds_nothing() -> None:
    data, _ = _from_bus(SECRET)
    other = f"{int(SECRET, 16) ^ 1:032x}"
    assert all(
        _search(data, evidence, other, SEED - 50_000, 100_000) == [] for evidence in EVIDENCE
    )
