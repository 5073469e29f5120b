"""The comparison with other packages: its table, what it says of a result, and what becomes of a peer that fails."""

import argparse
import importlib
import json
import sys
import time
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

FOLDER = Path(__file__).resolve().parent.parent / "benchmarks" / "peers"
if not FOLDER.is_dir():
    pytest.skip("a copy of the core alone has no benchmarks", allow_module_level=True)
GIVEN = argparse.Namespace(seconds=0.01, repeats=1)
FAKE = """
import json, sys
print("a greeting")
print(json.dumps({"name": "Fake", "variant": "task", "worlds": 1, "agents": 2, "field": False, "version": "1",
                  "steps_per_second": 5.0, "slowest": 4.0, "fastest": 6.0}), flush=True)
print(json.dumps({"name": "Fake", "variant": "task", "worlds": 32, "agents": 2, "field": False, "version": "1",
                  "error": "MemoryError: too much"}), flush=True)
raise OSError("no /somewhere/on/this/machine/libfake.so at https://example.org/simple")
"""


@pytest.fixture
def load(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(FOLDER))
    return importlib.import_module


def runner(folder: Path, text: str) -> Path:
    (folder / "runners").mkdir()
    (folder / "runners" / "fake.py").write_text(text, encoding="utf-8")
    return folder


def row(module: ModuleType, peer: str, worlds: int, rate: float, **other: Any) -> Any:
    told = {"name": peer.title(), "variant": "task", "agents": 2, "field": True, "version": "1.0"}
    rates = {"steps_per_second": rate, "slowest": 0.9 * rate, "fastest": 1.1 * rate}
    return module.Row(peer=peer, worlds=worlds, **rates, **(told | other))


def made_up(module: ModuleType, *rows: Any, failures: tuple[Any, ...] = ()) -> Any:
    on = {"date": "2026-01-01", "cpu": "a CPU", "cores": 2, "python": "3.11.0"}
    on |= {"seconds": 3.0, "repeats": 3}
    return module.Report(rows=list(rows), failures=list(failures), **on)


def test_every_row_has_a_runner_that_compiles_and_every_runner_has_a_row(load: Any) -> None:
    peers = load("peers").PEERS
    files = {path.stem for path in (FOLDER / "runners").glob("*.py")} - {"__init__", "clock"}
    assert set(peers) == files
    for name in peers:
        text = (FOLDER / "runners" / f"{name}.py").read_text(encoding="utf-8")
        compile(text, name, "exec")
        assert "from runners.clock import" in text  # all count alike


def test_requirements_have_an_upper_and_a_lower_bound(load: Any) -> None:
    for requirements in load("peers").PEERS.values():
        assert all(">=" in requirement and "<" in requirement for requirement in requirements)


