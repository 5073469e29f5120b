"""The rogue: a UAV that wants to know what it may not, with all that it is told and a processor.

It knows this program, so it tries every seed: which of them gives the key that it was told, the looks that failed,
the noise? Who has the seed has p_delta without noise, and the other pilot's key.
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
"""The run's: among those that are tried, and not so far on that the search that finds it takes long."""
SEEDS = 2**24
"""Seeds that a search tries; the run's seed is among them."""
SECRET = bytes(range(100, 116)).hex()
ROW = 0
"""Index of uav_0 among the vehicles."""
WAYS = KEY, FLAGS, LOOKS = range(3)
"""The evidence of a search: the briefing's key, which looks succeeded, what they said."""
PURPOSE = (PILOT, DETECTION_CHANCE, DETECTION_NOISE)
"""Purpose of the keys that each kind of evidence tries."""
SOME = 2**16
"""Seeds whose keys are held at once."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Told:
    """All that one UAV has of a run that may hold something of its seed."""

    key: Key
    ticks: IntArray
    """Ticks of the detection attempts. Shape (attempts,)."""
    found: npt.NDArray[np.bool_]
    """True where a look succeeded. Shape (looks,)."""
    said: FloatArray
    """p_delta as they said it [m]; NaN where they failed. Shape (looks, 2)."""
    sigma: float
    cut: float
    fastest: float
    """The farthest that p_delta may go in a tick [m]."""


def _keys(seeds: range, purpose: int, vehicle: int, secret: str) -> WordArray:
    """Keys of the runs of these seeds, as `sim.engine.run_keys` derives them. Shape (seeds, 2)."""
    told = np.zeros(len(seeds), dtype=[("seed", "<u8"), ("purpose", "<u4"), ("vehicle", "<u4")])
    told["seed"], told["purpose"], told["vehicle"] = seeds, purpose, vehicle
    begun = blake2b(digest_size=16, key=bytes.fromhex(secret), person=b"outrider")
    digests = []
    for message in told.view("V16").tolist():
        digest = begun.copy()
        digest.update(message)
        digests.append(digest.digest())
    return np.frombuffer(b"".join(digests), dtype="<u8").astype(np.uint64).reshape(-1, 2)


@compiled
def _try_seeds(
    way: int,
    keys: WordArray,
    key: Key,
    ticks: IntArray,
    found: npt.NDArray[np.bool_],
    said: FloatArray,
    sigma: float,
    cut: float,
    fastest: float,
    hits: npt.NDArray[np.bool_],
) -> None:
    """Write into `hits` which of the keys may be the run's, as far as one way tells. Shape (keys,)."""
    for k in range(keys.shape[0]):
        tried = keys[k, 0], keys[k, 1]
        if way == KEY:
            fits = tried[0] == key[0] and tried[1] == key[1]
        elif way == FLAGS:
            # whatever the share of dropouts is, it divides what failed from what did not
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
                p_x, p_y = said[n, 0] - n_x, said[n, 1] - n_y
                if last >= 0 and math.hypot(p_x - x, p_y - y) > fastest * (ticks[n] - last) + 1e-9:
                    fits = False
                    break
                last, x, y = ticks[n], p_x, p_y
        hits[k] = fits


def _search(told: Told, way: int, secret: str, first: int, seeds: int) -> list[int]:
    """The seeds that may be the run's."""
    ticks, found = told.ticks, told.found
    if way == FLAGS:  # looks that failed among the first: most seeds are out after a few draws
        both = zip(ticks[~found].tolist(), ticks[found].tolist(), strict=False)
        ticks = np.array([tick for pair in both for tick in pair])
        found = np.arange(len(ticks)) % 2 == 1
    looks = (told.key, ticks, found, told.said, told.sigma, told.cut, told.fastest)
    fitting: list[int] = []
    for begin in range(first, first + seeds, SOME):
        some = range(begin, min(begin + SOME, first + seeds))
        hits = np.zeros(len(some), dtype=np.bool_)
        _try_seeds(way, _keys(some, PURPOSE[way], ROW, secret), *looks, hits)
        fitting += [some[k] for k in np.flatnonzero(hits).tolist()]
    return fitting


class _Bugged(InProcess):
    """The exchange of a flight, that keeps what uav_0 is told."""

    def __init__(self, flight: Flight) -> None:
        super().__init__(make_pilots(flight.scenario, flight.seed, secret=flight.secret))
        self.received: list[UavObservation] = []

    def publish(self, observations: Mapping[str, Observation]) -> None:
        super().publish(observations)
        mine = observations["uav_0"]
        assert isinstance(mine, UavObservation)
        self.received.append(mine)


