"""Options of a command and a scenario's file, resolved into the one scenario that is flown."""

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
    """Return the scenario that the options ask for, and the changes by which the user may have named code.

    Args:
        source: A shipped scenario's name, or a TOML file.
        seed: Replaces that of the file, as do all up to `respawn` where they are given.
        duration: Simulated time [s].
        law: The law of all UAVs.
        driver: The driver of all UGVs.
        network: The profile of every link.
        realtime: Simulated seconds per second of wall time; 0: lockstep.
        join_timeout: Time to wait for a vehicle or the router [s].
        respawn: True: restart a vehicle's process that exits.
        changes: Any fields, as `--set` takes them; applied first.

    Raises:
        ScenarioError: If it cannot be flown.
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
        raise ScenarioError(
            f"--law {law}: {scenario.name} has no UAV that could fly it; allowed: none"
        )
    return scenario, [*(changes or ()), *([f"ugv.*.driver={driver}"] if driver else [])]
