"""Baselines of the suite of teams: MAPPO and IPPO of TorchRL on the task `scouts`, five training seeds each.

    pip install -e '.[torchrl]'
    python benchmarks/team_baselines.py

Every training is a process of `examples/train_team.py`, with its files in `--out`; a second start trains and scores
only what is missing. At the end the program writes the table in `extensions/outrider_learning/README.md`, the learning
curves, and `examples/policies/mappo_scouts.npz` and `ippo_scouts.npz`.
"""

import argparse
import csv
import json
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
from markdown_tables import head

from outrider.experiments.intervals import mean_interval
from outrider.style import MUTED, UAV, UGV, new_figure, plot_style, save
from outrider_learning.networks import load_npz_policy
from outrider_learning.suite.tasks import SEEDS, TEAM_SUITE, suite

PROGRAM = Path("examples/train_team.py")
PAGE = Path("extensions/outrider_learning/README.md")
PICTURE = Path("docs/how-to/team-baselines.png")
SHOWN = f"![Validation scores over the decisions of training](../../{PICTURE})\n"
POLICIES = Path("examples/policies")
MARKS = "<!-- team baselines -->\n", "<!-- /team baselines -->\n"
TRAINED = "scouts"
ALGORITHMS = {"mappo": "MAPPO", "ippo": "IPPO"}
TINTS = {"mappo": UAV[0], "ippo": UGV[0]}
LAWS = ("lookahead", "certified", "circle", "tracking")
FEWER_SEEDS = {"lookahead": SEEDS[:5]}
"""Evaluation seeds of a law that takes minutes for each."""
TRAINING_SEEDS = range(5)
STEPS = 48_000
SECRET = "000102030405060708090a0b0c0d0e0f"  # noqa: S105 - published


def jobs(out: Path) -> Iterator[tuple[str, int, Path]]:
    """Yield every training: algorithm, seed, policy."""
    for seed in TRAINING_SEEDS:
        for algorithm in ALGORITHMS:
            yield algorithm, seed, out / f"{algorithm}-{TRAINED}-{seed}.npz"


def train(algorithm: str, seed: int, file: Path, steps: int) -> None:
    """Train one policy in its own process; its files appear when it is finished."""
    partial = file.parent / "partial"
    options = f"--algorithm {algorithm} --task {TRAINED} --seed {seed} --steps {steps}"
    command = [sys.executable, str(PROGRAM), *options.split(), "--out", str(partial)]
    subprocess.run(command, check=True)
    for made in (file.with_suffix(".csv"), file):
        shutil.move(partial / made.name, made)


def scored(name: str, task: str, out: Path, policy: Path | None = None) -> dict[str, Any]:
    """Return score, mean e(t) and losses of a law or a policy in a task; computed once."""
    file = out / f"{name}-in-{task}.json"
    if not file.exists():
        entry = name if policy is None else load_npz_policy(str(policy), "policy")
        result = suite(TEAM_SUITE)[task].evaluate(
            entry, seeds=FEWER_SEEDS.get(name, SEEDS), secret=SECRET
        )
        found = {
            "score": result.score,
            "low": result.low,
            "high": result.high,
            "error": result.mean_error,
            "lost": result.lost,
        }
        file.write_text(json.dumps(found) + "\n")
    found = json.loads(file.read_text())
    return dict(found)


def finished(out: Path) -> dict[str, list[Path]]:
    """Return the policies of the finished trainings by algorithm."""
    found: dict[str, list[Path]] = {algorithm: [] for algorithm in ALGORITHMS}
    for algorithm, _, file in jobs(out):
        if file.exists():
            found[algorithm].append(file)
    return found


def learned_cell(policies: list[Path], task: str, out: Path) -> str:
    """Return mean and 95 % interval of score and e(t) over the training seeds."""
    results = [scored(file.stem, task, out, file) for file in policies]
    parts = []
    for key in ("score", "error"):
        middle, low, high = mean_interval([one[key] for one in results])
        parts.append(f"{middle:.1f} ± {0.5 * (high - low):.1f}")
    lost = sum(one["lost"] for one in results)
    ends = f" ({lost} of {len(SEEDS) * len(results)} lost)" if lost else ""
    return f"{parts[0]} | {parts[1]} m²{ends}"


def law_cell(law: str, task: str, out: Path) -> str:
    """Return score and e(t) of a law over the evaluation seeds."""
    one = scored(law, task, out)
    ends = f" ({one['lost']} lost)" if one["lost"] else ""
    return (
        f"{one['score']:.1f} ± {0.5 * (one['high'] - one['low']):.1f} | {one['error']:.1f} m²{ends}"
    )


