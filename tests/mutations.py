"""Invalid messages for the tests of the bus.

Seeded mutations of real messages.
"""

import math
import random
import re
from collections.abc import Callable
from functools import cache
from typing import Any

import msgspec
from msgspec import inspect as kinds

from bus.keys import KEYS, Key
from tabular import words

REFUSALS = (msgspec.DecodeError, UnicodeDecodeError, RecursionError)
"""The errors that `Inbox` treats as an undecodable message; any other error ends its reader."""


def valid(kind: Any, rng: random.Random) -> Any:
    """Return a plain value that a type allows, sometimes at the edge of the allowed range."""
    match kind:
        case kinds.StructType(array_like=True):
            return [valid(part.type, rng) for part in kind.fields]
        case kinds.StructType():
            wanted = [part for part in kind.fields if part.required or rng.random() < 0.7]
            return {part.encode_name: valid(part.type, rng) for part in wanted}
        case kinds.FloatType():
            low = kind.ge if kind.ge is not None else math.nextafter(kind.gt, math.inf)
            largest = kind.le if kind.le is not None else math.nextafter(kind.lt, -math.inf)
            high = rng.choice([1.0, largest])
            return rng.choice([low, high]) if rng.random() < 0.1 else rng.uniform(low, high)
        case kinds.IntType():
            low = -(2**70) if kind.ge is None else kind.ge
            high = 2**70 if kind.le is None else kind.le
            near = rng.randint(low, min(high, low + 1000))
            return rng.choice([low, high, rng.randint(low, high), near])
        case kinds.StrType(pattern=None):
            return "".join(rng.choices('aZ0 _/"\\\n\0∞𝄞', k=rng.choice([0, 1, 8, kind.max_length])))
        case kinds.StrType(pattern=pattern) if str(pattern).startswith("^[0-9a-f]{32}$"):
            return rng.randbytes(16).hex()
        case kinds.StrType(pattern=pattern) if "[.~#*]$" in str(pattern):
            return rng.choice(".~#*")
        case kinds.StrType(pattern=pattern) if "[?.~#*]{64}" in str(pattern):
            return "".join(rng.choices("?.~#*", k=64))
        case kinds.StrType():
            return "v" + "".join(rng.choices("az09_", k=rng.choice([0, 3, 31])))
        case kinds.VarTupleType():
            return [valid(kind.item_type, rng) for _ in range(rng.choice([0, 1, 1, 2]))]
        case kinds.TupleType():
            return [valid(part, rng) for part in kind.item_types]
        case kinds.DictType():
            return {
                valid(kind.key_type, rng): valid(kind.value_type, rng)
                for _ in range(rng.randrange(3))
            }
        case kinds.UnionType():
            return valid(rng.choice(kind.types), rng)
        case kinds.EnumType():
            return rng.choice(list(kind.cls)).value
        case kinds.BytesType():
            low, high = kind.min_length or 0, kind.max_length
            return rng.randbytes(rng.randrange(low, 1 + (low + 29 if high is None else high)))
        case kinds.BoolType():
            return rng.random() < 0.5
        case kinds.NoneType():
            return None
    raise AssertionError(f"no sample for {kind}")


NUMBER = re.compile(rb"(?<=[:\[,])-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?(?=[,\]}])")
STRING = re.compile(rb'"[^"\\]*"')
ODD = [
    *(word.encode() for word in words("NaN Infinity -Infinity 1e308 -1e308 1e999 -1e999 5e-324")),
    *(word.encode() for word in words("1e-999 -1 0 -0 -0.0 0.1 1.0 1e2 01 +1 .5 1. 0x10 1_0 true")),
    *(word.encode() for word in words('null "" "1" "NaN" [] {} [1] 9007199254740993 1e6')),
    *(b"18446744073709551616", b"-9223372036854775809", b"1000000.0000000001"),
    *(b"9" * 400, b"9" * 4300, b"9" * 5000, b"-" + b"9" * 5000, b"0." + b"9" * 2000),
    b"1" + b"0" * 400 + b"e-400",
]
NOT_TEXT = [
    *(b"\xff", b"\xc3", b"\xed\xa0\x80", b"\xc0\x80", b"\xf5\x80\x80\x80", b"\\ud800"),
    *(b"\\udc00\\ud800", b"\\x41", b"\x00"),
]
LONG_TEXT = [
    *(b"x" * 501, b"x" * 5000, "∞".encode() * 500, b"\\u221e" * 500, b"a" * 33, b"\\n"),
    *(b"\xc3\xa9", b""),
]

