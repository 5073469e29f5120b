"""Policies that control the other vehicles of an environment, loaded by name."""

import inspect
from collections.abc import Collection, Iterable, Mapping
from copy import deepcopy
from typing import Any

import numpy as np

from agents.drivers.policy import RowPolicy
from bus.errors import ScenarioError
from bus.observations import UGV, names
from outrider.closed_loop.pilots import pilot_names
from outrider.running.user_code import load_policy
from sim.compiling.compile import FloatArray
from sim.env.observation import AgentObservation, one_of_world
from sim.env.settings import BY_AGENT, Settings
from sim.scenario.types import Scenario

_TIME = names(UGV).index("time")


class RowPolicyOfWorlds:
    """Row policy of a UGV in all worlds; each world has its own state.

    Args:
        model: Policy of one UGV.
    """

    def __init__(self, model: RowPolicy) -> None:
        self._model = model
        parameters = inspect.signature(model.predict).parameters
        self._known = {"deterministic", "state", "episode_start"} & parameters.keys()
        self._states: list[object] = []

    def __call__(self, observation: AgentObservation) -> FloatArray:
        """Return the accelerations [m/s²] of all worlds. Shape (worlds, 2)."""
        row = observation["row"] if isinstance(observation, dict) else observation
        if len(self._states) != len(row):
            self._states = [None] * len(row)
        return np.array([self._act(observation, k, row[k, _TIME] == 0.0) for k in range(len(row))])

    def _act(self, observation: AgentObservation, world: int, starts: bool) -> Any:  # noqa: ANN401 - the environment checks it
        if starts:
            self._states[world] = None
        given: dict[str, Any] = {
            "deterministic": True,
            "state": self._states[world],
            "episode_start": np.array([starts]),
        }
        answer = self._model.predict(
            one_of_world(observation, world), **{name: given[name] for name in self._known}
        )
        if isinstance(answer, tuple) and np.ndim(answer[0]) > 0:
            answer, self._states[world] = answer
        return answer


def named_policies(others: Mapping[str, Any], scenario: Scenario) -> dict[str, Any]:
    """Return the pilots of the other vehicles, with policies in place of their names.

    A name with a colon is a policy, such as `npz:FILE.npz` or `policy:module:function`, as in `outrider.load_policy`.

    Args:
        others: Pilots by vehicle.
        scenario: Scenario of the environment.

    Raises:
        ScenarioError: If a policy cannot be loaded, or drives one world only.
    """
    uavs = {uav.name for uav in scenario.uav}
    return {
        name: _loaded(name, pilot, is_uav=name in uavs)
        if isinstance(pilot, str) and ":" in pilot
        else pilot
        for name, pilot in others.items()
    }


def check_others(given: Mapping[str, Any], scenario: Scenario, learners: Collection[str]) -> None:
    """Check the pilots of the vehicles that do not learn.

    Args:
        given: Names or policies by vehicle.
        scenario: Scenario of the environment.
        learners: Vehicles with external actions.

    Raises:
        ValueError: If a vehicle or a pilot is not allowed.
    """
    names = [vehicle.name for vehicle in scenario.vehicles]
    for name, pilot in given.items():
        if name not in names:
            raise ValueError(f"others: {name!r}: no such vehicle; allowed: {', '.join(names)}")
        if name in learners:
            raise ValueError(f"others: {name!r}: its actions are external; allowed: other vehicles")
        known = pilot_names(scenario, name)
        if isinstance(pilot, str) and pilot not in known:
            raise ValueError(
                f"others: {name!r}: {pilot!r}: unknown; allowed: {', '.join(known)}, or a policy"
            )
        if not isinstance(pilot, str) and not callable(pilot):
            raise ValueError(f"others: {name!r}: {pilot!r}: neither a name nor a policy")
        if hasattr(pilot, "check"):  # policies of outrider_learning check the scenario
            pilot.check(scenario)


def observed_by(
    policies: Mapping[str, Any], settings: Settings, vehicles: Iterable[str]
) -> dict[str, dict[str, Any]]:
    """Return the settings of the observations by vehicle, if a policy has a `setup` that differs from the settings.

    Args:
        policies: Policies by vehicle.
        settings: Settings of the environment.
        vehicles: Names of all vehicles.
    """
    own = {name: settings.of_agent(name) for name in vehicles}
    setups = {name: getattr(policy, "setup", {}) for name, policy in policies.items()}
    return {
        key: {name: setups.get(name, {}).get(key, getattr(own[name], key)) for name in own}
        for key in BY_AGENT
        if any(
            setup.get(key, getattr(own[n], key)) != getattr(own[n], key)
            for n, setup in setups.items()
        )
    }


def _loaded(vehicle: str, named: str, *, is_uav: bool) -> Any:  # noqa: ANN401
    what = f"others: {vehicle}"
    found = load_policy(named.removeprefix("policy:"), "uav" if is_uav else "ugv", what=what)
    if is_uav:
        return deepcopy(found)  # a module's object may control several UAVs
    if not isinstance(found, RowPolicy):
        raise ScenarioError(
            f"{what} = {named!r}: a function of one UGV's observation; allowed: an object with a method predict"
        )
    return RowPolicyOfWorlds(found)
