"""Radio messages of UAVs: the simulator sends only messages that it can verify."""

import msgspec

from bus.messages.ground import TILE_LETTERS, MapUpdate
from bus.messages.links import LinkKind
from bus.messages.vehicle import RelativeInformation, UavCommand
from bus.ticks import radio_ticks, tick_of
from sim.models.ground import UNSEEN
from sim.world import World


class Radio:
    """Sender of the UAVs' radio messages over their links.

    A radio message must carry no more information than its fields define: nothing hidden in a time stamp or in tile
    states, and at most one message per period.

    Args:
        world: World whose links carry the messages.
    """

    def __init__(self, world: World) -> None:
        names = [uav.name for uav in world.uavs]
        self._world = world
        self._period = radio_ticks(world.parameters.dt)
        self._last: dict[str, int | None] = dict.fromkeys(names)
        self.refused: dict[str, int] = dict.fromkeys(names, 0)
        """Messages of each UAV that were not sent: wrong tick, too early after the last one, or tile states that its
        sensor has not reported.
        """

    def send(self, vehicle: int, command: UavCommand) -> None:
        """Send the radio messages of a UAV's command; they arrive at the next tick at the earliest.

        Args:
            vehicle: Row of the UAV among the vehicles.
            command: Its command.
        """
        name = self._world.names[vehicle]
        for message in command.radio:
            self._send(name, self._stamped(name, command.tick, message))
        for block in command.map_updates:
            self._send(name, self._reported(vehicle, block))

    def _send(self, uav: str, message: RelativeInformation | MapUpdate | None) -> None:
        if message is None:
            self.refused[uav] += 1
        else:
            tick, links = self._world.tick, self._world.links
            links.send_object(links.row(LinkKind.RADIO, uav), tick + 1, message, tick)

    def _stamped(
        self, uav: str, tick: int, message: RelativeInformation
    ) -> RelativeInformation | None:
        """Return a message with the exact time of the tick that its command answers.

        None: it belongs to another tick, or is too early after the last one.
        """
        dt, last = self._world.parameters.dt, self._last[uav]
        time = tick * dt
        if message.time != time or not tick:  # the sign of a zero could carry information
            if tick_of(message.time, dt) != tick:
                return None
            message = msgspec.structs.replace(message, time=time)
        if last is not None and tick < last + self._period:
            return None
        self._last[uav] = tick
        return message

    def _reported(self, vehicle: int, block: MapUpdate) -> MapUpdate | None:
        """Return a map update with all that the UAV's own sensor has reported of its tiles.

        None: it contradicts the reports, or none of its tiles is known.
        """
        if self._world.ground is None:
            return None
        unseen = TILE_LETTERS[UNSEEN]
        known = self._world.known_block(vehicle, block.row, block.column)
        matches = all(sent in (unseen, true) for sent, true in zip(block.tiles, known, strict=True))
        return (
            msgspec.structs.replace(block, tiles=known) if matches and known.strip(unseen) else None
        )
