"""Every decoder on invalid payloads: it returns a message within its bounds, or raises one of three errors.

The seeds of the mutations are fixed, so every run checks the same payloads.
"""

import math
import random
from typing import Any

import msgspec
import pytest

from bus.keys import KEYS, Key
from bus.messages.base import LONGEST_TEXT
from mutations import REFUSALS, mutated

MUTATIONS_PER_ROW = math.ceil(100_000 / len(KEYS))


def bounded(value: Any) -> bool:
    """Return whether all real numbers in a decoded message are finite and all its texts are short."""
    match value:
        case dict():
            return all(bounded(part) for item in value.items() for part in item)
        case list() | tuple():
            return all(map(bounded, value))
        case float():
            return abs(value) <= 1e12
        case str():
            return len(value) <= LONGEST_TEXT
    return True


@pytest.mark.parametrize("key", KEYS, ids=lambda key: key.message.__name__)
def test_mutated_message_decodes_within_bounds_or_is_refused(key: Key) -> None:
    decoder, rng = msgspec.json.Decoder(key.message), random.Random(11)
    payloads = [mutated(key, rng) for _ in range(MUTATIONS_PER_ROW)]
    refused = 0
    for payload in payloads:
        try:
            message = decoder.decode(payload)
        except REFUSALS:
            refused += 1
            continue
        plain = msgspec.to_builtins(message, builtin_types=(bytes,))
        assert bounded(plain), payload
        assert decoder.decode(msgspec.json.encode(message)) == message, payload
    assert 0.4 * MUTATIONS_PER_ROW < refused < 0.95 * MUTATIONS_PER_ROW
    assert len(set(payloads)) > 0.5 * MUTATIONS_PER_ROW