Mutation = Callable[[bytes, bytes, random.Random], bytes]


def flip(payload: bytes, _other: bytes, rng: random.Random) -> bytes:
    changed = bytearray(payload)
    for _ in range(rng.choice([1, 1, 1, 2, 8])):
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def splice(payload: bytes, other: bytes, rng: random.Random) -> bytes:
    """Delete, duplicate or exchange a range of a payload, or cut its end."""
    begin = rng.randrange(len(payload))
    end = max(0, begin + rng.choice([-20, -1, 0, 1, 5, 20]))
    noise = rng.choice([b"", b"", rng.randbytes(3), *(b" ", b"\n", b",", b"]", b'"', b"9", b"\\")])
    rest = rng.choice([payload[end:], payload[end:], b"", other[rng.randrange(len(other)) :]])
    return payload[:begin] + noise + rest


def replaced(pattern, payload, rng, new):
    found = list(pattern.finditer(payload))
    if not found:
        return payload
    hit = rng.choice(found)
    return payload[: hit.start()] + new(hit.group()) + payload[hit.end() :]


def number(payload: bytes, _other: bytes, rng: random.Random) -> bytes:
    return replaced(NUMBER, payload, rng, lambda _old: rng.choice(ODD))


def string(payload: bytes, _other: bytes, rng: random.Random) -> bytes:
    return replaced(
        STRING, payload, rng, lambda old: old[:-1] + rng.choice(NOT_TEXT + LONG_TEXT) + b'"'
    )


def nest(payload: bytes, _other: bytes, rng: random.Random) -> bytes:
    depth = rng.choice([1, 3, 3, 50, 2000])
    opened, closed = rng.choice([(b"[", b"]"), (b'{"a":', b"}"), (b"[", b"")])
    return replaced(
        rng.choice([NUMBER, STRING]),
        payload,
        rng,
        lambda old: opened * depth + old + closed * depth,
    )


def fields(payload: bytes, other: bytes, rng: random.Random) -> bytes:
    """Remove, rename, add or duplicate a field of an object, or replace it by a field of another message."""
    tree = msgspec.json.decode(payload)
    branch = tree
    while rng.random() < 0.6 and (below := [p for p in branch.values() if p and type(p) is dict]):
        branch = rng.choice(below)
    name = rng.choice(list(branch)) if branch else ""
    stranger_name, stranger = rng.choice(list(msgspec.json.decode(other).items()) or [("", 0)])
    match rng.randrange(5):
        case 0:
            branch.pop(name, None)
        case 1:
            renamed = rng.choice([name.upper(), name + "_", " " + name, "", "a\x1b\nb"])
            branch[renamed] = branch.pop(name, None)
        case 2:
            branch[rng.choice([stranger_name, "velocity", "goal", "__class__"])] = stranger
        case 3:
            branch[name] = rng.choice([stranger, [stranger], [branch.get(name)] * 3, [[]]])
        case _:
            doubled = rng.choice([msgspec.json.encode(branch.get(name)), *ODD])
            return payload.replace(b"{", b'{"%s":%s,' % (name.encode(), doubled), 1)
    return msgspec.json.encode(tree)


BY_BYTE: tuple[Mutation, ...] = (flip, splice)
BY_MEANING: tuple[Mutation, ...] = (number, string, nest, fields, fields)


@cache
def real_messages(key: Key) -> tuple[bytes, ...]:
    """Return encoded messages of a key, as its writer sends them."""
    rng = random.Random(key.message.__name__)
    decoder, kind = msgspec.json.Decoder(key.message), kinds.type_info(key.message)
    return tuple(
        msgspec.json.encode(decoder.decode(msgspec.json.encode(valid(kind, rng))))
        for _ in range(200)
    )


def mutated(key: Key, rng: random.Random) -> bytes:
    """Return a real message or a mutated one; a possible second mutation works on bytes."""
    payload, other = rng.choice(real_messages(key)), rng.choice(real_messages(rng.choice(KEYS)))
    kind = rng.random()
    if kind < 0.05:
        return rng.choice([payload, other])
    if kind < 0.7:
        payload = rng.choice(BY_MEANING)(payload, other, rng)
    if kind > 0.6 and payload:
        payload = rng.choice(BY_BYTE)(payload, other, rng)
    return payload
