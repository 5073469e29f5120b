"""Sweeps: each run is a row despite interruptions; invalid input is one line before the first run."""

import itertools
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path

import pytest

pytest.importorskip("pyarrow", reason="the extra [sweep] is not installed")

from bus.errors import PeerLost, ScenarioError
from bus.profiles import PROFILES
from outrider.experiments.sweep.definition import describe_sweep, shipped_sweeps
from outrider.experiments.sweep.folder import SweepFolder, read_head, read_results
from outrider.experiments.sweep.plan import SweepPlan, lay_out
from outrider.experiments.sweep.running import fly_sweep, make_tasks, open_cluster
from outrider.experiments.sweep.worker import fly_runs
from outrider.running.flying import run
from processes import OUTRIDER, PIPES, blocks, command_line, stat_of, wait_until
from refusals import refused
from sim.scenario.loading import load_scenario, scenario_names
from tabular import words

QUICK = ("duration=5.0", "area.cell=0.5")
CELLS = "area.cell=0.5"
SMALL = {
    "laws": "linear,switching",
    "vary": ["detections.noise=0,0.5"],
    "changes": QUICK,
    "seeds": 3,
}
GRID = [*words("sweep escort --law linear,switching --vary detections.noise=0,0.5 --set"), CELLS]

GOALS = "ugv.0.goals=[[1, 2]],[[3.5, 4]]"
LONG = words("--seeds 12 --set duration=20.0 --jobs 2 --json --out")
RUNS = 48
"""Runs of this grid."""


def plan_of(source: str = "escort", **given) -> SweepPlan:
    return lay_out(describe_sweep(source, **(given or (SMALL if source == "escort" else {})))[0])


def rows_of(folder: Path) -> dict[str, list[object]]:
    head = read_head(folder)
    assert head is not None
    rows = read_results(folder, head.columns)
    rows.pop("seconds")
    return rows


def flown(folder: Path, plan: SweepPlan, jobs: int = 1) -> dict[str, list[object]]:
    with SweepFolder(folder, plan, command="outrider sweep") as there:
        fly_sweep(plan, there, jobs=jobs)
        there.finish()
    return rows_of(folder)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[object]]:
    """Return the table of the long sweep without disturbances."""
    plan = plan_of(**SMALL | {"changes": [CELLS, "duration=20.0"], "seeds": 12})
    return flown(tmp_path_factory.mktemp("sweep") / "whole", plan)


@pytest.fixture(scope="module")
def small_rows(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[object]]:
    """Return the table of the small sweep, flown in this process."""
    return flown(tmp_path_factory.mktemp("sweep") / "small", plan_of())


def wait_for(there: Callable[[], bool], process: "subprocess.Popen[str]") -> None:
    def came() -> bool:
        assert process.poll() is None, process.communicate()
        return there()

    wait_until(came, 60.0)


def started(*command: str, **settings) -> "subprocess.Popen[str]":
    """Start a command in a session of its own."""
    return subprocess.Popen(
        command, start_new_session=True, stderr=subprocess.PIPE, text=True, **settings
    )


def parts(folder: Path) -> int:
    return len(list((folder / "parts").glob("*.parquet")))


def refusal(source: str = "escort", **given) -> str:
    with pytest.raises(ScenarioError) as caught:
        plan_of(source, **(given or {"seeds": 1}))
    line = str(caught.value)
    assert len(line.splitlines()) == 1
    return line


# Runs


