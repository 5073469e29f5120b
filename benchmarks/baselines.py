"""Baselines of the suites: PPO with and without the safety filter on three tasks, five training seeds each.

    pip install -e '.[sb3]'
    python benchmarks/baselines.py

Every training is a file in `--out`; a second start trains only what is missing. At the end the program writes the
table in `extensions/outrider_learning/README.md`, the curves, and `examples/policies/ppo_*.npz`.
"""

import argparse
import json
import shutil
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean, stdev
from typing import Any

import torch
from markdown_tables import head
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecNormalize

import outrider
from outrider.style import INK, MUTED, UAV, new_figure, plot_style, save
from outrider_learning.egocentric import Egocentric
from outrider_learning.networks import load_npz_policy, save_network
from outrider_learning.repeat import ActionRepeat
from outrider_learning.sb3 import VecEnvAdapter
from outrider_learning.suite.tasks import SEEDS, Task, suite
from outrider_learning.transformation import Transformed

PAGE = Path("extensions/outrider_learning/README.md")
PICTURE = Path("docs/how-to/baselines.png")
SHOWN = f"![Validation scores over the processor time of training](../../{PICTURE})\n"
POLICIES = Path("examples/policies")
MARKS = "<!-- baselines -->\n", "<!-- /baselines -->\n"
VALIDATION_SEEDS = range(8000, 8002)
"""Seeds of the curves and of the choice of the saved policy; neither trained on nor scored in the table."""
TRAINING_SEEDS = range(5)
REPEAT, WORLDS, ROLLOUT, LENGTH = 10, 16, 128, 60.0
"""Ticks per decision; worlds; decisions per rollout and world; length of a training episode [s]."""
STEPS = 20 * WORLDS * ROLLOUT
CHECKPOINTS = 4
PPO_SETTINGS: dict[str, Any] = {
    "learning_rate": 1e-3,
    "batch_size": 256,
    "n_epochs": 10,
    "gamma": 0.95,
    "gae_lambda": 0.95,
    "policy_kwargs": {"log_std_init": -1.0},
}
"""Hyperparameters; the others are the defaults of Stable-Baselines3, with two layers of 64."""
LOSING_SIGHT = outrider.RewardWeights(sight_lost=2.0, out_of_sight=1.0)
"""Rewards without the filter: the default cost of a loss would hide all others."""
LAWS = ("lookahead", "tracking")
"""Laws beside the baselines: the best one, and hovering."""


@dataclass(frozen=True, kw_only=True)
class Baseline:
    """Task with the scenario of its training."""

    scenario: str
    suite: str
    task: str
    secret: str
    """Secret of the suite's published table."""

    @property
    def scored(self) -> Task:
        """Return the task of the suite."""
        return suite(self.suite)[self.task]


_SECRET = "000102030405060708090a0b0c0d0e0f"  # noqa: S105 - published
BASELINES = (
    Baseline(
        scenario="escort",
        suite="suite-v1",
        task="paper",
        secret="6f757472696465722d73756974652d31",  # noqa: S106 - published
    ),
    Baseline(scenario="minefield", suite="missions-v1", task="minefield", secret=_SECRET),
    Baseline(scenario="town", suite="towns-v1", task="town", secret=_SECRET),
)


class Curve(BaseCallback):
    """Callback that scores the policy without exploration at regular intervals."""

    def __init__(self, baseline: Baseline, file: Path, *, filtered: bool, steps: int) -> None:
        super().__init__()
        self._baseline, self._file, self._filtered = baseline, file, filtered
        self._every, self._due = steps / CHECKPOINTS, 0.0
        self._spent = 0.0
        self._started = time.process_time()
        self.points: list[tuple[int, float, float]] = []
        """Decisions, processor time of the training [s], validation score."""

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        if self.num_timesteps >= self._due:
            self._due += self._every
            self.record()

    def record(self) -> None:
        """Add a point."""
        before = time.process_time()
        save_network(self.model, self._file)
        policy = load_npz_policy(str(self._file), "policy")
        result = self._baseline.scored.evaluate(
            policy, seeds=VALIDATION_SEEDS, secret="", safety_filter=self._filtered
        )
        now = time.process_time()
        self._spent += now - before
        self.points.append((self.num_timesteps, now - self._started - self._spent, result.score))


