"""Invalid messages for the tests of the bus.

Seeded mutations of real messages, and a check that a value fits its type.
"""

import base64
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
            return rng.choice([low, high, rng.randint(low, high), rng.randint(low, low + 1000)])
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
            return rng.randbytes(rng.randrange(30))
        case kinds.BoolType():
            return rng.random() < 0.5
        case kinds.NoneType():
            return None
    raise AssertionError(f"no sample for {kind}")


def between(value: float, kind: Any) -> bool:
    within = (kind.ge is None or value >= kind.ge) and (kind.gt is None or value > kind.gt)
    within = within and (kind.lt is None or value < kind.lt)
    return within and (kind.le is None or value <= kind.le) and kind.multiple_of is None


def allowed(value: Any, kind: Any) -> bool:
    """Return whether a decoded value and all its parts fit its type."""
    match kind:
        case kinds.StructType():
            return type(value) is kind.cls and all(
                allowed(getattr(value, part.name), part.type) for part in kind.fields
            )
        case kinds.FloatType():
            bounded = type(value) is float and math.isfinite(value) and abs(value) <= 1e12
            return bounded and between(value, kind)
        case kinds.IntType():
            return type(value) is int and between(value, kind)
        case kinds.StrType():
            whole = rf"(?s:.){{0,{kind.max_length}}}"
            if kind.pattern:
                whole = kind.pattern.removesuffix(r"(?!\n)").strip("^$")
            fits = re.compile(whole).fullmatch
            return type(value) is str and fits(value) is not None
        case kinds.VarTupleType():
            return type(value) is tuple and all(allowed(part, kind.item_type) for part in value)
        case kinds.TupleType():
            right = type(value) is tuple and len(value) == len(kind.item_types)
            return right and all(map(allowed, value, kind.item_types))
        case kinds.DictType():
            return type(value) is dict and all(
                allowed(name, kind.key_type) and allowed(part, kind.value_type)
                for name, part in value.items()
            )
        case kinds.UnionType():
            return any(allowed(value, part) for part in kind.types)
        case kinds.EnumType():
            return type(value) is kind.cls
        case kinds.BytesType():
            return type(value) is bytes
        case kinds.BoolType():
            return type(value) is bool
        case kinds.NoneType():
            return value is None
    raise AssertionError(f"no check for {kind}")


def matches(value: Any, parsed: Any) -> bool:
    """Return whether a decoded value equals the result of Python's own JSON parser.

    A field that is not in the payload may have any value.
    """
    if isinstance(value, msgspec.Struct) and isinstance(parsed, list):
        return all(map(matches, msgspec.structs.astuple(value), parsed))
    if isinstance(value, msgspec.Struct):
        known = parsed.keys() <= set(value.__struct_fields__)
        return known and all(matches(getattr(value, name), part) for name, part in parsed.items())
    if isinstance(value, dict):
        return value.keys() == parsed.keys() and all(
            matches(value[name], part) for name, part in parsed.items()
        )
    if isinstance(value, tuple):
        return len(value) == len(parsed) and all(map(matches, value, parsed))
    if isinstance(value, bytes):
        return value == base64.b64decode(parsed, validate=True)
    return bool(value == (float(parsed) if isinstance(value, float) else parsed))


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


def random_range(payload: bytes, rng: random.Random) -> tuple[int, int]:
    """Return a random range of a payload."""
    begin = rng.randrange(len(payload) + 1)
    return begin, min(len(payload), begin + rng.choice([1, 1, 2, 5, 20]))


def flip(payload: bytes, _other: bytes, rng: random.Random) -> bytes:
    changed = bytearray(payload)
    for _ in range(rng.choice([1, 1, 1, 2, 8])):
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def delete(payload: bytes, _other: bytes, rng: random.Random) -> bytes:
    begin, end = random_range(payload, rng)
    return payload[:begin] + payload[end:]


def insert(payload: bytes, _other: bytes, rng: random.Random) -> bytes:
    begin, _ = random_range(payload, rng)
    noise = [rng.randbytes(3), *(b" ", b"\n", b",", b"]", b'"', b"0", b"9", b"\\")]
    return payload[:begin] + rng.choice(noise) + payload[begin:]


def duplicate(payload: bytes, _other: bytes, rng: random.Random) -> bytes:
    begin, end = random_range(payload, rng)
    return payload[:end] + payload[begin:]


def truncate(payload: bytes, _other: bytes, rng: random.Random) -> bytes:
    return payload[: rng.randrange(len(payload))]


def splice(payload: bytes, other: bytes, rng: random.Random) -> bytes:
    return payload[: rng.randrange(len(payload))] + other[rng.randrange(len(other)) :]


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


def parts_of(branch: Any) -> Any:
    return branch.values() if isinstance(branch, dict) else branch


def fields(payload: bytes, other: bytes, rng: random.Random) -> bytes:
    """Remove, rename, duplicate or add a field of an object, or replace it by a field of another message."""
    tree = msgspec.json.decode(payload)
    branch = tree
    while below := [part for part in parts_of(branch) if part and type(part) in HOLDERS]:
        if rng.random() < 0.4:
            break
        branch = rng.choice(below)
    name = rng.choice(list(branch)) if branch and isinstance(branch, dict) else ""
    change = rng.randrange(6) if isinstance(branch, dict) else 6
    stranger_name, stranger = rng.choice(list(msgspec.json.decode(other).items()) or [("", 0)])
    if change in (0, 1):
        value = branch.pop(name, None)
        if change == 1:
            branch[rng.choice([name.upper(), name + "_", " " + name, "", "a\x1b\nb"])] = value
    elif change == 2:
        branch[rng.choice([stranger_name, "velocity", "goal", "__class__", "type"])] = stranger
    elif change == 3:
        branch[name] = stranger
    elif change == 4:
        doubled = rng.choice([msgspec.json.encode(branch.get(name)), *ODD])
        return payload.replace(b"{", b'{"%s":%s,' % (name.encode(), doubled), 1)
    elif change == 5 and rng.random() < 0.3:
        tree = {name: tree}
    elif isinstance(branch, list):
        branch[:] = rng.choice(
            [branch[:-1], branch + branch[-1:], [], [stranger, *branch], branch[::-1]]
        )
    return msgspec.json.encode(tree)


HOLDERS = (dict, list)
BY_BYTE: tuple[Mutation, ...] = (flip, delete, insert, duplicate, truncate, splice)
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
