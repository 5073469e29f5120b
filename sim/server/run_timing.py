"""The timing of a run, as it is asked for."""

import msgspec


class Timing(msgspec.Struct, frozen=True, kw_only=True):
    """Pace and patience of a run."""

    realtime: float | None = None
    """Simulated seconds per second of wall time; None: lockstep, as fast as the vehicles answer."""
    deadline: float = 10.0
    """In lockstep, time to wait for the commands of one tick [s]."""
    join_timeout: float = 30.0
    """Time to wait for all vehicles at the start, for one that is to come back, and for the router [s]."""
    respawn: bool = False
    """True: in lockstep the clock stands still for a vehicle that was lost."""
