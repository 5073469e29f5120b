"""Paper's pilots as policies for the environment, as a baseline for training."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy.typing as npt

from agents.control.orbit import Path as VirtualPath
from agents.control.weighting import Weighting
from agents.estimation.map_updates import BLOCK_TILES, decode_tile
from agents.uav import UavPilot
from bus.errors import ScenarioError
from bus.messages.ground import BLOCK_SIDE, TILE_LETTERS, MapUpdate
from bus.messages.links import LinkKind
from bus.messages.vehicle import (
    RelativeInformation,
    UavCommand,
    UavObservation,
    UgvCommand,
    UgvObservation,
)
from outrider.running.flying import make_pilots
from sim.channel.link_records import ARRIVED
from sim.world import World

AgentPolicy = Callable[[npt.NDArray[Any] | Mapping[str, npt.NDArray[Any]]], UavCommand | UgvCommand]
"""Function that maps a vehicle's observation to its pilot's command, a valid action of the environment."""


def _radioed(
    world: World,
    batch: Any,  # noqa: ANN401 - PettingZoo has no types
    uavs: tuple[str, ...],
) -> tuple[tuple[RelativeInformation, ...], tuple[MapUpdate, ...]]:
    """Return the messages delivered in this tick by the radios of these UAVs."""
    radio, blocks, dt = list[RelativeInformation](), list[MapUpdate](), world.parameters.dt
    across = 0 if world.ground is None else -(-world.tiles.shape[1] // BLOCK_SIDE)
    for uav in uavs:
        row = batch.links.row(LinkKind.RADIO, uav)
        for packet in batch.state.packets[0, row, ARRIVED, : batch.state.links[0, row]["arrived"]]:
            block = int(packet["block"])
            if block < 0:
                position = (float(packet["vector"][0]), float(packet["vector"][1]))
                time = float(packet["stamp"]) * dt
                # drivers ignore the coverage error
                message = RelativeInformation(
                    time=time, relative_position=position, coverage_error=0.0
                )
                radio.append(message)
            else:
                states = (decode_tile(packet["tiles"], n) for n in range(BLOCK_TILES))
                tiles = "".join(TILE_LETTERS[state] for state in states)
                blocks.append(MapUpdate(row=block // across, column=block % across, tiles=tiles))
    return tuple(radio), tuple(blocks)


class _EnvPilots:
    """Pilots of one environment, recreated for each episode."""

    def __init__(self, env: Any, weighting: Weighting | None, path: VirtualPath | None) -> None:  # noqa: ANN401
        self._env = env.unwrapped
        self._weighting, self._path = weighting, path
        self._escorts = {
            ugv.name: tuple(uav.name for uav in self._env.scenario.uav if uav.escorts == ugv.name)
            for ugv in self._env.scenario.ugv
        }
        self._begin()

    def _begin(self) -> None:
        env = self._env
        self._episode: int = env.episode
        self._pilots = make_pilots(
            env.worlds.loop.scenario_of(0),
            env.episode_seed,
            secret=env.secret,
            weighting=self._weighting,
            path=self._path,
        )

    def act(
        self,
        name: str,
        _observation: npt.NDArray[Any] | Mapping[str, npt.NDArray[Any]],
    ) -> UavCommand | UgvCommand:
        if self._episode != self._env.episode:
            self._begin()
        world, pilot = self._env.world, self._pilots[name]
        row, tick = world.names.index(name), world.tick
        position = tuple(world.reference_position[row].tolist())
        velocity = tuple(world.reference_velocity[row].tolist())
        fields: dict[str, Any] = {"tick": tick, "time": world.time}
        fields |= {"position": position, "velocity": velocity}
        fields |= {"tile_reports": world.seen_ground(row), "committed_trajectory": world.flown(row)}
        if isinstance(pilot, UavPilot):
            vertical = world.vertical[row]
            if vertical["flies"]:
                fields |= {
                    "altitude": float(vertical["altitude"]),
                    "climb_rate": float(vertical["rate"]),
                }
            uav = [uav.name for uav in world.uavs].index(name)
            fields |= {"detections": world.received(uav), "buildings": world.discovered(uav)}
            return pilot.act(UavObservation(**fields))
        radio, blocks = _radioed(world, self._env.worlds.loop.batch, self._escorts[name])
        heading = world.heading(row)
        return pilot.act(UgvObservation(**fields, heading=heading, radio=radio, map_updates=blocks))


def pilots(
    env: Any,  # noqa: ANN401
    *,
    weighting: Weighting | None = None,
    path: VirtualPath | None = None,
) -> dict[str, AgentPolicy]:
    """Return a policy for each agent: the scenario's law for a UAV, its driver for a UGV.

    Each policy has the information that its pilot would have over the bus: its briefing, and the data of its own
    sensors and links, whatever the observation contains. Policies have memory, so call each once per tick; they reset
    with each new episode. They fly the same bits as `outrider.run` with the same scenario and seed if no UGV uses the
    UAVs' radio; otherwise they agree to rounding. Each pilot is briefed as in that run: among buildings, the UAVs' own
    certificates rely on the policies of all UGVs being in use.

    Args:
        env: Environment, or a wrapper of it.
        weighting: Weighting for the law `weighted`, instead of the scenario's.
        path: Path for the law `path`, instead of the scenario's.

    Raises:
        ScenarioError: If a law or a driver of the scenario is not available, or the scenario has a team: the
            environment itself applies its rules.
    """
    if env.unwrapped.scenario.team is not None:
        raise ScenarioError(
            "team: in an environment the rules of the team act on the actions of its UAVs; allowed: the laws of "
            "the UAVs in `others`, as in outrider.vector_env, or outrider.run"
        )
    committed = _EnvPilots(env, weighting, path)
    return {name: partial(committed.act, name) for name in env.possible_agents}
