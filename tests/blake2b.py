"""BLAKE2b for whoever tries seeds by the million: as `sim.engine.run_keys` uses it, compiled (RFC 7693)."""

import struct

import numpy as np

from sim.kernels.compile import borrowing, inlined
from sim.models.randomness import WordArray

_IV = np.array(
    [
        *(0x6A09E667F3BCC908, 0xBB67AE8584CAA73B, 0x3C6EF372FE94F82B, 0xA54FF53A5F1D36F1),
        *(0x510E527FADE682D1, 0x9B05688C2B3E6C1F, 0x1F83D9ABFB41BD6B, 0x5BE0CD19137E2179),
    ],
    dtype=np.uint64,
)
_ORDER = np.array(
    [
        [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15],
        [14, 10, 4, 8, 9, 15, 13, 6, 1, 12, 0, 2, 11, 7, 5, 3],
        [11, 8, 12, 0, 5, 2, 15, 13, 10, 14, 3, 6, 7, 1, 9, 4],
        [7, 9, 3, 1, 13, 12, 11, 14, 2, 6, 5, 10, 4, 0, 15, 8],
        [9, 0, 5, 7, 2, 4, 10, 15, 14, 1, 11, 12, 6, 8, 3, 13],
        [2, 12, 6, 10, 0, 11, 8, 3, 4, 13, 7, 5, 15, 14, 1, 9],
        [12, 5, 1, 15, 14, 13, 4, 10, 0, 7, 6, 3, 9, 2, 8, 11],
        [13, 11, 7, 14, 12, 1, 3, 9, 5, 0, 15, 4, 8, 6, 2, 10],
        [6, 15, 14, 9, 11, 3, 0, 8, 12, 2, 13, 7, 1, 4, 10, 5],
        [10, 2, 8, 4, 7, 6, 1, 5, 15, 11, 9, 14, 3, 12, 13, 0],
        [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15],
        [14, 10, 4, 8, 9, 15, 13, 6, 1, 12, 0, 2, 11, 7, 5, 3],
    ],
    dtype=np.uint64,  # unsigned: a compiled index that may be negative costs a comparison
)
_QUARTERS = (
    *((0, 4, 8, 12), (1, 5, 9, 13), (2, 6, 10, 14), (3, 7, 11, 15)),
    *((0, 5, 10, 15), (1, 6, 11, 12), (2, 7, 8, 13), (3, 4, 9, 14)),
)
"""The words of the state that are mixed, one after the other, in each round."""
_ALL = np.uint64(2**64 - 1)
_TOLD = 16
"""Bytes of seed, purpose and vehicle."""


LANES = 64
"""Seeds that are tried at once, as the words of vectors: a core adds eight of them in the time of one."""
ROOM = (16 + 2 + 2, LANES)
"""The shape of what sums are made in: the state, the words of the message that are not zero, the key."""
_MESSAGE, _KEY = 16, 18


@borrowing
def _turn(a: WordArray, b: WordArray, c: WordArray, d: WordArray, first: int, then: int) -> None:
    """Half of BLAKE2b's G on four words, lane by lane; what is turned is turned by so many bits."""
    r, s = np.uint64(first), np.uint64(then)
    for n in range(LANES):
        a[n] += b[n]
        turned = d[n] ^ a[n]
        d[n] = (turned >> r) | (turned << (np.uint64(64) - r))
        c[n] += d[n]
        turned = b[n] ^ c[n]
        b[n] = (turned >> s) | (turned << (np.uint64(64) - s))


@borrowing
def _mix(w: WordArray, a: int, b: int, c: int, d: int, x: np.uint64, y: np.uint64) -> None:
    """G on words a to d of the state, with words x and y of the message, of which all but two are zero."""
    if x < 2:
        for n in range(LANES):
            w[a, n] += w[_MESSAGE + np.int64(x), n]
    _turn(w[a], w[b], w[c], w[d], 32, 24)
    if y < 2:
        for n in range(LANES):
            w[a, n] += w[_MESSAGE + np.int64(y), n]
    _turn(w[a], w[b], w[c], w[d], 16, 63)


def _turned(word: int, by: int) -> int:
    return (word >> by | word << (64 - by)) & int(_ALL)


def _after(h: list[int], m: list[int], count: int) -> list[int]:
    """The state after a block of which the message goes on, with numbers of Python's own."""
    v = h + [int(word) for word in _IV]
    v[12] ^= count
    for order in _ORDER.tolist():
        for k, (a, b, c, d) in enumerate(_QUARTERS):
            for turns, word in (((32, 24), m[order[2 * k]]), ((16, 63), m[order[2 * k + 1]])):
                v[a] = (v[a] + v[b] + word) & int(_ALL)
                v[d] = _turned(v[d] ^ v[a], turns[0])
                v[c] = (v[c] + v[d]) & int(_ALL)
                v[b] = _turned(v[b] ^ v[c], turns[1])
    return [h[k] ^ v[k] ^ v[8 + k] for k in range(8)]


def begun(secret: str) -> tuple[WordArray, int]:
    """The state with which the keys of all seeds begin, and the bytes up to their end."""
    key = bytes.fromhex(secret)
    state = [int(word) for word in _IV]
    state[0] ^= 16 | len(key) << 8 | 1 << 16 | 1 << 24
    state[6] ^= int.from_bytes(b"outrider", "little")
    if key:
        state = _after(state, list(struct.unpack("<16Q", key.ljust(128, b"\0"))), 128)
    return np.array(state, dtype=np.uint64), _TOLD + 128 * bool(key)


@borrowing
def derive(h: WordArray, count: int, seed: int, purpose: int, vehicle: int, w: WordArray) -> None:
    """Derive the keys of LANES seeds from `seed` on, for `key_of_lane`; all sums are made in `w`, shape ROOM."""
    for n in range(LANES):
        for k in range(8):
            w[k, n], w[8 + k, n] = h[k], _IV[k]
        w[12, n] ^= np.uint64(count)
        w[14, n] ^= _ALL
        w[_MESSAGE, n] = np.uint64(seed + n)
        w[_MESSAGE + 1, n] = np.uint64(purpose) | np.uint64(vehicle) << np.uint64(32)
    for r in range(12):
        order = _ORDER[r]
        _mix(w, 0, 4, 8, 12, order[0], order[1])
        _mix(w, 1, 5, 9, 13, order[2], order[3])
        _mix(w, 2, 6, 10, 14, order[4], order[5])
        _mix(w, 3, 7, 11, 15, order[6], order[7])
        _mix(w, 0, 5, 10, 15, order[8], order[9])
        _mix(w, 1, 6, 11, 12, order[10], order[11])
        _mix(w, 2, 7, 8, 13, order[12], order[13])
        _mix(w, 3, 4, 9, 14, order[14], order[15])
    for n in range(LANES):
        w[_KEY, n] = h[0] ^ w[0, n] ^ w[8, n]
        w[_KEY + 1, n] = h[1] ^ w[1, n] ^ w[9, n]


@inlined
def key_of_lane(w, n):
    """The key that `derive` has found for the n-th seed."""
    return w[_KEY, n], w[_KEY + 1, n]
