"""Episodes of the bare environment, and example programs, for the tests with learning libraries."""

import subprocess
import sys
from pathlib import Path

import numpy as np

EXAMPLES = Path(__file__).parents[4] / "examples"
APART = {"uav_0": np.array([0.3, 0.0]), "ugv_0": np.array([-0.1, 0.0])}
DURATIONS = {"terminated": 30.0, "truncated": 2.0}
"""End of an episode of `flown` -> `duration` [s] of the environment."""


def flown(bare, end):
    """Yield observations, actions and results of each step with seed 5; actions are random or lose sight."""
    rng, (observations, _) = np.random.default_rng(0), bare.reset(seed=5)
    while bare.agents:
        spaces = {name: bare.action_space(name) for name in bare.agents}
        actions = {name: rng.uniform(-1.0, 1.0, 2) * space.high for name, space in spaces.items()}
        actions = APART if end == "terminated" else actions
        answers = bare.step(actions)
        yield observations, actions, answers
        observations = answers[0]


def run_example(path, options, folder):
    """Run an example in this folder and return its result."""
    command = [sys.executable, str(path), *options.split()]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=170, cwd=folder, check=False
    )
    assert done.returncode == 0, done.stderr
    return done