def table(out: Path) -> Iterator[str]:
    """Yield the table line by line: laws and policies by score in the task of the training."""
    tasks = (TRAINED, "relay")
    columns = (f"`{task}` | mean e(t)" for task in tasks)
    yield head(f"entry | {' | '.join(columns)} | training")
    rows = []
    for law in LAWS:
        cells = " | ".join(law_cell(law, task, out) for task in tasks)
        rows.append((scored(law, TRAINED, out)["score"], f"| `{law}` | {cells} | – |"))
    for algorithm, policies in finished(out).items():
        if policies:
            cells = " | ".join(learned_cell(policies, task, out) for task in tasks)
            minutes = fmean(curve(file)["minutes"][-1] for file in policies)
            score = fmean(scored(file.stem, TRAINED, out, file)["score"] for file in policies)
            what = f"{minutes:.1f} min, {len(policies)} seeds"
            rows.append((score, f"| {ALGORITHMS[algorithm]} | {cells} | {what} |"))
    for _, row in sorted(rows, reverse=True):
        yield row


def curve(policy: Path) -> dict[str, list[float]]:
    """Return the columns of the learning curve of a training."""
    with policy.with_suffix(".csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    return {key: [float(row[key]) for row in rows] for key in rows[0]}


def draw(out: Path, picture: Path = PICTURE) -> None:
    """Draw the learning curves: a thin line for each seed, and the mean of each algorithm."""
    with plot_style():
        figure = new_figure(980, 520)
        axes = figure.add_subplot()
        for law, dashes in zip(LAWS, ("--", "-.", ":", (0, (1, 3))), strict=True):
            error = scored(law, TRAINED, out)["error"]
            axes.axhline(error, color=MUTED, linestyle=dashes, linewidth=1.3)
            where = axes.get_yaxis_transform()
            axes.annotate(law, (1.01, error), xycoords=where, color=MUTED, va="center", fontsize=9)
        for algorithm, policies in finished(out).items():
            curves = [curve(file) for file in policies]
            for one in curves:
                axes.plot(
                    one["decisions"],
                    one["mean_error"],
                    color=TINTS[algorithm],
                    linewidth=0.8,
                    alpha=0.5,
                )
            if curves:
                points = np.unique([done for one in curves for done in one["decisions"]])
                errors = [np.interp(points, one["decisions"], one["mean_error"]) for one in curves]
                mean = np.mean(errors, axis=0)
                name = f"{ALGORITHMS[algorithm]}, mean of the seeds"
                axes.plot(points, mean, color=TINTS[algorithm], linewidth=2.4, label=name)
        axes.set_yscale("log")
        axes.set_yticks([20, 50, 100, 200], labels=["20", "50", "100", "200"])
        axes.minorticks_off()
        axes.set_xlim(left=0.0)
        axes.set_xlabel("decisions in training, one per world and 0.5 s")
        axes.set_ylabel("mean e(t) [m²], log scale")
        axes.set_title("Uncovered ground in validation flights of scouts")
        axes.legend(loc="center right", bbox_to_anchor=(1.0, 0.62))
        save(figure, picture)


def publish(out: Path) -> None:
    """Write the table into the page, the picture, and the policy of the median seed of each algorithm."""
    before, rest = PAGE.read_text().split(MARKS[0])
    _, after = rest.split(MARKS[1])
    lines = "".join(f"{line}\n" for line in table(out))
    PAGE.write_text(f"{before}{MARKS[0]}{lines}\n{SHOWN}{MARKS[1]}{after}")
    draw(out)
    for algorithm, policies in finished(out).items():
        ranked = sorted(policies, key=lambda file: curve(file)["mean_error"][-1])
        if ranked:
            shutil.copy(ranked[len(ranked) // 2], POLICIES / f"{algorithm}_{TRAINED}.npz")


def main() -> None:
    """Train and score what is missing, then publish."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("runs/team-baselines"))
    parser.add_argument("--steps", type=int, default=STEPS, help="Decisions of each training.")
    parser.add_argument("--table", action="store_true", help="Publish what is trained so far.")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    for algorithm, seed, file in () if given.table else jobs(given.out):
        if not file.exists():
            train(algorithm, seed, file, given.steps)
    publish(given.out)


if __name__ == "__main__":
    main()
