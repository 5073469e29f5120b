"""The radio from the UAVs' computers to the UGVs of one world, and the ground as each UGV knows it by it."""

from typing import Any

import msgspec

from agents.control.telling import GroundTeller
from agents.estimation.estimator import estimator_of
from bus.messages import (
    GroundBlock,
    LinkKind,
    RelativeInformation,
    UgvObservation,
)
from bus.ticks import looks_of, radio_ticks


class Radio:
    """Each UAV radios what its filter and its sensor know, whoever flies it.

    Args:
        env: With an episode that has just begun; it is read at each tick.
    """

    def __init__(self, env: Any) -> None:  # noqa: ANN401 - PettingZoo has no types
        self._env, self._dt, self._tick = env, env.scenario.dt, -1
        self._rows = {name: k for k, name in enumerate(env.possible_agents)}
        told = {uav.name: env.briefing(uav.name) for uav in env.scenario.uav}
        self._filters = {uav: estimator_of(one) for uav, one in told.items()}
        self._escorts = {uav.name: uav.escorts for uav in env.scenario.uav}
        links = env.world.links
        self._links = {uav: links.row(LinkKind.RADIO, uav) for uav in self._escorts}
        self._tellers = {uav: GroundTeller(one) for uav, one in told.items()}
        self._said: dict[str, tuple[RelativeInformation | GroundBlock, ...]] = {}
        self._arrived: dict[str, tuple[RelativeInformation | GroundBlock, ...]] = {}

    def received_by(self, ugv: str, perceived: UgvObservation) -> UgvObservation:
        """The observation of a UGV at this tick, with the messages that have reached it."""
        self.receive()
        received = self._arrived.get(ugv, ())
        return msgspec.structs.replace(
            perceived,
            radio=tuple(one for one in received if isinstance(one, RelativeInformation)),
            blocks=self.blocks(ugv),
        )

    def blocks(self, ugv: str) -> tuple[GroundBlock, ...]:
        """The blocks of tiles that have reached a UGV at this tick."""
        return tuple(one for one in self._arrived.get(ugv, ()) if isinstance(one, GroundBlock))

    def receive(self) -> None:
        """Go on to the world's tick, if that is yet to be done."""
        while self._tick < self._env.world.tick:
            self._go_on()

    def _go_on(self) -> None:
        self._tick += 1
        self._arrived = {}
        links = self._env.world.links
        for uav, row in self._links.items():
            for message in self._said.pop(uav, ()):
                links.send_object(row, self._tick, message, self._tick - 1)
            ugv = self._escorts[uav]
            self._arrived[ugv] = self._arrived.get(ugv, ()) + tuple(links.arrivals(row, self._tick))
        if self._tick == self._env.world.tick:
            for ugv in self._arrived:
                for block in self.blocks(ugv):
                    self._env.world.receive_block(self._rows[ugv], block)
            for uav in self._filters:
                self._speak(uav)

    def _speak(self, uav: str) -> None:
        world = self._env.world
        p_x, p_y = world.reference_position[self._rows[uav]].tolist()
        estimate = self._filters[uav].update(
            tick=self._tick,
            own_position=(p_x, p_y),
            looks=looks_of(self._env.received(uav), self._dt),
        )
        self._tellers[uav].note(self._env.ground(uav))
        if estimate is None:
            return
        if self._tick % radio_ticks(self._dt) == 0:
            (g_x, g_y), no_error = estimate.position, 0.0  # drivers make nothing of the error
            relative = RelativeInformation(
                time=self._tick * self._dt,
                relative_position=(p_x - g_x, p_y - g_y),
                coverage_error=no_error,
            )
            self._said[uav] = (relative,)
        blocks = self._tellers[uav].blocks(self._tick, estimate.position)
        self._said[uav] = (*self._said.get(uav, ()), *blocks)