def train(baseline: Baseline, file: Path, *, filtered: bool, seed: int, steps: int) -> None:
    """Train one policy, score it, and write `file` (JSON) and its network beside it."""
    network = file.with_suffix(".npz")
    rewards = outrider.RewardWeights() if filtered else LOSING_SIGHT
    env = outrider.vector_env(
        baseline.scenario,
        num_envs=WORLDS,
        estimate=True,
        gradient=True,
        omit=("time", "position"),
        safety_filter=filtered,
        duration=LENGTH,
        rewards=rewards,
        threads=1,
    )
    adapter = VecEnvAdapter(Transformed(ActionRepeat(env, REPEAT), Egocentric()))
    worlds = VecNormalize(adapter, gamma=PPO_SETTINGS["gamma"])
    model = PPO(
        "MlpPolicy", worlds, n_steps=ROLLOUT, seed=1000 * seed, device="cpu", **PPO_SETTINGS
    )
    curve, started = Curve(baseline, network, filtered=filtered, steps=steps), time.perf_counter()
    model.learn(steps, callback=curve)
    curve.record()
    wall = time.perf_counter() - started
    worlds.close()
    about = {"decisions": model.num_timesteps, "seed": seed, "safety_filter": filtered}
    save_network(model, network, trained=about)
    policy = load_npz_policy(str(network), "policy")
    result = baseline.scored.evaluate(
        policy, seeds=SEEDS, secret=baseline.secret, safety_filter=filtered
    )
    found = {
        **about,
        "score": result.score,
        "lost": result.lost,
        "episodes": result.episodes,
        "curve": curve.points,
        "wall": wall,
    }
    file.write_text(json.dumps(found, indent=1) + "\n")


def jobs(out: Path) -> Iterator[tuple[Baseline, bool, int, Path]]:
    """Yield every training: each task with and without the filter, for one seed after the other."""
    for seed in TRAINING_SEEDS:
        for baseline in BASELINES:
            for filtered in (True, False):
                kind = "filter" if filtered else "no-filter"
                yield baseline, filtered, seed, out / f"{baseline.scenario}-{kind}-{seed}.json"


def law_score(baseline: Baseline, law: str, out: Path) -> tuple[float, int]:
    """Return the score and the losses of a law in a task; computed once."""
    file = out / f"{baseline.scenario}-{law}.json"
    if not file.exists():
        result = baseline.scored.evaluate(law, seeds=SEEDS, secret=baseline.secret)
        file.write_text(json.dumps([result.score, result.lost]))
    score, lost = json.loads(file.read_text())
    return score, lost


def results(out: Path) -> dict[tuple[str, bool], list[dict[str, Any]]]:
    """Return the finished trainings by scenario and filter, in the order of their seeds."""
    found: dict[tuple[str, bool], list[dict[str, Any]]] = {}
    for baseline, filtered, _, file in jobs(out):
        if file.exists():
            one = json.loads(file.read_text()) | {"file": file.with_suffix(".npz")}
            found.setdefault((baseline.scenario, filtered), []).append(one)
    return found


def learned_cell(runs: list[dict[str, Any]]) -> str:
    """Return mean and spread over the training seeds, and the episodes with a loss of sight."""
    scores = [run["score"] for run in runs]
    spread = f" ± {stdev(scores):.1f}" if len(scores) > 1 else ""
    lost, episodes = sum(run["lost"] for run in runs), sum(run["episodes"] for run in runs)
    ends = f" [{min(scores):.1f}, {max(scores):.1f}]"
    return f"{fmean(scores):.1f}{spread}{ends}" + (f" ({lost} of {episodes} lost)" if lost else "")


