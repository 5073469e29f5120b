"""Tries at the token: one at a time from each address, and slower with each that is wrong."""

import asyncio
import hashlib
import hmac
import ipaddress
import time
from collections import OrderedDict
from collections.abc import Awaitable, Callable
from enum import Enum

_FIRST_WAIT = 0.5
"""Wall time after the first wrong token until the next is looked at [s]; it doubles with each."""
_LONGEST_WAIT = 10.0
"""The most that it grows to [s]."""
_WAITING = 4
"""So many tries of one address may wait; further ones are turned away unseen."""
_ADDRESSES = 256
"""So many addresses are remembered, the latest."""
_NETWORK = 64
"""Bits of an IPv6 address that tell its owner, who has all that begin with them."""


class Judgement(Enum):
    """The outcome of a try."""

    RIGHT = "right"
    WRONG = "wrong"
    BUSY = "busy"


class _Address:
    """The tries of one address."""

    def __init__(self) -> None:
        self.lock = asyncio.Lock()
        self.wrong = self.waiting = 0
        self.next = 0.0
        """Time at which the next try may be looked at, on the clock."""


class Attempts:
    """Judges tokens. The right one is slowed like a wrong one: else it would tell itself by its speed.

    Args:
        token: The right one.
        clock: Time in s, for tests.
        sleep: Waits so many s, for tests.
    """

    def __init__(
        self,
        token: str,
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
    ) -> None:
        self._digest = _digest(token)
        self._clock, self._sleep = clock, sleep
        self._addresses: OrderedDict[str, _Address] = OrderedDict()

    async def judge(self, address: str, given: str) -> tuple[Judgement, float]:
        """Compare in constant time, once it is this address's turn.

        Returns:
            The verdict, and how long the next try of this address would wait [s].
        """
        row = self._row(_owner(address))
        if row is None or row.waiting >= _WAITING:
            return Judgement.BUSY, _LONGEST_WAIT if row is None else self._wait(row)
        row.waiting += 1
        try:
            async with row.lock:
                if (wait := self._wait(row)) > 0.0:
                    await self._sleep(wait)
                if hmac.compare_digest(_digest(given), self._digest):
                    row.wrong, row.next = 0, 0.0
                    return Judgement.RIGHT, 0.0
                row.wrong += 1
                wait = min(_FIRST_WAIT * 2.0 ** min(row.wrong - 1, 16), _LONGEST_WAIT)
                row.next = self._clock() + wait
                return Judgement.WRONG, wait
        finally:
            row.waiting -= 1

    def _wait(self, row: _Address) -> float:
        return max(0.0, row.next - self._clock())

    def _row(self, owner: str) -> _Address | None:
        """The tries of an address; None where there is no room for another.

        Each that is known has a try that waits.
        """
        row = self._addresses.get(owner)
        if row is None:
            if len(self._addresses) >= _ADDRESSES:
                idle = next(
                    (name for name, old in self._addresses.items() if not old.waiting), None
                )
                if idle is None:
                    return None
                del self._addresses[idle]
            row = self._addresses[owner] = _Address()
        self._addresses.move_to_end(owner)
        return row


def _digest(token: str) -> bytes:
    """Of one length, so that a comparison does not tell the token's."""
    return hashlib.sha256(token.encode("utf-8", "replace")).digest()


def _owner(address: str) -> str:
    """An IPv4 address, or the network of an IPv6 address."""
    try:
        parsed = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address
    if parsed.version == 6 and parsed.ipv4_mapped is not None:
        return str(parsed.ipv4_mapped)
    if parsed.version == 6:
        return str(ipaddress.ip_network((parsed, _NETWORK), strict=False))
    return str(parsed)
