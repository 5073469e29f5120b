"""How a run keeps time, as whoever starts it says."""

import msgspec


class Timing(msgspec.Struct, frozen=True, kw_only=True):
    """How a run keeps time, and how long it waits."""

    realtime: float | None = None
    """Simulated seconds per second of wall time; None: lockstep, as fast as the vehicles answer."""
    deadline: float = 10.0
    """In lockstep, how long to wait for the commands of one tick [s]."""
    join_timeout: float = 30.0
    """How long to wait for all vehicles at the start, for one that is to come back, and for the router [s]."""
    respawn: bool = False
    """In lockstep, whether the clock stands still for a vehicle that was lost."""
