"""The paper's pilots as policies for the environment: the baseline for whoever trains."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt

from agents.control.orbit import Path as VirtualPath
from agents.control.weighting import Weighting
from agents.uav import UavPilot
from bus.observations import uav_observation, ugv_observation
from bus.registry import DRIVERS
from outrider.envs.escort_env import EscortEnv
from outrider.envs.radio import Radio
from outrider.running.flying import make_pilots
from sim.kernels.compile import FloatArray

AgentPolicy = Callable[[npt.NDArray[Any] | Mapping[str, npt.NDArray[Any]]], FloatArray]
"""A vehicle's observation in, its acceleration [m/s²] out."""


class _EnvPilots:
    """The pilots of one environment, new ones for each episode."""

    def __init__(self, env: Any, weighting: Weighting | None, path: VirtualPath | None) -> None:  # noqa: ANN401
        self._env = env.unwrapped
        self._weighting, self._path = weighting, path
        self._begin()

    def _begin(self) -> None:
        env = self._env
        self._episode: int = env.episode
        receives = any(DRIVERS[ugv.driver].listens for ugv in env.scenario.ugv)
        self._radio: Radio | None = None
        if isinstance(env, EscortEnv) and env.episode and env.scenario.has_ground:
            self._radio = env.radio
        elif receives and env.episode:
            self._radio = Radio(env)
        self._pilots = make_pilots(
            env.scenario,
            env.episode_seed,
            secret=env.secret,
            weighting=self._weighting,
            path=self._path,
        )

    def act(
        self,
        name: str,
        observation: npt.NDArray[Any] | Mapping[str, npt.NDArray[Any]],
    ) -> FloatArray:
        if self._episode != self._env.episode:
            self._begin()
        row = observation["row"] if isinstance(observation, Mapping) else observation
        pilot, dt = self._pilots[name], self._env.scenario.dt
        if isinstance(pilot, UavPilot):
            seen = uav_observation(row, dt=dt)
            if self._env.degraded:  # several may have come at once, and the row has room for one
                seen = msgspec.structs.replace(seen, detections=self._env.received(name))
            ground, flown = self._env.ground(name), self._env.flown(name)
            command = pilot.act(msgspec.structs.replace(seen, ground=ground, flown=flown))
            self._env.carry(name, command.motions)
            return np.array(command.acceleration)
        perceived = ugv_observation(row, dt=dt)
        perceived = msgspec.structs.replace(
            perceived, ground=self._env.ground(name), flown=self._env.flown(name)
        )
        if self._radio is not None:
            perceived = self._radio.received_by(name, perceived)
        answer = pilot.act(perceived)
        self._env.carry(name, answer.motions)
        self._env.claim(name, answer.report)
        if answer.route is not None:
            self._env.show_route(name, answer.route)
        return np.array(answer.acceleration)


def pilots(
    env: Any,  # noqa: ANN401
    *,
    weighting: Weighting | None = None,
    path: VirtualPath | None = None,
) -> dict[str, AgentPolicy]:
    """A policy for each agent of the environment: the scenario's law for a UAV, its driver for a UGV.

    Each knows what it would know over the bus: its briefing, and then the rows of its own observations. They have a
    memory, so call each once a tick; with a new episode they begin anew by themselves. With float64 rows they fly the
    same bits as `outrider.run` with the same scenario and seed.

    Args:
        env: The environment, or a wrapper of it.
        weighting: For the law `weighted`, instead of the scenario's.
        path: For the law `path`, instead of the scenario's.

    Raises:
        ScenarioError: If the scenario asks for a law or a driver that cannot be had.
    """
    flown = _EnvPilots(env, weighting, path)
    return {name: partial(flown.act, name) for name in env.possible_agents}
