"""Run in one process in which pilots die and rejoin, as the processes of vehicles do over the bus."""

from collections.abc import Callable, Mapping

from bus.messages.vehicle import Command
from outrider.running.flying import InProcess, make_pilots
from sim.server.flight import Flight


class MortalPilots(InProcess):
    """Pilots that die and rejoin.

    A new pilot knows its past only, as over the bus: the observations that were sent, and its stored number.

    Args:
        flight: Run of the pilots.
        dies: Called in each tick; returns the ticks of absence of each vehicle whose pilot dies in it.
    """

    def __init__(self, flight: Flight, dies: Callable[[int], Mapping[str, int]]) -> None:
        self.flight, self._dies = flight, dies
        self.pilots = make_pilots(flight.scenario, flight.seed)
        """Pilots that are alive, and those that died last; a pilot may be replaced before the run."""
        self._missed: dict[str, list[int]] = {}
        self._returns: dict[str, int] = {}  # first tick of the new pilot
        self.deaths = 0
        """Pilots that have died."""
        super().__init__(self.pilots)

    def away(self, name: str) -> bool:
        """Return whether a vehicle has no pilot now."""
        return name in self._returns

    def kill(self, name: str, tick: int, absent: int) -> None:
        """End a pilot before its answer to this tick; the next one answers `absent` ticks later."""
        if name in self._returns:
            return
        self._returns[name], self.deaths = tick + absent, self.deaths + 1
        self._missed.setdefault(name, []).append(tick)

    def collect(self, tick: int) -> dict[str, Command]:
        """Call every pilot that is alive and return the commands."""
        for name, back in list(self._returns.items()):
            if tick >= back:
                self._rejoin(name, tick)
            else:
                self._missed[name].append(tick)
        for name, absent in self._dies(tick).items():
            self.kill(name, tick, absent)
        self._pilots = {name: one for name, one in self.pilots.items() if name not in self._returns}
        return super().collect(tick)

    def _rejoin(self, name: str, tick: int) -> None:
        """Replace a dead pilot, and send the past to the new one."""
        del self._returns[name]
        self.flight.rejoin(name)
        made = make_pilots(self.flight.scenario, self.flight.seed)[name]
        for observation in self.flight.past(name, 0, tick, self._missed[name]):
            made.act(observation)  # type: ignore[arg-type]  # of its own kind
        made.forget_commands()
        self.pilots[name] = made
