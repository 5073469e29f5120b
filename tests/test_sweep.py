"""Sweeps: each run is a row despite interruptions; invalid input is one line before the first run."""

import itertools
import json
import math
import os
import re
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
from pages import PAGES, ROOT
from processes import OUTRIDER, PIPES, stat_of, wait_until
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
GRID = [
    *words("sweep escort --law linear --law switching --vary detections.noise=0,0.5 --set"),
    CELLS,
]

LONG = words("--seeds 12 --set duration=10.0 --jobs 2 --json --out")


def plan_of(source: str = "escort", **given) -> SweepPlan:
    return lay_out(describe_sweep(source, **(given or (SMALL if source == "escort" else {})))[0])


LONG_PLAN = plan_of(**SMALL | {"changes": [CELLS, "duration=10.0"], "seeds": 12})


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
    return flown(tmp_path_factory.mktemp("sweep") / "whole", LONG_PLAN)


@pytest.fixture(scope="module")
def small_rows(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[object]]:
    """Return the table of the small sweep, flown in this process."""
    return flown(tmp_path_factory.mktemp("sweep") / "small", plan_of())


def wait_for(there: Callable[[], bool], process: "subprocess.Popen[str]") -> None:
    def came() -> bool:
        assert process.poll() is None, process.communicate()
        return there()

    wait_until(came, 60.0)


def stored(folder: Path) -> int:
    """Return the number of complete lines of an unfinished sweep."""
    rows = folder / "results.jsonl"
    return rows.read_bytes().count(b"\n") if rows.exists() else 0


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
    varied = words("ugv.0.driver=evade,wander estimator.enabled=true,false links.profile=wifi,lte")
    plan = plan_of(vary=[*varied, "ugv.0.goals=[[1, 2]],[[3.5, 4]]"], laws="linear", seeds=1)
    assert plan.columns["ugv.0.driver"] == plan.columns["ugv.0.goals"] == "string"
    assert plan.columns["estimator.enabled"] == "bool"
    last = plan.head(plan.runs - 1)
    fields = ("ugv.0.driver", "estimator.enabled", "links.profile", "ugv.0.goals")
    assert [last[field] for field in fields] == ["wander", False, "lte", "[[3.5,4.0]]"]
    assert plan.points[-1].scenario.links.commands == PROFILES["lte"]


def test_team_sizes_can_be_varied() -> None:
    plan = plan_of("scouts", vary=["uav.count=1,3"], seeds=1)
    assert [len(point.scenario.uav) for point in plan.points] == [1, 3]
    assert [plan.head(run)["uav.count"] for run in (0, 1)] == [1.0, 3.0]
    assert {"team_certified_share", "handovers"} <= plan.columns.keys()


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


