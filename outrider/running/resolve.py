"""Merging of a scenario's file and the options of a command."""

from collections.abc import Sequence

from bus.errors import ScenarioError
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario


def resolve(
    source: str,
    *,
    seed: int | None = None,
    duration: float | None = None,
    law: str | None = None,
    driver: str | None = None,
    network: str = "",
    realtime: float | None = None,
    join_timeout: float | None = None,
    respawn: bool = False,
    changes: Sequence[str] | None = None,
) -> tuple[Scenario, list[str]]:
    """Return the scenario with all options applied, and the changes in which the user may have named code.

    Args:
        source: Name of a shipped scenario, or a TOML file.
        seed: Replaces the file's seed. All options up to `respawn` replace the file's field if given.
        duration: Simulated time [s].
        law: Law of all UAVs.
        driver: Driver of all UGVs.
        network: Network profile of every link.
        realtime: Simulated seconds per second of wall time; 0: lockstep.
        join_timeout: Longest wait for a vehicle or the router [s].
        respawn: True: restart a vehicle's process if it exits.
        changes: Changes of fields, in the form of `--set`; applied first.

    Raises:
        ScenarioError: If the scenario cannot be flown.
    """
    options: dict[str, object] = {
        "seed": seed,
        "duration": duration,
        "law.name": law,
        "ugv.*.driver": driver,
        "links.profile": network or None,
        "run.realtime": realtime,
        "run.join_timeout": join_timeout,
        "run.respawn": respawn or None,
    }
    given = [(field, value) for field, value in options.items() if value is not None]
    scenario = load_scenario(source, overrides=[*(changes or ()), *given])
    if law and not scenario.uav:
        raise ScenarioError(f"--law {law}: {scenario.name} has no UAV; allowed: no --law")
    return scenario, [*(changes or ()), *([f"ugv.*.driver={driver}"] if driver else [])]
