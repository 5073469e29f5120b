"""A clock for the tests of what waits."""

import asyncio


class Clock:
    """Time that passes where somebody waits, or when it is told to."""

    def __init__(self) -> None:
        self.now, self.waits = 0.0, list[float]()
        self.asleep = self.most = 0

    def __call__(self) -> float:
        return self.now

    async def sleep(self, seconds: float) -> None:
        self.asleep += 1
        self.most = max(self.most, self.asleep)
        await asyncio.sleep(0)
        self.waits.append(seconds)
        self.now += seconds
        self.asleep -= 1
