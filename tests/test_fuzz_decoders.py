"""Every decoder on invalid payloads: it returns a message within its bounds, or raises one of three errors.

The payloads come from hypothesis and from mutations of real messages; the seeds of the mutations are fixed, so every
run checks the same payloads.
"""

import json
import math
import random
from dataclasses import dataclass, field
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import inspect as kinds

from bus.keys import KEYS, Key
from mutations import REFUSALS, allowed, matches, mutated, real_messages
from properties import PROPERTY

EVERY_ROW = pytest.mark.parametrize("key", KEYS, ids=lambda key: key.message.__name__)
MUTATIONS_PER_ROW = math.ceil(110_000 / len(KEYS))
EXAMPLES_PER_ROW = 100


@dataclass
class Tally:
    """The decoder of a key, and the counts of its results."""

    key: Key
    accepted: int = 0
    refused: int = 0
    seen: set[int] = field(default_factory=set)

    def __post_init__(self) -> None:
        self._decoder = msgspec.json.Decoder(self.key.message)
        self._kind = kinds.type_info(self.key.message)

    def offer(self, payload: bytes) -> None:
        """Decode like an inbox.

        The message must equal the payload, be within its bounds, and survive encoding.
        """
        self.seen.add(hash(payload))
        try:
            message = self._decoder.decode(payload)
        except REFUSALS:
            self.refused += 1
            return
        self.accepted += 1
        assert allowed(message, self._kind), payload
        assert matches(message, json.loads(payload)), payload
        assert self._decoder.decode(msgspec.json.encode(message)) == message, payload


@EVERY_ROW
def test_mutated_message_decodes_within_bounds_or_is_refused(key: Key) -> None:
    tally, rng = Tally(key), random.Random(11)
    for _ in range(MUTATIONS_PER_ROW):
        tally.offer(mutated(key, rng))
    assert tally.accepted + tally.refused == MUTATIONS_PER_ROW
    assert MUTATIONS_PER_ROW * len(KEYS) >= 100_000
    assert tally.accepted > 0.05 * MUTATIONS_PER_ROW
    assert tally.refused > 0.4 * MUTATIONS_PER_ROW
    assert len(tally.seen) > 0.5 * MUTATIONS_PER_ROW


SCALARS = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=8)
    | st.sampled_from([1e308, -1, 2**53 + 1, 1e6])
)
VALUES = st.recursive(
    SCALARS,
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner, max_size=3)
    ),
)


def as_json(value: Any) -> bytes:
    """Return JSON as written by Python, including NaN and infinity."""
    return json.dumps(value).encode()


def garbage(key: Key) -> st.SearchStrategy[bytes]:
    """Draw bytes, text, JSON, and objects with the field names of the message and any values."""
    names = [part.encode_name for part in kinds.type_info(key.message).fields]
    own = st.fixed_dictionaries({}, optional=dict.fromkeys(names, VALUES)) | st.fixed_dictionaries(
        dict.fromkeys(names, SCALARS)
    )
    return st.one_of(
        st.binary(max_size=40),
        st.text(max_size=40).map(str.encode),
        VALUES.map(as_json),
        own.map(as_json),
        st.sampled_from(real_messages(key)),
    )


@EVERY_ROW
def test_garbage_decodes_within_bounds_or_is_refused(key: Key) -> None:
    tally = Tally(key)

    @settings(PROPERTY, max_examples=EXAMPLES_PER_ROW)
    @given(garbage(key))
    def offer(payload: bytes) -> None:
        tally.offer(payload)

    offer()
    assert tally.accepted > 0.02 * EXAMPLES_PER_ROW
    assert tally.refused > 0.5 * EXAMPLES_PER_ROW
    assert len(tally.seen) > 0.5 * EXAMPLES_PER_ROW
