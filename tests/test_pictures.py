"""The published pictures have the titles, labels and legends that the code draws today."""

import importlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("outrider_learning", reason="the pages show extensions, too")
pytest.importorskip("pyarrow", reason="the extra [sweep] is not installed")
from bus.messages.telemetry import MissionResult
from outrider.experiments.report.plots import draw_all
from outrider.experiments.report.results import read_material
from outrider.experiments.sweep.columns import RESULTS
from outrider.experiments.sweep.definition import describe_sweep
from outrider.experiments.sweep.folder import SweepFolder
from outrider.experiments.sweep.plan import lay_out
from outrider.running.flying import fly
from outrider.view.flight_picture import draw_flight
from outrider_networks.fitting import fit_link
from outrider_networks.picture import draw_fit
from pages import ROOT, words
from sim.channel.recorded import pack
from sim.scenario.loading import load_scenario

OLD = {
    "docs/explanation/altitude.png": "benchmarks/altitude_worth.py takes ten minutes on a quiet machine",
    "docs/explanation/missions.png": "benchmarks/mission_worth.py takes ten minutes on a quiet machine",
    "docs/explanation/peers.png": "benchmarks/peers/peers.py needs a quiet machine",
    "docs/explanation/robustness/commands-errors.png": "3,600 runs",
    "docs/explanation/robustness/commands-violations.png": "3,600 runs",
    "docs/explanation/robustness/violations.png": "3,600 runs",
}
"""Pictures from before their words were written into the file, and why they are not drawn again."""
ELSEWHERE = {
    "docs/tutorial.png": "test_notebooks.py",
    "docs/how-to/helsinki.png": "test_town_import.py, by the extra [geo]",
    "docs/how-to/baselines.png": "test_sb3.py, in the environment of Stable-Baselines3",
}
"""Pictures that another test compares."""


def draw_scenario(name: str) -> Callable[[Path], None]:
    def draw(out: Path) -> None:
        scenario = load_scenario(name, overrides=["duration=1"])
        draw_flight(fly(scenario, scenario.seed)[0], out)

    return draw


def draw_network(out: Path) -> None:
    file = ROOT / "examples" / "networks" / "wifi-far.csv"
    draw_fit(*fit_link(pack(file.name, file.read_bytes())), out)


def draw_missions(out: Path) -> None:
    worth = importlib.import_module("mission_worth")
    counts = dict.fromkeys(
        ("hazards_hit", "near_misses", "hazards_on_path", "warned", "finds", "found"), 0
    )
    times = {"mission_time": 1.0, "stationary_time": 0.0, "mean_warning_time": None}
    mission = MissionResult(arrived=True, reported_share=None, **times, **counts)
    laws = [(law, "perfect") for law in (worth.NO_ESCORT, *worth.LAWS)]
    rows = [
        worth.Row(scenario, caution, network, law, [mission], 0)
        for scenario, caution in worth.MISSIONS
        for law, network in laws
    ]
    worth.draw(rows, out)


def draw_altitudes(out: Path) -> None:
    worth = importlib.import_module("altitude_worth")
    rows = [
        worth.Row(law, altitude, 1.0, 1.0, 1.0, 1.0, 1)
        for law in worth.LAWS
        for altitude in (6.0, 24.0)
    ]
    worth.draw(rows, out)


def draw_search(out: Path) -> None:
    benchmark, scenario = importlib.import_module("reacquisition"), load_scenario("escort")
    places, lost = np.ones((2, 2, 2)), np.array([False, True])
    benchmark.draw(
        [benchmark.Track(one, scenario, places, lost) for one in ("wait", "search")], out
    )


def draw_teams(out: Path) -> None:
    worth = importlib.import_module("team_worth")
    numbers = {"mean_error": 1.0, "unguarded": 0.0, "out_of_sight": 0, "found": 1}
    rows = [
        worth.Row(
            key=0, scenario=name, network=network, mode=mode, uavs=n, seed=seed,
            mission_time=None, **numbers,
        )
        for name, networks in worth.TASKS.items()
        for network in networks
        for mode in (worth.ALONE, worth.TEAM)
        for n in worth.UAVS
        for seed in (1, 2)
    ]  # fmt: skip
    worth.draw(rows, out)