def table(out: Path) -> Iterator[str]:
    """Yield the table line by line."""
    found = results(out)
    yield head("task | PPO, safety filter | PPO, no filter | lookahead | tracking | CPU time [s]")
    for baseline in BASELINES:
        groups = [found.get((baseline.scenario, filtered), []) for filtered in (True, False)]
        cells = [learned_cell(runs) if runs else "–" for runs in groups]
        for law in LAWS:
            score, lost = law_score(baseline, law, out)
            cells.append(f"{score:.1f}" + (f" ({lost} of {len(SEEDS)} lost)" if lost else ""))
        times = [run["curve"][-1][1] for runs in groups for run in runs]
        count = "/".join(str(len(runs)) for runs in groups)
        cells.append(f"{fmean(times):.0f} ({count} seeds)" if times else "–")
        yield f"| `{baseline.task}` | {' | '.join(cells)} |"


def draw(out: Path) -> None:
    """Draw the validation scores of all trainings over their processor time."""
    found = results(out)
    with plot_style():
        figure = new_figure(1180, 420)
        axes = figure.subplots(1, len(BASELINES), sharey=True)
        for panel, baseline in zip(axes, BASELINES, strict=True):
            for law, dashes, side in zip(LAWS, ("--", ":"), ("bottom", "top"), strict=True):
                score, _ = law_score(baseline, law, out)
                panel.axhline(score, color=MUTED, linestyle=dashes, linewidth=1.3)
                panel.annotate(law, (0.0, score), color=MUTED, va=side, fontsize=9)
            for filtered, tint in ((True, UAV[0]), (False, INK)):
                for k, run in enumerate(found.get((baseline.scenario, filtered), [])):
                    times, scores = zip(*[point[1:] for point in run["curve"]], strict=True)
                    name = ("safety filter" if filtered else "no filter") if k == 0 else None
                    panel.plot(times, scores, color=tint, linewidth=1.2, alpha=0.8, label=name)
            panel.set_title(f"PPO in {baseline.task}", color=INK)
            panel.set_xlabel("processor time of training [s]")
            panel.set_ylim(0.0, 100.0)
        axes[0].set_ylabel("validation score")
        axes[1].legend(loc="lower right")
        save(figure, PICTURE)


def publish(out: Path) -> None:
    """Write the table into the page, the picture, and the policies: the median seed by validation score."""
    text = PAGE.read_text()
    before, rest = text.split(MARKS[0])
    _, after = rest.split(MARKS[1])
    lines = "".join(f"{line}\n" for line in table(out))
    PAGE.write_text(f"{before}{MARKS[0]}{lines}\n{SHOWN}{MARKS[1]}{after}")
    draw(out)
    for (scenario, filtered), runs in results(out).items():
        if filtered:
            ranked = sorted(runs, key=lambda run: run["curve"][-1][2])
            shutil.copy(ranked[len(ranked) // 2]["file"], POLICIES / f"ppo_{scenario}.npz")


def main() -> None:
    """Train what is missing, then publish."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("runs/baselines"))
    parser.add_argument("--steps", type=int, default=STEPS, help="Decisions of each training.")
    parser.add_argument("--only", help="Train only for this scenario.")
    parser.add_argument("--table", action="store_true", help="Publish what is trained so far.")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)
    todo = [job for job in jobs(given.out) if given.only in (None, job[0].scenario)]
    for k, (baseline, filtered, seed, file) in enumerate(() if given.table else todo):
        if not file.exists():
            train(baseline, file, filtered=filtered, seed=seed, steps=given.steps)
        score = json.loads(file.read_text())["score"]
        sys.stdout.write(f"{k + 1:3} of {len(todo)}  {file.stem:24} score {score:5.1f}\n")
        sys.stdout.flush()
    publish(given.out)


if __name__ == "__main__":
    main()
