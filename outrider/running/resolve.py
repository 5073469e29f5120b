"""Merging of a scenario's file and the options of a command."""

from collections.abc import Sequence

from bus.errors import ScenarioError
from bus.registry import LAWS
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario


def resolve(
    source: str,
    *,
    seed: int | None = None,
    duration: float | None = None,
    law: str | None = None,
    driver: str | None = None,
    uav_policy: str = "",
    network: str = "",
    realtime: float | None = None,
    join_timeout: float | None = None,
    changes: Sequence[str] | None = None,
) -> tuple[Scenario, list[str]]:
    """Return the scenario with all options applied, and the changes in which the user may have named code.

    Args:
        source: Name of a shipped scenario, or a TOML file.
        seed: Replaces the file's seed. All options up to `join_timeout` replace the file's field if given.
        duration: Simulated time [s].
        law: Law of all UAVs; also replaces the law of a UAV of its own.
        driver: Driver of all UGVs.
        uav_policy: Policy of all UAVs, inside the safety filter unless the law is `policy`.
        network: Network profile of every link.
        realtime: Simulated seconds per second of wall time; 0: lockstep.
        join_timeout: Longest wait for a vehicle or the router [s].
        changes: Changes of fields, in the form of `--set`; applied first.

    Raises:
        ScenarioError: If the scenario cannot be flown; with a line for each independent fault.
    """
    options: dict[str, object] = {
        "seed": seed,
        "duration": duration,
        "ugv.*.driver": driver,
        "custom.uav_policy": uav_policy or None,
        "links.profile": network or None,
        "run.realtime": realtime,
        "run.join_timeout": join_timeout,
    }
    given = [(field, value) for field, value in options.items() if value is not None]
    overrides: list[str | tuple[str, object]] = [*(changes or ()), *given]
    scenario = load_scenario(source, overrides=overrides, law=law, every=True)
    if law and not scenario.uav:
        raise ScenarioError(f"--law {law}: {scenario.name} has no UAV; allowed: no --law")
    named = [f"{field}={value}" for field, value in given if field in _CODE]
    if uav_policy and not _flies_policy(scenario):
        if law or not scenario.uav:
            where = f"--law {law}" if law else f"{scenario.name}, which has no UAV"
            raise ScenarioError(
                f"--uav-policy {uav_policy}: not used by {where}; allowed: with {' or '.join(_LAWS)}"
            )
        scenario = load_scenario(source, overrides=overrides, law=_LAWS[0], every=True)
    return scenario, [*(changes or ()), *named]


_CODE = ("ugv.*.driver", "custom.uav_policy")
"""Fields of options that may name code."""
_LAWS = tuple(name for name, row in LAWS.items() if "uav_policy" in (row.inner, row.own))
"""Laws that fly a policy, the one with the safety filter first."""


def _flies_policy(scenario: Scenario) -> bool:
    return any(scenario.law_of(uav).name in _LAWS for uav in scenario.uav)
