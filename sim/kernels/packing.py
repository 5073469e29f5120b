"""Several numbers into an array at once, or out of it: together they take as long as one by its index."""

import struct
from collections.abc import Callable
from typing import Any

NUMBER = 8
"""Bytes of a number."""


def writer(count: int) -> Callable[..., None]:
    """A function of an array, a place in it [bytes], and so many numbers, which it writes there one after the other."""
    write: Callable[..., None] = struct.Struct(f"{count}d").pack_into
    return write


def packer(count: int) -> Callable[..., bytes]:
    """A function of so many numbers, which returns them as bytes."""
    return struct.Struct(f"{count}d").pack


def reader(count: int) -> Callable[..., tuple[Any, ...]]:
    """A function of an array and a place in it [bytes], which reads so many numbers from there on."""
    read: Callable[..., tuple[Any, ...]] = struct.Struct(f"{count}d").unpack_from
    return read
