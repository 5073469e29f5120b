"""Episodes of the bare environment, and the examples as processes, for the tests of every library."""

import subprocess
import sys
from pathlib import Path

import numpy as np

EXAMPLES = Path(__file__).parents[4] / "examples"
AWAY = {"uav_0": np.array([0.3, 0.0]), "ugv_0": np.array([-0.1, 0.0])}
DURATIONS = {"terminated": 30.0, "truncated": 2.0}
"""Each end of an episode of `flown`, with the `duration` [s] of an environment in which it comes."""


def flown(bare, end):
    """Observations, actions and answers of each step from seed 5 on: random actions, or such as lose sight."""
    rng, (observations, _) = np.random.default_rng(0), bare.reset(seed=5)
    while bare.agents:
        spaces = {name: bare.action_space(name) for name in bare.agents}
        actions = {name: rng.uniform(-1.0, 1.0, 2) * space.high for name, space in spaces.items()}
        actions = AWAY if end == "terminated" else actions
        answers = bare.step(actions)
        yield observations, actions, answers
        observations = answers[0]


def run_example(path, options, folder):
    """An example that has ended well, with these options, in this folder."""
    command = [sys.executable, str(path), *options.split()]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=170, cwd=folder, check=False
    )
    assert done.returncode == 0, done.stderr
    return done