def test_a_sweep_is_the_product_of_laws_values_and_seeds():
    plan = plan_of(
        laws="linear,circle",
        vary=["detections.noise=0,0.1,0.2", "dt=0.05,0.1"],
        changes=["detections.rate=10"],
        seeds=4,
    )
    assert plan.runs == 2 * 3 * 2 * 4
    heads = [plan.head(run) for run in range(plan.runs)]
    found = {tuple(head[k] for k in ("law", "detections.noise", "dt", "seed")) for head in heads}
    values = (("linear", "circle"), (0.0, 0.1, 0.2), (0.05, 0.1), range(4))
    assert found == set(itertools.product(*values))
    assert all(plan.points[head["run"] // 4].scenario.detections.rate == 10.0 for head in heads)


def test_sweep_blocks_vary_one_field_each(tmp_path):
    (tmp_path / "mine.toml").write_text(
        'scenario = "escort"\nlaws = ["linear"]\nseeds = 2\nfirst_seed = 10\nset.duration = 5.0\n'
        '[[block]]\nname = "noise"\nvary.detections.noise = [0.2, 0.3]\n'
        "[[block]]\nvary.detections.dropout = [0.5]\nset.detections.noise = 0.4\n",
        encoding="utf-8",
    )
    plan = plan_of(str(tmp_path / "mine.toml"))
    heads = [plan.head(run) for run in range(plan.runs)]
    fields = ("block", "seed", "detections.noise", "detections.dropout")
    assert [tuple(head[name] for name in fields) for head in heads] == [
        *(("noise", seed, noise, 0.1) for noise in (0.2, 0.3) for seed in (10, 11)),
        *(("detections.dropout", seed, 0.4, 0.5) for seed in (10, 11)),
    ]


def test_values_of_any_kind_can_be_varied():
    plan = plan_of(
        vary=[*words("ugv.0.driver=evade,wander estimator.enabled=true,false"), GOALS], seeds=1
    )
    assert plan.columns["ugv.0.driver"] == plan.columns["ugv.0.goals"] == "string"
    assert plan.columns["estimator.enabled"] == "bool"
    last = plan.head(plan.runs - 1)
    values_of_last = (last["ugv.0.driver"], last["estimator.enabled"], last["ugv.0.goals"])
    assert values_of_last == ("wander", False, "[[3.5,4.0]]")


def test_profiles_can_be_varied():
    plan = plan_of(laws="linear", vary=["links.profile=wifi,lte"], seeds=1)
    assert [plan.head(run)["links.profile"] for run in range(2)] == ["wifi", "lte"]
    assert [point.scenario.links.commands for point in plan.points] == [
        PROFILES["wifi"],
        PROFILES["lte"],
    ]


def test_a_scenario_beside_the_sweep_s_file_is_found(tmp_path, monkeypatch):
    (tmp_path / "yard.toml").write_text(
        "duration = 5.0\n[[uav]]\nposition = [6, 7]\n[[ugv]]\nposition = [6, 6]\n", encoding="utf-8"
    )
    (tmp_path / "mine.toml").write_text('scenario = "yard.toml"\nseeds = 1\n', encoding="utf-8")
    assert plan_of(str(tmp_path / "mine.toml")).points[0].scenario.name == "yard"
    monkeypatch.chdir(tmp_path)
    assert plan_of("yard.toml", vary=["detections.noise=0,1"], seeds=1).runs == 2


@pytest.mark.parametrize("name", shipped_sweeps())
def test_shipped_sweeps_can_be_flown(name):
    assert name not in scenario_names()
    plan = plan_of(name, seeds=1)
    assert plan.runs == len(plan.points) > 0
    assert {point.law for point in plan.points} >= {"linear", "switching", "logarithmic", "circle"}


def test_tasks_are_every_missing_run_once():
    plan = plan_of(laws="linear", vary=["duration=5,500"], seeds=30)
    done = set(range(0, plan.runs, 7))
    tasks = make_tasks(plan, done, workers=1)
    assert sorted([*done, *(run for task in tasks for run in task.seeds)]) == list(range(plan.runs))
    for task in tasks:
        assert {plan.points[run // 30].scenario for run in task.seeds} == {task.scenario}
        assert all(plan.seed_of(run) == seed for run, seed in task.seeds.items())
    longest: dict[float, int] = {}
    for task in tasks:
        duration = task.scenario.duration
        longest[duration] = max(longest.get(duration, 0), len(task.seeds))
    assert longest[500.0] < longest[5.0]


# Rows


def test_sweep_rows_equal_single_runs_for_any_jobs(tmp_path, small_rows):
    two = flown(tmp_path / "two", plan_of(), jobs=2)
    assert two["run"] == list(range(12))
    for k in (0, 4, 11):
        noise = f"detections.noise={two['detections.noise'][k]}"
        settings = [*QUICK, f"law.name={two['law'][k]}", noise]
        summary = run(load_scenario("escort", overrides=settings), seed=two["seed"][k])
        assert two["trajectory_sha256"][k] == summary.trajectory_sha256
        for name in ("max_distance", "mean_error"):
            assert two[name][k] == getattr(summary, name)
        assert two["margin"][k] == 4.75 - summary.max_distance
        assert two["violated"][k] is (summary.visibility_violations > 0)
        delivered = summary.links["uav_0/detections"].delivery_ratio
        assert two["detections_delivery_ratio"][k] == delivered
    assert set(two["error"]) == {None}
    assert len(set(two["trajectory_sha256"])) == 12
    assert small_rows == two


def test_violations_are_distinguished_from_visible_runs():
    seen = load_scenario("escort", overrides=QUICK)
    lost = load_scenario("figure-1-high-gain", overrides=["duration=80.0", "area.cell=0.5"])
    (good,), (bad,) = fly_runs(seen, {0: 1}), fly_runs(lost, {0: 1})
    assert (good["violated"], good["visibility_violations"]) == (False, 0)
    assert good["margin"] > 0.0 >= bad["margin"]
    assert bad["violated"] is True
    assert bad["visibility_violations"] > 0


def test_sweep_resumes_and_flies_nothing_twice(tmp_path, small_rows):
    plan = plan_of()
    folder = SweepFolder(tmp_path / "cut", plan, command="")
    for first in (0, 4, 5):
        task = {run: plan.seed_of(run) for run in range(first, first + 1)}
        folder.add(fly_runs(plan.points[first // 3].scenario, task))
    folder.close()
    (tmp_path / "cut" / "parts" / "00000009.parquet.unfinished").write_bytes(b"half of it")
    again = SweepFolder(tmp_path / "cut", plan, command="")
    assert again.done == {0, 4, 5}
    new: list[int] = []
    fly_sweep(
        plan, again, jobs=1, on_results=lambda results: new.extend(row["run"] for row in results)
    )
    assert sorted(new) == [1, 2, 3, 6, 7, 8, 9, 10, 11]
    again.finish()
    again.close()
    assert rows_of(tmp_path / "cut") == small_rows
    assert not list((tmp_path / "cut" / "parts").iterdir())


def test_small_files_are_merged_and_duplicate_rows_dropped(tmp_path, monkeypatch):
    monkeypatch.setattr("outrider.experiments.sweep.folder._MOST_PARTS", 5)
    plan = plan_of()
    results = fly_runs(plan.points[0].scenario, {0: 0})
    folder = SweepFolder(tmp_path / "sweep", plan, command="")
    for number in range(11):
        folder.add(
            [{**results[0], "run": number, "error": "ValueError: no" if number == 3 else None}]
        )
    assert parts(folder.path) < 6
    assert (folder.rows, folder.failed) == (11, 1)
    # run 3 was repeated; row 4 is already there
    folder.add([{**results[0], "run": 3}, {**results[0], "run": 4}])
    assert (folder.rows, folder.failed) == (11, 0)
    file = folder.finish()
    folder.close()
    assert file.exists()
    rows = rows_of(folder.path)
    assert rows["run"] == list(range(11))
    assert set(rows["error"]) == {None}


def test_interrupted_and_killed_sweep_resumes(tmp_path, undisturbed, command):
    """First Ctrl-C, then SIGKILL; neither leaves a process, and no run is flown twice."""
    folder = tmp_path / "sweep"
    first = started(*OUTRIDER, *GRID, *LONG, str(folder), stdout=subprocess.PIPE)
    wait_for(lambda: parts(folder) >= 1, first)
    workers = [pid for pid in _session(first.pid) if "--multiprocessing-fork" in command_line(pid)]
    # otherwise one may show where it was interrupted
    blocking = [blocks(pid, signal.SIGINT) for pid in workers]
    os.killpg(first.pid, signal.SIGINT)  # like a terminal: also to the workers
    out, err = first.communicate(timeout=60)
    assert blocking == [True, True]
    assert first.returncode == 130, err
    assert out == ""
    kept = len(rows_of(folder)["run"])
    wanted = f"{kept} of {RUNS} runs are in {folder}; run the same command to resume"
    assert err.strip() == f"outrider: interrupted; {wanted}"
    wait_until(lambda: not _session(first.pid))
    before = parts(folder)
    victim = started(*OUTRIDER, *GRID, *LONG, str(folder), stdout=subprocess.DEVNULL)
    wait_for(lambda: parts(folder) > before, victim)
    victim.kill()
    victim.wait()
    wait_until(lambda: not _session(victim.pid))
    victim.communicate()
    kept = len(rows_of(folder)["run"])
    assert 0 < kept < RUNS
    assert not (folder / "results.parquet").exists()
    again = command(*GRID, *LONG, folder, "--jobs", "1")
    assert again.returncode == 0, again.stderr
    output = json.loads(again.stdout)
    assert (output["rows"], output["failed"], output["flown"]) == (RUNS, 0, RUNS - kept)
    assert output["runs_per_second"] > 0.0
    assert rows_of(folder) == undisturbed


def _session(number: int) -> list[int]:
    """Return the live processes of a session."""
    found = []
    for pid in (int(entry.name) for entry in Path("/proc").iterdir() if entry.name.isdigit()):
        with suppress(OSError):  # it may just have ended
            state, _, _, session, *_ = stat_of(pid)
            found += [pid] if int(session) == number and state != "Z" else []
    return found


def test_failed_run_is_a_row_with_its_error(here, command, monkeypatch):
    (here / "loose_wheel.py").write_text(
        "def policy(observation, briefing):\n"
        "    if int(briefing.key, 16) % 2 and observation.time > 2.0:\n"
        "        raise RuntimeError('the wheel came off')\n"
        "    return 0.0, 0.0\n",
        encoding="utf-8",
    )
    mine = words("--vary custom.policy=loose_wheel:policy --set ugv.0.driver=policy --set")
    rest = words("duration=5 --seeds 6 --jobs 1 --out out --json")
    arguments = ["sweep", "escort", "--set", CELLS, *mine, *rest]
    swept = command(*arguments)
    assert swept.returncode == 1, swept.stderr
    output = json.loads(swept.stdout)
    assert output["rows"] == 6
    assert 0 < output["failed"] < 6
    assert f"{output['failed']} of 6 runs failed" in swept.stderr
    assert "the wheel came off" in swept.stderr
    rows = rows_of(here / "out")
    flew = [sha is not None for sha in rows["trajectory_sha256"]]
    assert [error is None for error in rows["error"]] == flew
    (here / "loose_wheel.py").write_text(
        "def policy(observation, briefing):\n    return 0.0, 0.0\n", encoding="utf-8"
    )
    monkeypatch.delitem(sys.modules, "loose_wheel")
    mended = command(*arguments)
    assert mended.returncode == 0, mended.stderr
    assert json.loads(mended.stdout)["flown"] == output["failed"]
    assert set(rows_of(here / "out")["error"]) == {None}


# A cluster


def test_cluster_flies_the_same_rows(tmp_path, small_rows):
    """The workers are threads of this process."""
    from distributed import LocalCluster

    plan, here = plan_of(), version("outrider")
    with (
        LocalCluster(
            n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None
        ) as cluster,
        open_cluster(cluster.scheduler_address, here) as client,
        SweepFolder(tmp_path / "far", plan, command="") as folder,
    ):
        fly_sweep(plan, folder, jobs=2, client=client)
        folder.finish()
    assert rows_of(tmp_path / "far") == small_rows


@pytest.mark.long
def test_cluster_survives_a_dead_worker_with_the_same_rows(undisturbed, tmp_path):
    from distributed import Client

    info = tmp_path / "scheduler.json"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "start_new_session": True}
    common = ["--scheduler-file", str(info), "--host", "127.0.0.1", "--no-dashboard"]
    alone = ["--no-nanny", "--nthreads", "1", "--local-directory", str(tmp_path)]

    def dask(what: str, *arguments: str) -> "subprocess.Popen[str]":
        code = f"from distributed.cli.dask_{what} import main; main()"
        return subprocess.Popen([sys.executable, "-c", code, *common, *arguments], **quiet)

    processes = [dask("scheduler", "--port", "0")]
    try:
        wait_for(info.exists, processes[0])
        processes += [dask("worker", *alone) for _ in range(2)]
        address = json.loads(info.read_text())["address"]
        with Client(address, timeout=60) as client:
            client.wait_for_workers(2, timeout=60)
        command = [*OUTRIDER, *GRID, "--dask", address, *LONG]
        sweep = subprocess.Popen([*command, str(tmp_path / "far")], **PIPES)
        wait_for(lambda: parts(tmp_path / "far") >= 2, sweep)
        processes[1].kill()
        out, err = sweep.communicate(timeout=100)
        assert sweep.returncode == 0, err
        assert json.loads(out)["rows"] == RUNS
    finally:
        for process in processes:
            process.kill()
            process.wait()
    assert rows_of(tmp_path / "far") == undisturbed


def test_no_cluster_is_one_line(monkeypatch):
    monkeypatch.setattr("outrider.experiments.sweep.running._CONNECT", 0.5)
    with (
        pytest.raises(PeerLost, match="no scheduler found") as caught,
        open_cluster("tcp://127.0.0.1:1", "1.0"),
    ):
        pass
    assert len(str(caught.value).splitlines()) == 1


# Refusals

GIVEN = {
    "unknown law": ({"laws": "linear,fancy"}, 'law.name = "fancy"'),
    "a law twice": ({"laws": "linear,linear"}, "a repeated law"),
    "no law": ({"laws": "linear,"}, 'law.name = ""'),
    "unknown field": ({"vary": ["links.detections.dealy=0,1"]}, "links.detections.dealy"),
    "impossible value": ({"vary": ["detections.dropout=0.5,1.5"]}, "detections.dropout = 1.5"),
    "no values": ({"vary": ["dt="]}, "no values"),
    "an empty value": ({"vary": ["dt=0.1,,0.2"]}, "a value is empty"),
    "no field": ({"vary": ["0.1,0.2"]}, "field=value,value"),
    "a value twice": ({"vary": ["dt=0.1,0.1"]}, "a repeated value"),
    "a field twice": ({"vary": ["dt=0.1", "dt=0.2"]}, "varied already"),
    "the seed": ({"vary": ["seed=1,2"]}, "--seeds"),
    "the law": ({"vary": ["law.name=linear"]}, "--law"),
    "bad override": ({"changes": ["nonsense"]}, "nonsense"),
    "another process": ({"changes": ["ugv.0.driver=external"]}, "external"),
}


@pytest.mark.parametrize("case", GIVEN)
def test_invalid_sweep_is_refused_in_one_line(case):
    given, phrase = GIVEN[case]
    assert phrase in refusal(**given)


FILES = {
    "unknown field": ("scenaro = 'escort'", "scenaro"),
    "unknown field of a block": ("[[block]]\nvry.dt = [0.1]", "block.0.vry"),
    "empty list": ("vary.dt = []", "vary.dt = []: empty"),
    "no list": ("vary.dt = 0.1", "vary.dt = 0.1: not a list"),
    "no laws": ("laws = []", "laws = []"),
    "no seeds": ("seeds = 0", "seeds = 0"),
    "both": (
        "vary.dt = [0.1]\n[[block]]\nvary.command_timeout = [0.1]",
        "either [vary] or [[block]]",
    ),
    "two of a name": ("[[block]]\nvary.dt = [0.1]\n[[block]]\nvary.dt = [0.05]", "block.1.name"),
    "no toml": ("laws = [", "not TOML"),
    "unknown scenario": ("scenario = 'escrot'", "escrot"),
}


@pytest.mark.parametrize("case", FILES)
def test_invalid_sweep_file_is_refused_in_one_line(case, tmp_path):
    text, phrase = FILES[case]
    (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
    line = refusal(str(tmp_path / "mine.toml"))
    assert phrase in line
    if case != "unknown scenario":
        assert "mine.toml" in line


def test_an_unknown_sweep_names_the_known_ones():
    line = refusal("netwrok")
    assert "did you mean 'network'" in line
    assert "escort" in line


def test_sweep_with_its_own_variation_refuses_vary():
    assert "--vary" in refusal("network", vary=["dt=0.1"])


def test_folder_of_another_sweep_needs_fresh(tmp_path, monkeypatch):
    plan = plan_of()
    folder = SweepFolder(tmp_path / "sweep", plan, command="")
    folder.add(fly_runs(plan.points[0].scenario, {0: 0}))
    folder.close()
    other = plan_of(laws="linear", vary=["detections.noise=0,0.5"], changes=QUICK, seeds=3)
    with pytest.raises(ScenarioError, match=r"holds another sweep.*--fresh"):
        SweepFolder(tmp_path / "sweep", other, command="")
    monkeypatch.setattr("outrider.experiments.sweep.plan.version", lambda _name: "9.9")
    with pytest.raises(ScenarioError, match=r"made by Outrider .*, this is 9\.9.*--fresh"):
        SweepFolder(tmp_path / "sweep", plan_of(), command="")
    fresh = SweepFolder(tmp_path / "sweep", other, command="", fresh=True)
    assert fresh.rows == 0
    with pytest.raises(ScenarioError, match="in use by another sweep"):
        SweepFolder(tmp_path / "sweep", other, command="")
    fresh.close()


def test_a_folder_with_other_files_is_left_alone_even_by_fresh(tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work", encoding="utf-8")
    for fresh in (False, True):
        with pytest.raises(ScenarioError, match="not a sweep's folder"):
            SweepFolder(tmp_path, plan_of(), command="", fresh=fresh)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


@pytest.mark.parametrize("content", [b"", b"PAR1 and then nothing", "another table"])
def test_a_damaged_part_is_named_with_what_to_do(tmp_path, content):
    import pyarrow as pa
    import pyarrow.parquet as pq

    plan = plan_of()
    folder = SweepFolder(tmp_path / "sweep", plan, command="")
    folder.add(fly_runs(plan.points[0].scenario, {0: 0}))
    folder.close()
    part = tmp_path / "sweep" / "parts" / "00000001.parquet"
    if isinstance(content, bytes):
        part.write_bytes(content)
    else:
        pq.write_table(pa.table({"run": [1]}), part)
    with refused(ScenarioError, r"00000001\.parquet: .*; delete the file to fly its runs again"):
        SweepFolder(tmp_path / "sweep", plan, command="")
    part.unlink()
    SweepFolder(tmp_path / "sweep", plan, command="").close()


def test_laws_of_a_repeated_option_are_joined(here, command) -> None:
    words_ = ("sweep", "escort", "--law", "linear", "--law", "switching", "--seeds", "1")
    flown = command(*words_, "--duration", "0.5", "--jobs", "1", "--out", "joined", "--json")
    assert flown.returncode == 0, flown.stderr
    head = read_head(here / "joined")
    assert head is not None
    assert head.sweep.laws == ("linear", "switching")
