"""`make bench`: rows with their limits as a JSON list."""

import importlib
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parent.parent / "benchmarks"
if not FOLDER.is_dir():
    pytest.skip("a copy of the core alone has no benchmarks", allow_module_level=True)


def bench(results: Path, *rows: str) -> "subprocess.CompletedProcess[str]":
    """Measure rows, shorter than `make bench` does."""
    settings = ("-c", FOLDER / "pytest.ini", "--benchmark-max-time", "0.01")
    tests = [f"{FOLDER / 'test_speed.py'}::test_{row}" for row in rows]
    command = [sys.executable, "-m", "pytest", *settings, "--benchmark-json", results, *tests]
    # pytest-benchmark measures nothing in what it takes for a worker of xdist
    environment = {name: text for name, text in os.environ.items() if "XDIST" not in name}
    return subprocess.run(command, capture_output=True, check=False, env=environment, text=True)


def test_rows_have_value_limit_and_ratio(tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    done = bench(path, "world_step", "env_step")
    assert done.returncode == 0, done.stdout
    rows = json.loads(path.read_text(encoding="utf-8"))
    assert [row["name"] for row in rows] == ["world_step", "env_step"]
    for row in rows:
        assert list(row) == ["name", "value", "unit", "limit", "ratio"]
        assert row["unit"] == "steps/s"
        assert row["ratio"] == pytest.approx(row["value"] / row["limit"])
        assert row["ratio"] > 0.0


def test_a_start_has_no_limit(tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    assert bench(path, "warm_start").returncode == 0
    (row,) = json.loads(path.read_text(encoding="utf-8"))
    assert (row["name"], row["unit"], row["limit"], row["ratio"]) == ("warm_start", "s", None, None)
    assert row["value"] > 0.0


def test_an_unknown_row_is_refused(tmp_path: Path) -> None:
    done = bench(tmp_path / "results.json", "nothing")
    assert done.returncode == 4
    assert "test_nothing" in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_the_bare_exchange_has_a_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(FOLDER))
    assert importlib.import_module("bare_exchange").ticks_per_second(20) > 0.0
