"""A run in this process: the same world, pilots and loop as over the bus, without a bus."""

import copy
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from agents.control.orbit import Path as VirtualPath
from agents.control.weighting import Weighting
from agents.process import Pilot
from agents.uav import UavPilot
from agents.ugv import UgvPilot
from bus.messages.vehicle import Command, Observation, UavBriefing
from outrider.running.summary import Summary, summarize
from outrider.running.user_code import check_code, load_function
from sim.engine.briefing import briefing
from sim.engine.run_keys import check_secret
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario
from sim.server.flight import Flight


def make_pilots(
    scenario: Scenario,
    seed: int,
    *,
    secret: str = "",
    weighting: Weighting | None = None,
    path: VirtualPath | None = None,
) -> dict[str, UavPilot | UgvPilot]:
    """The scenario's pilots, briefed as they would be over the bus.

    Args:
        scenario: What is flown.
        seed, secret: Of the run.
        weighting: Instead of the scenario's `custom.weighting`.
        path: Instead of the scenario's `custom.path`.
    """
    weighting = weighting or load_function(scenario.custom.weighting, what="custom.weighting")
    path = path or load_function(scenario.custom.path, what="custom.path")
    policy = load_function(scenario.custom.policy, what="custom.policy")
    own = load_function(scenario.custom.uav_policy, what="custom.uav_policy")
    pilots: dict[str, UavPilot | UgvPilot] = {}
    for vehicle in scenario.vehicles:
        told = briefing(scenario, vehicle.name, seed, secret)
        if isinstance(told, UavBriefing):
            pilots[vehicle.name] = UavPilot(
                told,
                weighting=weighting,
                path=path,
                policy=copy.deepcopy(own),  # it remembers a flight
                policy_name=scenario.custom.uav_policy,
            )
        else:
            pilots[vehicle.name] = UgvPilot(told, policy=policy, policy_name=scenario.custom.policy)
    return pilots


class InProcess:
    """The exchange without a bus: each pilot is called with its observation."""

    def __init__(self, pilots: Mapping[str, Pilot]) -> None:
        self._pilots = pilots
        self._observations: Mapping[str, Observation] = {}

    def begin(self, tick: int) -> None:
        """Nobody operates a run in one process."""

    def publish(self, observations: Mapping[str, Observation]) -> None:
        """Keep the observations for the pilots."""
        self._observations = observations

    def collect(self, tick: int) -> dict[str, Command]:
        """Let every pilot answer."""
        commands: dict[str, Command] = {}
        observations = self._observations
        for name, pilot in self._pilots.items():
            command = pilot.act(observations[name])
            if command is not None:
                commands[name] = command
        return commands


def fly(
    scenario: Scenario,
    seed: int,
    *,
    secret: str = "",
    weighting: Weighting | None = None,
    path: VirtualPath | None = None,
    on_tick: Callable[[Flight], None] | None = None,
) -> tuple[Flight, Summary]:
    """Fly a scenario in this process.

    Args:
        scenario: What is flown.
        seed: Of all random numbers, with the secret.
        secret: Of the run, as `sim.engine.run_keys.check_secret` returns it; empty: none.
        weighting: For the law `weighted`, instead of the scenario's.
        path: For the law `path`, instead of the scenario's.
        on_tick: Called after each tick with the flight, which it may stop.

    Returns:
        The flight with its record, and the summary.
    """
    flight = Flight(scenario, seed, secret=secret)
    exchange = InProcess(make_pilots(scenario, seed, secret=secret, weighting=weighting, path=path))
    started = time.perf_counter()
    flight.fly(exchange, on_tick=None if on_tick is None else lambda: on_tick(flight))
    return flight, summarize(flight, seconds=time.perf_counter() - started)


def run(
    scenario: str | Path | Scenario = "escort",
    *,
    seed: int | None = None,
    secret: str = "",
    allow_code: bool = False,
) -> Summary:
    """Fly a scenario in this process and sum it up.

    Args:
        scenario: A shipped name, a file, or a scenario.
        seed: Of all random numbers; the scenario's own by default.
        secret: Of the run: 32 to 128 hexadecimal digits; empty: none, and the seed alone gives the flight.
        allow_code: Whether the code that a file names is loaded; that of a scenario made in Python always is.

    Raises:
        ScenarioError: If it cannot be flown.
        ValueError: If the secret is none.
    """
    flown = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
    check_code(flown, source=scenario, allowed=allow_code or isinstance(scenario, Scenario))
    return fly(flown, flown.seed if seed is None else seed, secret=check_secret(secret))[1]