def _told(secret: str, ticks: IntArray, said: FloatArray) -> Told:
    me = uav_briefing(SCENARIO, "uav_0", SEED, secret)
    assert me.detector.truncation is not None
    return Told(
        key=words_of(me.key),
        ticks=ticks,
        found=~np.isnan(said[:, 0]),
        said=said,
        sigma=me.detector.noise,
        cut=me.detector.truncation,
        fastest=(me.limits.max_speed + me.target_limits.max_speed) * me.dt,  # type: ignore[operator]
    )


@functools.cache
def _on_the_bus(secret: str) -> tuple[Told, FloatArray]:
    """Its messages from the bus, and the true p_delta."""
    flight = Flight(SCENARIO, SEED, secret=secret)
    bug = _Bugged(flight)
    flight.fly(bug)
    said = np.array(
        [
            look.detections[0].relative_position if look.detections else (math.nan,) * 2
            for look in bug.received
        ]
    )
    states = flight.recorder.states[:, :, :2]
    return _told(secret, np.arange(len(said)), said), states[:, 0] - states[:, 1]


@functools.cache
def _in_rows(secret: str) -> tuple[Told, FloatArray]:
    """The same of the environment's rows."""
    env = parallel_env(SCENARIO, secret=secret)
    seen, _ = env.reset(seed=SEED)
    fly, rows, true = pilots(env), [seen["uav_0"]], [env.world.position[0] - env.world.position[1]]
    while env.agents:
        seen, *_ = env.step({name: fly[name](seen[name]) for name in env.agents})
        rows.append(seen["uav_0"])
        true.append(env.world.position[0] - env.world.position[1])
    entries = by_name(UAV, np.array(rows))
    said = np.column_stack([entries["relative_x"], entries["relative_y"]])
    said[entries["detected"] == 0.0] = math.nan
    return _told(secret, np.arange(len(said)), said), np.array(true)


PLACES = {"bus": _on_the_bus, "rows": _in_rows}


def _without_noise(told: Told, seed: int, secret: str) -> FloatArray:
    """The looks that succeeded, less the noise of this seed. Shape (looks, 2)."""
    key = words_of(derive_key(seed, DETECTION_NOISE, ROW, secret))
    noise = [
        cut_normal_vector(told.sigma, told.cut, key, DETECTION_NOISE, tick, 0)
        for tick in told.ticks.tolist()
    ]
    return (told.said - np.array(noise))[told.found]


def test_the_rogue_derives_keys_as_the_simulator_does() -> None:
    for secret in ("", SECRET, "ab" * 64):
        for seed, purpose, vehicle in ((0, 0, 0), (SEED, 2, 1), (2**53 - 1, 6, 999)):
            seeds = range(seed, seed + 64)
            keys = [words_of(derive_key(one, purpose, vehicle, secret)) for one in seeds]
            assert _keys(seeds, purpose, vehicle, secret).tolist() == [list(key) for key in keys]


def test_in_a_run_with_a_secret_the_rogue_finds_no_seed() -> None:
    assert SEEDS > SEED
    told, _ = _on_the_bus(SECRET)
    rows, _ = _in_rows(SECRET)
    assert np.array_equal(told.said, rows.said, equal_nan=True)  # so one search is both
    assert (told.key, told.ticks.tolist()) == (rows.key, rows.ticks.tolist())
    assert 5 < (~told.found).sum() < 40
    for way in WAYS:  # all of them together fit no more seeds than each alone
        assert _search(told, way, "", 0, SEEDS) == []


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("way", WAYS, ids=["key", "flags", "looks"])
@pytest.mark.parametrize(
    "secret", ["", SECRET], ids=["without a secret", "with a secret that it knows"]
)
def test_rogue_finds_seed_and_true_position_without_a_secret(place, way, secret):
    told, true = PLACES[place](secret)
    assert _search(told, way, secret, SEED - 50_000, 100_000) == [SEED]
    assert _without_noise(told, SEED, secret) == pytest.approx(true[told.found], abs=1e-12)
    assert np.abs(told.said - true)[told.found].max() > 0.1  # which the looks themselves do not say


def test_secret_with_one_wrong_bit_finds_nothing() -> None:
    told, _ = _on_the_bus(SECRET)
    other = f"{int(SECRET, 16) ^ 1:032x}"
    assert all(_search(told, way, other, SEED - 50_000, 100_000) == [] for way in WAYS)
