"""BLAKE2b for whoever tries seeds by the million: as `sim.engine.run_keys` uses it, compiled (RFC 7693)."""

import numpy as np

from sim.kernels.compile import borrowing, compiled, inlined, released
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
_ALL = np.uint64(2**64 - 1)
_TOLD = 16
"""Bytes of seed, purpose and vehicle."""


@inlined
def _rotated(word: np.uint64, by: int) -> np.uint64:
    return (word >> np.uint64(by)) | (word << np.uint64(64 - by))


@inlined
def _mixed(a, b, c, d, x, y):
    a = a + b + x
    d = _rotated(d ^ a, 32)
    c = c + d
    b = _rotated(b ^ c, 24)
    a = a + b + y
    d = _rotated(d ^ a, 16)
    c = c + d
    b = _rotated(b ^ c, 63)
    return a, b, c, d


@borrowing
def _compress(
    h: WordArray, m: WordArray, count: np.uint64, last: np.uint64, out: WordArray
) -> None:
    """One block: the state h and the message m, shape (16,), after `count` bytes, into `out`, shape (8,)."""
    v_0, v_1, v_2, v_3, v_4, v_5, v_6, v_7 = h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7]
    v_8, v_9, v_10, v_11, v_12, v_13 = _IV[0], _IV[1], _IV[2], _IV[3], _IV[4] ^ count, _IV[5]
    v_14, v_15 = _IV[6] ^ last, _IV[7]
    for r in range(12):
        v_0, v_4, v_8, v_12 = _mixed(v_0, v_4, v_8, v_12, m[_ORDER[r, 0]], m[_ORDER[r, 1]])
        v_1, v_5, v_9, v_13 = _mixed(v_1, v_5, v_9, v_13, m[_ORDER[r, 2]], m[_ORDER[r, 3]])
        v_2, v_6, v_10, v_14 = _mixed(v_2, v_6, v_10, v_14, m[_ORDER[r, 4]], m[_ORDER[r, 5]])
        v_3, v_7, v_11, v_15 = _mixed(v_3, v_7, v_11, v_15, m[_ORDER[r, 6]], m[_ORDER[r, 7]])
        v_0, v_5, v_10, v_15 = _mixed(v_0, v_5, v_10, v_15, m[_ORDER[r, 8]], m[_ORDER[r, 9]])
        v_1, v_6, v_11, v_12 = _mixed(v_1, v_6, v_11, v_12, m[_ORDER[r, 10]], m[_ORDER[r, 11]])
        v_2, v_7, v_8, v_13 = _mixed(v_2, v_7, v_8, v_13, m[_ORDER[r, 12]], m[_ORDER[r, 13]])
        v_3, v_4, v_9, v_14 = _mixed(v_3, v_4, v_9, v_14, m[_ORDER[r, 14]], m[_ORDER[r, 15]])
    out[0], out[1], out[2], out[3] = (
        h[0] ^ v_0 ^ v_8,
        h[1] ^ v_1 ^ v_9,
        h[2] ^ v_2 ^ v_10,
        h[3] ^ v_3 ^ v_11,
    )
    out[4], out[5], out[6], out[7] = (
        h[4] ^ v_4 ^ v_12,
        h[5] ^ v_5 ^ v_13,
        h[6] ^ v_6 ^ v_14,
        h[7] ^ v_7 ^ v_15,
    )


@compiled
def _after(h: WordArray, m: WordArray, count: int) -> WordArray:
    out = np.empty(8, dtype=np.uint64)
    _compress(h, m, np.uint64(count), np.uint64(0), out)
    return out


def begun(secret: str) -> tuple[WordArray, int]:
    """The state with which the keys of all seeds begin, and the bytes up to their end."""
    key = bytes.fromhex(secret)
    parameters = np.zeros(8, dtype=np.uint64)
    parameters[0] = 16 | len(key) << 8 | 1 << 16 | 1 << 24
    parameters[6] = int.from_bytes(b"outrider", "little")
    if not key:
        return _IV ^ parameters, _TOLD
    return _after(
        _IV ^ parameters, np.frombuffer(key.ljust(128, b"\0"), dtype="<u8").copy(), 128
    ), 128 + _TOLD


@inlined
def key_for(h, count, seed, purpose, vehicle, m, out):
    """The key of one seed, purpose and vehicle; `m`, shape (16,), of zeros, and `out`, shape (8,), are for its sums."""
    m[0], m[1] = np.uint64(seed), np.uint64(purpose) | np.uint64(vehicle) << np.uint64(32)
    _compress(h, m, np.uint64(count), _ALL, out)
    return out[0], out[1]


@released
def one_key(state, count, seed, purpose, vehicle, m, out):
    """`key_for`, for Python."""
    return key_for(state, count, seed, purpose, vehicle, m, out)