def draw_team_baselines(out: Path) -> None:
    baselines = importlib.import_module("team_baselines")
    trained = out.parent / "trained"
    trained.mkdir()
    for law in baselines.LAWS:
        (trained / f"{law}-in-scouts.json").write_text('{"error": 40.0}')
    for _, _, policy in baselines.jobs(trained):
        policy.touch()
        policy.with_suffix(".csv").write_text("decisions,mean_error\n0,250\n48000,40\n")
    baselines.draw(trained, out)


def draw_learning_curve(out: Path) -> None:
    policy = ROOT / "examples" / "policies" / "uav_ppo.npz"
    importlib.import_module("curve").draw_curve(policy, out, laws=())


def draw_peers(out: Path) -> None:
    report = importlib.import_module("peer_report")
    numbers = {"worlds": 1, "agents": 2, "steps_per_second": 2.0, "slowest": 1.0, "fastest": 3.0}
    row = report.Row(peer="p", name="P", variant="step", field=True, version="1", **numbers)
    conditions = {"date": "today", "cpu": "CPU", "cores": 2, "python": "3", "seconds": 1.0}
    report.write(report.Report(rows=[row], repeats=2, failures=[], **conditions), out.parent)
    (out.parent / "peers.png").replace(out)


def draw_sweeps(picture: str, *sweeps: str) -> Callable[[Path], None]:
    """Return a function that draws a picture of a report from invented results."""

    def draw(out: Path) -> None:
        folders = []
        for sweep in sweeps:
            plan = lay_out(describe_sweep(sweep, seeds=1)[0])
            found = {**dict.fromkeys(RESULTS), "margin": 1.0, "violated": False, "mean_error": 1.0}
            folders.append(out.parent / Path(sweep).stem)
            with SweepFolder(folders[-1], plan, command="outrider sweep") as folder:
                folder.add({**found, "run": run} for run in range(plan.runs))
                folder.finish()
        draw_all(read_material(folders), out.parent)[picture].replace(out)

    return draw


COMMANDS = "commands", str(ROOT / "examples" / "networks" / "sweep.toml")
DRAWN: dict[str, Callable[[Path], None]] = {
    "docs/flight.png": draw_scenario("escort"),
    "docs/explanation/ground.png": draw_scenario("minefield"),
    "docs/explanation/missions.png": draw_missions,
    "docs/explanation/altitude.png": draw_altitudes,
    "docs/explanation/peers.png": draw_peers,
    "docs/explanation/teams.png": draw_teams,
    "docs/how-to/search.png": draw_search,
    "docs/explanation/robustness/commands-errors.png": draw_sweeps("errors", *COMMANDS),
    "docs/explanation/robustness/commands-violations.png": draw_sweeps("violations", *COMMANDS),
    "docs/explanation/robustness/violations.png": draw_sweeps("violations", "network"),
    "docs/how-to/learning-curve.png": draw_learning_curve,
    "docs/how-to/measured-network.png": draw_network,
    "docs/how-to/team-baselines.png": draw_team_baselines,
}
"""Published pictures, each with a function that draws the same picture from little data."""


@pytest.mark.parametrize("picture", [name for name in DRAWN if name not in OLD])
def test_published_pictures_have_the_words_of_the_code(
    picture: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder in ("benchmarks", "benchmarks/peers", "examples"):
        monkeypatch.syspath_prepend(ROOT / folder)
    DRAWN[picture](tmp_path / "drawn.png")
    assert words(ROOT / picture) == words(tmp_path / "drawn.png"), "draw this picture again"


def test_every_published_picture_is_compared() -> None:
    folders = (ROOT / "docs", ROOT / "extensions")
    published = {
        path.relative_to(ROOT).as_posix() for folder in folders for path in folder.rglob("*.png")
    }
    assert published == {*DRAWN, *ELSEWHERE}
    assert {name for name in published if words(ROOT / name) is None} == {*OLD}
