"""What the README shows is what is there."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from bus.messages import LinkKind
from outrider.cli.main import COMMANDS
from sim.scenario.loading import load_scenario

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)


@pytest.mark.parametrize("example", ["environment", "own_pilot", "external_ugv"])
def test_the_examples_are_shown_as_they_are(example: str) -> None:
    text = (ROOT / "examples" / f"{example}.py").read_text(encoding="utf-8")
    assert text.split('"""')[2].strip() in README


def test_the_scenario_shown_can_be_flown(tmp_path: Path) -> None:
    shown = next(block for block in blocks("toml") if "title" in block)
    (tmp_path / "mine.toml").write_text(shown, encoding="utf-8")
    assert load_scenario(tmp_path / "mine.toml").title == "Across the yard"


def test_the_links_shown_can_be_flown(tmp_path: Path) -> None:
    shown, links = (
        next(block for block in blocks("toml") if word in block) for word in ("title", "[links]")
    )
    (tmp_path / "mine.toml").write_text(shown + links, encoding="utf-8")
    settings = load_scenario(tmp_path / "mine.toml").links
    assert (settings.commands.delay, settings.detections.jitter_shape) == (0.1, "exponential")
    assert settings.of("uav_0", LinkKind.DETECTIONS).blackouts == ((30.0, 5.0),)


def test_the_filter_shown_keeps_sight(tmp_path: Path) -> None:
    shown = next(block for block in blocks("python") if "SafetyFilterWrapper" in block)
    run = subprocess.run(
        [sys.executable, "-c", shown], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    count, said = run.stdout.split(" ", 1)
    assert int(count) > 100
    assert said == "commands were not let through; certified: True\n"


@pytest.mark.xdist_group("many worlds")
def test_the_many_worlds_shown_fly(tmp_path: Path) -> None:
    shown = next(block for block in blocks("python") if "vector_env" in block)
    run = subprocess.run(
        [sys.executable, "-c", shown], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert float(run.stdout) > 100.0


def test_the_commands_shown_exist() -> None:
    shown = set(re.findall(r"^outrider (\S+)", "\n".join(blocks("sh")), flags=re.MULTILINE))
    assert shown <= set(COMMANDS)
    assert {"run", "simulator", "uav", "ugv", "scenarios", "figures", "bench"} <= shown


def test_the_weighting_shown_flies(tmp_path: Path) -> None:
    shown = next(block for block in blocks("python") if "def careful" in block)
    (tmp_path / "mine.py").write_text(shown, encoding="utf-8")
    arguments = [
        "run",
        "--in-process",
        "--law",
        "weighted",
        "--weighting",
        "mine:careful",
        "--duration",
        "5",
        "--no-files",
        "--json",
    ]
    run = subprocess.run(
        [sys.executable, "-m", "outrider", *arguments],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    assert json.loads(run.stdout)["visibility_violations"] == 0


def test_the_claims_shown_are_those_that_the_figures_make(tmp_path: Path) -> None:
    from outrider.experiments.paper_figures import make_figures

    shown = README.split("<!-- claims -->")[1].split("<!-- /claims -->")[0]
    rows = [line.split(" | ") for line in shown.strip().splitlines()[2:]]
    made = [
        (claim.figure, claim.claim, "yes" if claim.holds else "**no**")
        for claim in make_figures(tmp_path, on_progress=None)
    ]
    assert [(row[0].removeprefix("| "), row[1], row[-1].removesuffix(" |")) for row in rows] == made


def test_links_within_the_repository_lead_somewhere() -> None:
    prose = re.sub(r"```.*?```", "", README, flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)#:]+)\)", prose):
        assert (ROOT / target).exists(), target
