"""Messages between the UAVs of each team, their stored numbers and their charge.

The simulator stores a UAV's number before it sends a message that names it, as the proof of docs/explanation/proof.md
assumes (T1, T2). It returns the number in each observation: it survives the UAV's process.
"""

import bisect
import math

import msgspec

from bus.messages.links import LinkKind
from bus.messages.team import MOST_UAVS, TeamMessage
from bus.messages.vehicle import UavCommand
from bus.ticks import team_ticks
from sim.models.endurance import RESERVE, EnduranceParameters, next_charge, return_time
from sim.models.vehicles import State
from sim.scenario.team import endurance_of, mates_of
from sim.world import World


class TeamRadio:
    """Stored numbers, charge and messages of all teams.

    Args:
        world: World whose links carry the messages.
    """

    def __init__(self, world: World) -> None:
        names = [uav.name for uav in world.uavs]
        self._world = world
        self._mates = {name: mates_of(world.scenario, name) for name in names}
        self._rows = {
            name: world.links.row(LinkKind.TEAM, name) for name in names if self._mates[name]
        }
        self._period = team_ticks(world.parameters.dt)
        self._last = dict.fromkeys(names, -self._period)
        self._stored: dict[str, list[tuple[int, int]]] = {name: [(-1, 0)] for name in names}
        self._arrived: tuple[int, dict[str, list[TeamMessage]]] = (-1, {})
        self.refused = dict.fromkeys(names, 0)
        """Messages of each UAV that were not sent: wrong sender, tick, number, rate, measurement or request."""
        self._endurances = {
            uav.name: EnduranceParameters(one.endurance, one.charge_time, *one.base)
            for uav in world.uavs
            if (one := endurance_of(uav)) is not None
        }
        self._charges = {name: [one.endurance] for name, one in self._endurances.items()}
        self.octets = dict.fromkeys(names, 0)
        """Size of the messages that each UAV has sent, as JSON [bytes]."""

    def number(self, uav: str, tick: int | None = None) -> int:
        """Return the stored number of a UAV, as in its observation of a tick; None: now."""
        changes = self._stored[uav]
        if tick is None:
            return changes[-1][1]
        return changes[bisect.bisect_left(changes, (tick, 0)) - 1][1]

    def charge(self, uav: str, tick: int | None = None) -> float | None:
        """Return the flight time that a UAV has left at a tick [s]; None: unlimited. Without a tick: now."""
        charges = self._charges.get(uav)
        return None if charges is None else charges[-1 if tick is None else tick]

    def needed_charge(self, uav: str) -> float:
        """Return the flight time that a UAV needs to reach its base with the reserve [s]."""
        world, one = self._world, self._endurances[uav]
        vehicle = world.vehicles[world.names.index(uav)]
        x, y = vehicle["reference_position"].tolist()
        bounds = float(vehicle["max_speed"]), float(vehicle["max_acceleration"])
        return RESERVE + return_time(math.hypot(x - one.base_x, y - one.base_y), *bounds)

    def use_charge(self) -> None:
        """Advance the charge of every UAV with an endurance, after the world has advanced."""
        world = self._world
        for name, parameters in self._endurances.items():
            one = world.vehicles[world.names.index(name)]
            state = State(*one["reference_position"].tolist(), *one["reference_velocity"].tolist())
            charges = self._charges[name]
            charges.append(next_charge(parameters, charges[-1], state, world.parameters.dt))

    def send(self, name: str, command: UavCommand) -> None:
        """Store the number of a UAV's command, then send its message; it arrives at the next tick at the earliest."""
        mates, tick = self._mates[name], self._world.tick
        if not mates:
            return
        if command.number > self.number(name):
            if command.number % MOST_UAVS == MOST_UAVS - 1 - mates.index(name):
                self._stored[name].append((tick, command.number))
            else:
                self.refused[name] += 1
                return
        message = command.team
        if message is None:
            return
        if not self._is_valid(name, command.tick, message):
            self.refused[name] += 1
            return
        self._last[name] = command.tick
        self.octets[name] += len(msgspec.json.encode(message))
        links = self._world.links
        links.send_object(self._rows[name], tick + 1, message, command.tick)

    def _is_valid(self, name: str, tick: int, message: TeamMessage) -> bool:
        """Return whether a UAV's message of a tick may be sent: its receivers rely on what is checked here."""
        mates = self._mates[name]
        return (
            message.sender == name
            and len(mates) > 1
            and message.tick == tick >= self._last[name] + self._period
            and message.number <= self.number(name)
            and (message.measured is None or message.measured <= tick)
            and (message.asks is None or message.asks in mates)
        )

    def received(self, name: str, tick: int) -> tuple[TeamMessage, ...]:
        """Return the messages of a UAV's team-mates that arrive at this tick."""
        if not self._mates[name]:
            return ()
        if self._arrived[0] != tick:
            links = self._world.links
            arrived = {one: links.arrivals(row, tick) for one, row in self._rows.items()}
            self._arrived = tick, arrived
        others = (mate for mate in self._mates[name] if mate != name)
        return tuple(message for mate in others for message in self._arrived[1][mate])
