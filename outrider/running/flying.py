"""Run in this process: the same world, pilots and loop as over the bus, without a bus."""

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
from sim.scenario.checks import check_no_robot
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
    """Make the scenario's pilots, briefed as over the bus.

    Args:
        scenario: Scenario to fly.
        seed, secret: Seed and secret of the run.
        weighting: Replaces the scenario's `custom.weighting`.
        path: Replaces the scenario's `custom.path`.

    Raises:
        ScenarioError: If a robot flies a UAV, which no pilot here can report.
    """
    check_no_robot(scenario)
    weighting = weighting or load_function(scenario.custom.weighting, what="custom.weighting")
    path = path or load_function(scenario.custom.path, what="custom.path")
    policy = load_function(scenario.custom.policy, what="custom.policy")
    own = load_function(scenario.custom.uav_policy, what="custom.uav_policy")
    pilots: dict[str, UavPilot | UgvPilot] = {}
    for vehicle in scenario.vehicles:
        brief = briefing(scenario, vehicle.name, seed, secret)
        if isinstance(brief, UavBriefing):
            pilots[vehicle.name] = UavPilot(
                brief,
                weighting=weighting,
                path=path,
                policy=copy.deepcopy(own),  # it may keep state within a flight
                policy_name=scenario.custom.uav_policy,
            )
        else:
            pilots[vehicle.name] = UgvPilot(
                brief, policy=policy, policy_name=scenario.custom.policy
            )
    return pilots


class InProcess:
    """Exchange without a bus: each pilot is called with its observation."""

    def __init__(self, pilots: Mapping[str, Pilot]) -> None:
        self._pilots = pilots
        self._observations: Mapping[str, Observation] = {}

    def begin(self, tick: int) -> None:
        """Do nothing: a run in one process has no operators."""

    def publish(self, observations: Mapping[str, Observation]) -> None:
        """Store the observations for the pilots."""
        self._observations = observations

    def collect(self, tick: int) -> dict[str, Command]:
        """Call every pilot and return the commands."""
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
        scenario: Scenario to fly.
        seed: Seed of all random numbers, together with the secret.
        secret: Secret of the run, as returned by `sim.engine.run_keys.check_secret`; empty: none.
        weighting: Weighting for the law `weighted`; replaces the scenario's.
        path: Path for the law `path`; replaces the scenario's.
        on_tick: Called after each tick with the flight, which it may stop.

    Returns:
        The flight with its record, and its summary.
    """
    flight = Flight(scenario, seed, secret=secret)
    pilots = make_pilots(scenario, flight.seed, secret=secret, weighting=weighting, path=path)
    exchange = InProcess(pilots)
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
    """Fly a scenario in this process and return its summary.

    Args:
        scenario: Name of a shipped scenario, a file, or a scenario.
        seed: Seed of all random numbers; None: the scenario's.
        secret: Secret of the run, 32 to 128 hexadecimal digits; empty: none, and the seed alone determines the run.
        allow_code: True: load code that the file names. Code of a scenario made in Python is always loaded.

    Raises:
        ScenarioError: If the scenario cannot be flown.
        ValueError: If the seed or the secret is invalid.
    """
    flown = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
    check_code(flown, source=scenario, allowed=allow_code or isinstance(scenario, Scenario))
    return fly(flown, flown.seed if seed is None else seed, secret=check_secret(secret))[1]