def test_a_step_of_every_world_counts_one(load: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = load("runners.clock")
    ticks = iter(range(100_000))
    monkeypatch.setattr(clock.time, "perf_counter", lambda: 0.01 * next(ticks))
    made = clock.Variant(
        name="task", worlds=4, agents=2, field=True, steps=3, make=lambda: lambda: None
    )
    assert clock.measure(made, 1.0, 3)["steps_per_second"] == pytest.approx(100.0 * 4 * 3)


def test_our_own_work_is_not_taken_for_that_of_others(load, monkeypatch):
    clock = load("runners.clock")
    hertz = clock.os.sysconf("SC_CLK_TCK")
    now = iter([(0.0, 0.0), (7.0 * hertz, 10.0 * hertz)])  # 7 s of 10 s busy
    own = iter([100.0, 105.0])
    monkeypatch.setattr(clock, "_cores", lambda: next(now))
    monkeypatch.setattr(clock.time, "process_time", lambda: next(own))
    assert clock.Watch().others() == pytest.approx(0.2)


def test_words_say_where_a_peer_is_faster(load: Any) -> None:
    report = load("peer_report")
    rates = [("outrider", 1, 1000.0), ("near", 1, 1050.0), ("slow", 1, 999.0)]
    rates += [("fast", 32, 5000.0), ("outrider", 1024, 9000.0), ("slow", 1024, 10.0)]
    fast = row(report, "fast", 1, 2500.0, field=False)
    words = report.where_faster(made_up(report, fast, *(row(report, *told) for told in rates)))
    assert words == [
        "At 1 world Fast task, 2 agents, without a field, is 2.5 times as fast as Outrider task.",
        "At 1 world Near task, 2 agents, is 1.05 times as fast as Outrider task, within the spread of the repeats.",
        "At 32 worlds there is no row of ours to compare with.",
        "At 1024 worlds no peer is faster than ours.",
    ]


def test_results_are_written_with_both_groups_failures_and_noise(load: Any, tmp_path: Path) -> None:
    report = load("peer_report")
    ours = row(report, "outrider", 1, 1000.0, others=0.5)
    peer = row(report, "fast", 1, 2500.0, field=False)
    failure = report.Failure(what="gone", reason="No matching distribution | found")
    report.write(made_up(report, ours, peer, failures=(failure,)), tmp_path)
    text = (tmp_path / "peers.md").read_text(encoding="utf-8")
    parts = ("## With a field", "| Outrider ", "## Without a field", "| Fast ")
    places = [text.index(part) for part in parts]
    assert places == sorted(places)
    assert "| gone | No matching distribution \\| found |" in text
    assert "Not quiet" in text
    assert "up to 50% of the cores" in text
    rows = json.loads((tmp_path / "peers.json").read_bytes())["rows"]
    assert rows[1]["steps_per_second"] == 2500.0
    assert (tmp_path / "peers.png").read_bytes().startswith(b"\x89PNG")


def test_a_runner_that_fails_becomes_a_row_with_its_reason(load: Any, tmp_path: Path) -> None:
    folder = runner(tmp_path, FAKE)
    rows, failures = load("peers").measure("fake", Path(sys.executable), GIVEN, cwd=folder)
    (found,) = rows
    assert (found.label, found.steps_per_second) == ("Fake task, 2 agents", 5.0)
    assert [(failure.what, failure.reason) for failure in failures] == [
        ("Fake task, 32 worlds", "MemoryError: too much"),
        ("fake", "OSError: no libfake.so at (address)"),
    ]


def test_a_runner_that_prints_nothing_is_said(load: Any, tmp_path: Path) -> None:
    rows, failures = load("peers").measure(
        "fake", Path(sys.executable), GIVEN, cwd=runner(tmp_path, "")
    )
    assert not rows
    assert failures[0].reason == "its runner printed nothing"


def test_what_takes_too_long_is_ended_with_all_it_has_started(load: Any, tmp_path: Path) -> None:
    processes = load("peer_processes")
    child = "import time; time.sleep(60)"
    command = [
        sys.executable,
        "-c",
        f"import subprocess, sys; subprocess.run([sys.executable, '-c', {child!r}])",
    ]
    started = time.monotonic()
    with pytest.raises(processes.Failed, match="not finished after"):
        processes.run(command, cwd=tmp_path, deadline=0.3)
    # the child holds our pipe: while it lives, nothing comes back
    assert time.monotonic() - started < 30.0


def test_only_a_whole_environment_with_the_same_requirements_is_used_again(load, tmp_path):
    venvs = load("peer_venvs")
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "python").touch()
    assert not venvs.is_whole(tmp_path, ("a>=1,<2",))  # pip did not come to its end
    (tmp_path / venvs.STAMP).write_text(venvs.stamp_of(("a>=1,<2",)), encoding="utf-8")
    assert venvs.is_whole(tmp_path, ("a>=1,<2",))
    assert not venvs.is_whole(tmp_path, ("a>=2,<3",))


def test_torch_for_cuda_is_refused_unless_asked_for(load, tmp_path, monkeypatch):
    venvs = load("peer_venvs")
    installed: list[tuple[str, ...]] = []

    def pip(folder: Path, *arguments: str) -> None:
        if "--report" in arguments:
            wanted = ("torch", "nvidia-cublas")
            plan = {"install": [{"metadata": {"name": name}} for name in wanted]}
            (folder / "plan.json").write_text(json.dumps(plan), encoding="utf-8")
        else:
            installed.append(arguments)

    monkeypatch.setattr(venvs, "_pip", pip)
    monkeypatch.setattr(venvs, "run", lambda command, **_: Path(command[-1]).mkdir())
    with pytest.raises(venvs.Failed, match="CUDA"):
        venvs.provide(tmp_path / "venv", ("vmas>=1", "torch>=2"))
    assert not installed
    venvs.provide(tmp_path / "venv", ("vmas>=1", "torch>=2"), cuda=True)
    assert installed == [("install", "vmas>=1", "torch>=2")]
