r"""The keys of a run's random numbers, derived one-way from its seed and its secret.

$$ K = \mathrm{BLAKE2b}_{secret}(seed, purpose, vehicle), \quad 128 \text{ bits} $$

With a secret nobody who sees what one key draws, or is told a key, learns anything of another key, of
the seed or of the secret: each is as good as a random number of 128 bits. Without one the seed is the
secret: it has 53 bits at most, and who knows any key, or enough draws of one, finds it by trying.
"""

import re
import secrets
import struct
from collections.abc import Iterable
from hashlib import blake2b

import numpy as np

from sim.models.randomness import RUN_PURPOSES, WordArray

_DIGITS = (32, 128)
"""Of a secret, fewest and most: 128 bits, and BLAKE2b's largest key."""
_PERSON = b"outrider"
_SEED, _PLACE = struct.Struct("<Q"), struct.Struct("<II")


def new_secret() -> str:
    """A secret of 128 bits that nobody has used before, as hexadecimal digits."""
    return secrets.token_hex(_DIGITS[0] // 2)


def check_secret(secret: str, source: str = "secret") -> str:
    """A secret as it is kept: lower-case hexadecimal digits; empty: none.

    Args:
        secret: As it was given.
        source: Named in the error. The secret itself is not.

    Raises:
        ValueError: If it is neither empty nor 32 to 128 hexadecimal digits, an even number of them.
    """
    kept = secret.lower()
    fewest, most = _DIGITS
    if kept and (not re.fullmatch(rf"[0-9a-f]{{{fewest},{most}}}", kept) or len(kept) % 2):
        raise ValueError(
            f"{source}: {len(secret)} characters that are no secret; allowed: an even number of "
            f"hexadecimal digits, {fewest} to {most} of them, such as `openssl rand -hex 16` makes"
        )
    return kept


def derive_secret(secret: str, name: str) -> str:
    """The secret of one among several evaluations that share one: draws of one tell nothing of another's.

    Args:
        secret: Theirs, as `check_secret` returns it; empty: none, and so is what is derived.
        name: Of the one.
    """
    if not secret:
        return ""
    key = bytes.fromhex(secret)
    return blake2b(name.encode(), digest_size=16, key=key, person=b"outrider-task").hexdigest()


def derive_keys(seeds: Iterable[int], vehicles: int, secret: str = "") -> WordArray:
    """The keys of runs that differ in their seeds.

    Args:
        seeds: One for each run, from 0 to 2**53 - 1.
        vehicles: How many there are in each.
        secret: Of all the runs, as `check_secret` returns it.

    Returns:
        Two words for each purpose and vehicle. Shape (seeds, RUN_PURPOSES, vehicles, 2).
    """
    base = blake2b(digest_size=16, key=bytes.fromhex(secret), person=_PERSON)
    places = [
        _PLACE.pack(purpose, row) for purpose in range(RUN_PURPOSES) for row in range(vehicles)
    ]
    digests = []
    for seed in seeds:
        told = _SEED.pack(seed)
        for place in places:
            digest = base.copy()
            digest.update(told + place)
            digests.append(digest.digest())
    words = np.frombuffer(b"".join(digests), dtype="<u8").astype(np.uint64)
    return words.reshape(-1, RUN_PURPOSES, vehicles, 2)


def derive_key(seed: int, purpose: int, vehicle: int, secret: str = "") -> str:
    """One of `derive_keys` as messages carry it: 32 hexadecimal digits, the first word's bytes first."""
    key, place = bytes.fromhex(secret), _PLACE.pack(purpose, vehicle)
    return blake2b(_SEED.pack(seed) + place, digest_size=16, key=key, person=_PERSON).hexdigest()
