r"""Keys of a run's random numbers, derived one-way from its seed and its secret.

$$ K = \mathrm{BLAKE2b}_{secret}(seed, purpose, vehicle), \quad 128 \text{ bits} $$

With a secret, neither a key nor its random numbers reveal anything about another key, the seed or the secret: each key
is equivalent to a random number of 128 bits. Without a secret, the seed is the secret: it has at most 53 bits, and can
be found from one key, or from enough of its random numbers, by trying all seeds.
"""

import operator
import re
import secrets
import struct
from collections.abc import Iterable, Sequence
from hashlib import blake2b

import numpy as np

from bus.messages.base import MAX_SEED
from sim.models.randomness import RUN_PURPOSES, WordArray

_DIGITS = (32, 128)
"""Minimum and maximum hexadecimal digits of a secret: 128 bits, and BLAKE2b's largest key."""
_PERSON = b"outrider"
_SEED, _PLACE = struct.Struct("<Q"), struct.Struct("<II")


def check_seed(seed: int) -> int:
    """Check a seed and return it as an `int`; NumPy's whole numbers are allowed.

    Raises:
        ValueError: If it is not a whole number from 0 to 2**53 - 1.
    """
    try:
        whole = operator.index(seed)
    except TypeError:
        whole = -1
    if not 0 <= whole <= MAX_SEED:
        raise ValueError(
            f"seed = {seed!r}: not a seed; allowed: a whole number from 0 to 2**53 - 1"
        )
    return whole


def new_secret() -> str:
    """Return a new random secret of 128 bits, as hexadecimal digits."""
    return secrets.token_hex(_DIGITS[0] // 2)


def check_secret(secret: str, source: str = "secret") -> str:
    """Check a secret and return it as lower-case hexadecimal digits; empty: none.

    Args:
        secret: The given secret.
        source: Name for error messages, which never contain the secret.

    Raises:
        ValueError: If it is neither empty nor 32 to 128 hexadecimal digits, an even number of them.
    """
    kept = secret.lower()
    fewest, most = _DIGITS
    if kept and (not re.fullmatch(rf"[0-9a-f]{{{fewest},{most}}}", kept) or len(kept) % 2):
        raise ValueError(
            f"{source}: {len(secret)} characters: not a secret; allowed: an even number of "
            f"hexadecimal digits, {fewest} to {most}, as from `openssl rand -hex 16`"
        )
    return kept


def derive_secret(secret: str, name: str) -> str:
    """Derive the secret of one of several evaluations: its random numbers reveal nothing about the others.

    Args:
        secret: Common secret, as `check_secret` returns it; empty: none, and the result is empty.
        name: Name of the evaluation.
    """
    if not secret:
        return ""
    key = bytes.fromhex(secret)
    return blake2b(name.encode(), digest_size=16, key=key, person=b"outrider-task").hexdigest()


def derive_keys(seeds: Iterable[int], vehicles: int, secret: str = "") -> WordArray:
    """Derive the keys of runs with different seeds.

    Args:
        seeds: Seed of each run, as `check_seed` returns it.
        vehicles: Number of vehicles in each run.
        secret: Common secret, as `check_secret` returns it.

    Returns:
        Two words for each purpose and vehicle. Shape (seeds, RUN_PURPOSES, vehicles, 2).
    """
    places = [(purpose, row) for purpose in range(RUN_PURPOSES) for row in range(vehicles)]
    words = keys_of_places(seeds, places, secret)
    return words.reshape(-1, RUN_PURPOSES, vehicles, 2)


def keys_of_places(
    seeds: Iterable[int], places: Sequence[tuple[int, int]], secret: str = ""
) -> WordArray:
    """Derive some keys of runs with different seeds.

    Args:
        seeds, secret: As in `derive_keys`.
        places: Purpose and vehicle of each key.

    Returns:
        Two words for each key. Shape (seeds, places, 2).
    """
    base = blake2b(digest_size=16, key=bytes.fromhex(secret), person=_PERSON)
    suffixes = [_PLACE.pack(purpose, row) for purpose, row in places]
    digests = []
    for seed in seeds:
        prefix = _SEED.pack(seed)
        for suffix in suffixes:
            digest = base.copy()
            digest.update(prefix + suffix)
            digests.append(digest.digest())
    words = np.frombuffer(b"".join(digests), dtype="<u8").astype(np.uint64)
    return words.reshape(-1, len(places), 2)


def derive_key(seed: int, purpose: int, vehicle: int, secret: str = "") -> str:
    """Derive one key in the form of a message: 32 hexadecimal digits, the first word's bytes first."""
    key, suffix = bytes.fromhex(secret), _PLACE.pack(purpose, vehicle)
    return blake2b(_SEED.pack(seed) + suffix, digest_size=16, key=key, person=_PERSON).hexdigest()
