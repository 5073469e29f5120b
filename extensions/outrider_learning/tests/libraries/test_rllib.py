"""RLlib with the environment: spaces, values, episode ends, the example, and no process left behind.

Run by `make learn-test`.
"""

import os
import subprocess
import sys
import tempfile
import time
import uuid
from pathlib import Path

import numpy as np
import pytest
from episodes import DURATIONS, EXAMPLES, flown

import outrider

pytestmark = pytest.mark.filterwarnings(
    "ignore::DeprecationWarning", "ignore::FutureWarning", "ignore::UserWarning"
)

MAKE = {
    "raw": outrider.parallel_env,
    "float32": lambda *args, **options: outrider.parallel_env(*args, **options, dtype=np.float32),
}


@pytest.mark.parametrize("kind", MAKE)
@pytest.mark.parametrize("end", DURATIONS)
def test_an_episode_is_the_bare_environments_to_its_end(kind, end):
    from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv  # noqa: PLC0415 - optional

    bare, env = (MAKE[kind]("escort", duration=DURATIONS[end]) for _ in range(2))
    env = ParallelPettingZooEnv(env)
    assert set(env.possible_agents) == {"uav_0", "ugv_0"}
    for name in env.possible_agents:
        assert env.get_observation_space(name) == bare.observation_space(name)
        assert env.get_action_space(name) == bare.action_space(name)
    seen = env.reset(seed=5)[0]
    for expected, actions, answers in flown(bare, end):
        assert env.observation_space.contains(seen)
        for name, row in expected.items():
            np.testing.assert_array_equal(seen[name], row)
        _, rewards, terminations, truncations, infos = answers
        seen, paid, terminated, truncated, env_infos = env.step(actions)
        assert paid == rewards
        assert terminated == {**terminations, "__all__": all(terminations.values())}
        assert truncated == {**truncations, "__all__": all(truncations.values())}
        assert env_infos == infos
    assert env.observation_space.contains(seen)
    assert terminated["__all__"] is (end == "terminated")
    assert truncated["__all__"] is (end == "truncated")
    seen, expected = env.reset()[0], bare.reset()[0]  # the episode after the first
    for _ in range(3):
        np.testing.assert_array_equal(seen["uav_0"], expected["uav_0"])
        still = dict.fromkeys(bare.agents, np.zeros(2))
        seen, expected = env.step(still)[0], bare.step(still)[0]


def marked(mark):
    """Return the processes whose environment contains this mark."""
    found = []
    for entry in Path("/proc").glob("[0-9]*/environ"):
        try:
            if mark.encode() in entry.read_bytes():
                found.append(
                    (entry.parent / "cmdline")
                    .read_bytes()
                    .replace(b"\0", b" ")
                    .decode(errors="replace")
                )
        except OSError:  # ended, or of another user
            continue
    return found


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="looks for processes in /proc")
def test_the_example_learns_saves_and_leaves_nothing_behind(tmp_path):
    mark = f"OUTRIDER_TEST_{uuid.uuid4().hex}"
    cache = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")  # not compiled again
    options = "--iterations 2 --batch 500 --duration 2 --runners 1 --out out"
    command = [sys.executable, str(EXAMPLES / "train_rllib.py"), *options.split()]
    with tempfile.TemporaryDirectory(prefix="r") as short:  # Ray's sockets need a short path
        own = {"HOME": str(tmp_path), "XDG_CACHE_HOME": cache, "RAY_TMPDIR": short, mark: "1"}
        with (tmp_path / "log").open("w") as log:
            process = subprocess.Popen(
                command, stdout=log, stderr=subprocess.STDOUT, cwd=tmp_path, env=os.environ | own
            )
        seen, until = set(), time.monotonic() + 300.0
        while process.poll() is None and time.monotonic() < until:
            seen.update(marked(mark))
            time.sleep(0.5)
        process.kill()
        process.wait()
        until = time.monotonic() + 10.0
        while marked(mark) and time.monotonic() < until:
            time.sleep(0.2)
        assert marked(mark) == []
    assert any("raylet" in command for command in seen)  # the processes were found
    log = (tmp_path / "log").read_text()
    assert process.returncode == 0, log
    assert "random actions: 40 ticks" in log
    assert "1000 steps  mean return: uav" in log
    modules = tmp_path / "out" / "checkpoint" / "learner_group" / "learner" / "rl_module"
    assert all((modules / policy / "module_state.pkl").is_file() for policy in ("uav", "ugv"))
