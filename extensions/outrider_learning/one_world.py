"""The single environment that a learned policy flies: the same observations as in the batch, and the safety filter."""

from pathlib import Path
from typing import Any

from agents.env_wrappers import EstimateWrapper, SafetyFilterWrapper
from outrider.envs.escort_env import parallel_env
from outrider_learning.learned import LearnedPolicy
from sim.scenario.types import Scenario


def alone(
    scenario: str | Path | Scenario,
    policy: LearnedPolicy,
    *,
    safety_filter: bool = True,
    **settings: Any,  # noqa: ANN401 - those of outrider.parallel_env
) -> Any:  # noqa: ANN401 - PettingZoo has no types
    """`outrider.parallel_env` with the wrappers whose observations the policy was trained on.

    Args:
        scenario: A shipped name, a file, or a scenario.
        policy: Who will fly.
        safety_filter: Whether the UAVs' actions go through the safety filter.
        settings: Further arguments of `outrider.parallel_env`.

    Raises:
        ValueError: If the policy is not made for the scenario.
    """
    env = parallel_env(scenario, coverage_patch=policy.setup["coverage_patch"], **settings)
    policy.check(env.scenario)
    return EstimateWrapper(SafetyFilterWrapper(env) if safety_filter else env)