def test_sweep_resumes_and_flies_nothing_twice(tmp_path, small_rows):
    plan = plan_of()
    with SweepFolder(tmp_path / "cut", plan, command="") as folder:
        for run in (0, 4, 5):
            folder.add(fly_runs(plan.points[run // 3].scenario, {run: plan.seed_of(run)}))
    (tmp_path / "cut" / "results.parquet.unfinished").write_bytes(b"half of it")
    new: list[int] = []
    with SweepFolder(tmp_path / "cut", plan, command="", on_notice=pytest.fail) as again:
        assert again.done == {0, 4, 5}
        fly_sweep(plan, again, jobs=1, on_results=lambda rows: new.extend(r["run"] for r in rows))
        again.finish()
    assert sorted(new) == [1, 2, 3, 6, 7, 8, 9, 10, 11]
    assert rows_of(tmp_path / "cut") == small_rows
    assert sorted(path.name for path in (tmp_path / "cut").iterdir()) == [
        ".lock",
        "results.parquet",
        "sweep.json",
    ]


def test_a_repeated_run_replaces_its_failed_row(tmp_path):
    plan = plan_of()
    (row,) = fly_runs(plan.points[0].scenario, {0: 0})
    with SweepFolder(tmp_path / "sweep", plan, command="") as folder:
        for number in range(11):
            margin = math.inf if number == 2 else 0.1 + 0.2
            error = "no" if number == 3 else None
            folder.add([{**row, "run": number, "error": error, "margin": margin}])
        assert (folder.rows, folder.failed) == (11, 1)
        folder.finish()
        # run 3 was repeated; row 4 is already there
        folder.add([{**row, "run": 3}, {**row, "run": 4}])
        assert (folder.rows, folder.failed) == (11, 0)
        unfinished = rows_of(folder.path)
        folder.finish()
    rows = rows_of(folder.path)
    assert rows["run"] == list(range(11))
    assert set(rows["error"]) == {None}
    assert rows["margin"][:3] == [0.1 + 0.2, 0.1 + 0.2, math.inf]
    assert rows == unfinished


@pytest.mark.parametrize(
    "cut",
    [b"", b"{", b'{"run": 5, "bl', b"\0" * 100, b'{"run": \xff\n', b"[]\n"],
    ids=["end", "brace", "half", "zeros", "no text", "no row"],
)
def test_a_damaged_last_line_is_skipped_and_its_run_repeated(tmp_path, small_rows, cut):
    plan, notices = plan_of(), list[str]()
    with SweepFolder(tmp_path / "cut", plan, command="") as folder:
        for run in (0, 4):
            folder.add(fly_runs(plan.points[run // 3].scenario, {run: plan.seed_of(run)}))
    file = folder.path / "results.jsonl"
    content = file.read_bytes()
    file.write_bytes(content + cut if cut else content[:-1])
    head = read_head(folder.path)
    assert head is not None
    read = read_results(folder.path, head.columns, notices.append)["run"]
    with SweepFolder(folder.path, plan, command="", on_notice=notices.append) as again:
        assert again.done == set(read) == ({0, 4} if cut else {0})
        assert len(notices) == 2
        assert all("results.jsonl: damaged last line skipped" in line for line in notices)
        fly_sweep(plan, again, jobs=1)
        again.finish()
    assert rows_of(folder.path) == small_rows
    assert len(notices) == 2


def test_interrupted_and_killed_sweep_resumes(tmp_path, undisturbed, command):
    """First Ctrl-C, then SIGKILL; neither leaves a process, and no run is flown twice."""
    folder = tmp_path / "sweep"
    swept = [*OUTRIDER, *GRID, *LONG, str(folder)]
    first = subprocess.Popen(swept, start_new_session=True, **PIPES)
    wait_for(lambda: stored(folder) >= 1, first)
    os.killpg(first.pid, signal.SIGINT)  # like a terminal: also to the workers
    out, err = first.communicate(timeout=60)
    assert first.returncode == 130, err
    assert out == ""
    kept = len(rows_of(folder)["run"])
    wanted = f"{kept} of {LONG_PLAN.runs} runs are in {folder}; run the same command to resume"
    assert err.strip() == f"outrider: interrupted; {wanted}"
    wait_until(lambda: not _session(first.pid))
    before = stored(folder)
    victim = subprocess.Popen(swept, start_new_session=True, **PIPES)
    wait_for(lambda: stored(folder) > before, victim)
    victim.kill()
    victim.communicate()
    wait_until(lambda: not _session(victim.pid))
    kept = len(rows_of(folder)["run"])
    assert 0 < kept < LONG_PLAN.runs
    assert not (folder / "results.parquet").exists()
    again = command(*GRID, *LONG, folder, "--jobs", "1")
    assert again.returncode == 0, again.stderr
    output = json.loads(again.stdout)
    assert (output["rows"], output["failed"], output["flown"]) == (
        LONG_PLAN.runs,
        0,
        LONG_PLAN.runs - kept,
    )
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


def test_cluster_flies_the_same_rows(tmp_path, small_rows, command):
    """The workers are threads of this process."""
    from distributed import LocalCluster  # noqa: PLC0415 - an extra

    changes = words("duration=5.0 --seeds 3 --jobs 2 --out")
    with LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None
    ) as cluster:
        address = cluster.scheduler_address
        swept = command(*GRID, "--dask", address, "--set", *changes, tmp_path / "far")
    assert swept.returncode == 0, swept.stderr
    assert rows_of(tmp_path / "far") == small_rows


@pytest.mark.long
def test_cluster_survives_a_dead_worker_with_the_same_rows(undisturbed, tmp_path):
    from distributed import LocalCluster  # noqa: PLC0415 - an extra

    with (
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        open_cluster(cluster.scheduler_address, version("outrider")) as client,
        SweepFolder(tmp_path / "far", LONG_PLAN, command="") as folder,
    ):
        victims = list(client.run(os.getpid).values())[:1]

        def kill(_results: object) -> None:
            while victims:
                os.kill(victims.pop(), signal.SIGKILL)

        fly_sweep(LONG_PLAN, folder, jobs=2, client=client, on_results=kill)
        folder.finish()
    assert not victims
    assert rows_of(tmp_path / "far") == undisturbed


def test_no_cluster_is_one_line(monkeypatch):
    monkeypatch.setattr("outrider.experiments.sweep.running._CONNECT", 0.5)
    with refused(PeerLost, "no scheduler found"), open_cluster("tcp://127.0.0.1:1", "1.0"):
        pass


# Refusals

REFUSED = [
    ({"laws": "linear,fancy"}, 'law.name = "fancy"'),
    ({"laws": "linear,linear"}, "a repeated law"),
    ({"laws": "linear,"}, 'law.name = ""'),
    ({"vary": ["links.detections.dealy=0,1"]}, "links.detections.dealy"),
    ({"vary": ["detections.dropout=0.5,1.5"]}, "detections.dropout = 1.5"),
    ({"vary": ["dt="]}, "no values"),
    ({"vary": ["dt=0.1,,0.2"]}, "a value is empty"),
    ({"vary": ["0.1,0.2"]}, "field=value,value"),
    ({"vary": ["dt=0.1,0.1"]}, "a repeated value"),
    ({"vary": ["dt=0.1", "dt=0.2"]}, "varied already"),
    ({"vary": ["seed=1,2"]}, "--seeds"),
    ({"vary": ["law.name=linear"]}, "--law"),
    ({"changes": ["nonsense"]}, "nonsense"),
    ({"changes": ["ugv.0.driver=external"]}, "external"),
    ({"source": "network", "vary": ["dt=0.1"]}, "--vary"),
    ({"source": "netwrok", "seeds": 1}, "did you mean 'network'"),
]


@pytest.mark.parametrize(("given", "phrase"), REFUSED)
def test_invalid_sweep_is_refused_in_one_line(given, phrase):
    with refused(ScenarioError, re.escape(phrase)):
        plan_of(**given)


@pytest.mark.parametrize(
    ("text", "phrase"),
    [
        ("scenaro = 'escort'", "scenaro"),
        ("[[block]]\nvry.dt = [0.1]", "block.0.vry"),
        ("vary.dt = []", "vary.dt = []: empty"),
        ("vary.dt = 0.1", "vary.dt = 0.1: not a list"),
        ("laws = []", "laws = []"),
        ("seeds = 0", "seeds = 0"),
        (f"first_seed = {2**53 - 1}\nseeds = 2", "first_seed = 9007199254740991"),
        ("vary.dt = [1]\n[[block]]\nvary.command_timeout = [1]", "either [vary] or [[block]]"),
        ("[[block]]\nvary.dt = [0.1]\n[[block]]\nvary.dt = [0.05]", "block.1.name"),
        ("laws = [", "not TOML"),
    ],
)
def test_invalid_sweep_file_is_refused_in_one_line(text, phrase, tmp_path):
    (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
    with refused(ScenarioError, rf"mine\.toml.*{re.escape(phrase)}"):
        plan_of(str(tmp_path / "mine.toml"))


def test_folder_of_another_sweep_needs_fresh(tmp_path, monkeypatch):
    plan = plan_of()
    with SweepFolder(tmp_path / "sweep", plan, command="") as folder:
        folder.add(fly_runs(plan.points[0].scenario, {0: 0}))
    other = plan_of(laws="linear", vary=["detections.noise=0,0.5"], changes=QUICK, seeds=3)
    with pytest.raises(ScenarioError, match=r"holds another sweep.*--fresh"):
        SweepFolder(tmp_path / "sweep", other, command="")
    monkeypatch.setattr("outrider.experiments.sweep.plan.version", lambda _name: "9.9")
    with pytest.raises(ScenarioError, match=r"made by Outrider .*, this is 9\.9.*--fresh"):
        SweepFolder(tmp_path / "sweep", plan_of(), command="")
    with SweepFolder(tmp_path / "sweep", other, command="", fresh=True) as fresh:
        assert fresh.rows == 0
        with pytest.raises(ScenarioError, match="in use by another sweep"):
            SweepFolder(tmp_path / "sweep", other, command="")


def test_a_folder_with_other_files_is_left_alone_even_by_fresh(tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work", encoding="utf-8")
    for fresh in (False, True):
        with pytest.raises(ScenarioError, match="not a sweep's folder"):
            SweepFolder(tmp_path, plan_of(), command="", fresh=fresh)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


@pytest.mark.parametrize(
    "change",
    [
        {"columns": {"run": "no type"}},
        {"columns": {"run": "int64"}},
        {"sweep": {"block": [{"name": "a", "vary": {"nowhere": [1]}}]}},
        {"command": None},
        b'{"a":' * 100_000,
        b"\xff",
    ],
)
def test_a_hostile_head_is_one_line(tmp_path, change):
    with SweepFolder(tmp_path / "sweep", plan_of(), command=""):
        pass
    head = tmp_path / "sweep" / "sweep.json"
    known = json.loads(head.read_text(encoding="utf-8"))
    head.write_bytes(change if isinstance(change, bytes) else json.dumps(known | change).encode())
    with refused(ScenarioError, r"sweep\.json: damaged: .*; start again with --fresh"):
        read_head(tmp_path / "sweep")


@pytest.mark.parametrize("content", [b"", b"PAR1 and then nothing", "another table"])
def test_damaged_results_are_named_with_what_to_do(tmp_path, content):
    import pyarrow as pa  # noqa: PLC0415 - an extra
    import pyarrow.parquet as pq  # noqa: PLC0415 - an extra

    with SweepFolder(tmp_path / "sweep", plan_of(), command=""):
        pass
    results = tmp_path / "sweep" / "results.parquet"
    if isinstance(content, bytes):
        results.write_bytes(content)
    else:
        pq.write_table(pa.table({"run": [1]}), results)
    with refused(ScenarioError, r"results\.parquet: .*; delete the file to fly its runs again"):
        SweepFolder(tmp_path / "sweep", plan_of(), command="")


@pytest.mark.parametrize(
    "change",
    [
        b'{"run": 1, "blo\n',
        b"\xff\n",
        b"[" * 100_000 + b"\n",
        b"x" * (1 << 21) + b"\n",
        b"[]\n",
        b'{"run": 1}\n',
        {"run": None},
        {"run": 1e9},
        {"run": 10**30},
        {"error": 5},
        {"max_distance": "far"},
        {"extra": 1},
    ],
    ids=[
        "half",
        "no text",
        "nested",
        "long",
        "list",
        "columns",
        "no run",
        "real run",
        "huge run",
        "error",
        "text",
        "extra",
    ],
)
def test_a_hostile_row_is_one_line(tmp_path, change):
    plan = plan_of()
    with SweepFolder(tmp_path / "sweep", plan, command="") as folder:
        folder.add(fly_runs(plan.points[0].scenario, {0: 0}))
    file = tmp_path / "sweep" / "results.jsonl"
    row = file.read_bytes()
    other = change if isinstance(change, bytes) else json.dumps(json.loads(row) | change).encode()
    file.write_bytes(other.rstrip(b"\n") + b"\n" + row)
    with refused(ScenarioError, r"results\.jsonl: damaged: .*; delete the file to fly its runs"):
        SweepFolder(tmp_path / "sweep", plan, command="")
    file.unlink()
    SweepFolder(tmp_path / "sweep", plan, command="").close()


def test_the_page_on_robustness_counts_its_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    sweeps = "commands", "network", "examples/networks/sweep.toml"
    runs = sum(lay_out(describe_sweep(source, seeds=10)[0]).runs for source in sweeps)
    page = " ".join(PAGES["docs/explanation/robustness.md"].split())
    assert f"{runs:,} runs with ten seeds" in page
