"""The environment with the UAVs' computers on board: what they radio of the ground reaches the UGVs, whoever flies."""

import msgspec

from agents.drivers.compiled import take_ground, told_ground
from agents.drivers.tile_map import GroundMemory
from bus.messages import UgvObservation
from outrider.envs.radio import Radio
from sim.engine.briefing import ugv_briefing
from sim.env.parallel import OutriderEnv
from sim.models.ground import TileArray

_NOTHING = UgvObservation(tick=0, time=0.0, position=(0.0, 0.0), velocity=(0.0, 0.0))


class EscortEnv(OutriderEnv):
    """The environment with what the UAVs' computers radio of the ground, to whoever drives.

    All else, and without hazards all of it, is `sim.env.parallel.OutriderEnv`, whose arguments it takes.
    """

    def _perceive(self) -> None:
        if not self.scenario.has_ground:
            return
        if self.world.tick == 0:
            self.radio = Radio(self)
            """From the UAVs to the UGVs, of this episode."""
            self._known: dict[str, GroundMemory] = {
                ugv.name: told_ground(ugv_briefing(self.scenario, ugv.name, self.episode_seed))
                for ugv in self.scenario.ugv
            }
        self.radio.receive()
        for ugv, known in self._known.items():
            blocks, ground = self.radio.blocks(ugv), self.ground(ugv)
            if blocks or ground:
                seen = msgspec.structs.replace(_NOTHING, blocks=blocks, ground=ground)
                take_ground(known, seen)

    def known_tiles(self, ugv: str) -> TileArray:
        """The ground as a UGV knows it, from its bumper and by radio; a copy. Shape (rows, columns)."""
        return self._known[ugv].tiles.copy()


parallel_env = EscortEnv
"""The environment under PettingZoo's usual name."""
