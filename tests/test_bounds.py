"""Files of unknown origin: they neither fill the memory, nor block the reader, nor load code without permission."""

import os
import struct
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from bus.credentials import read_credential
from bus.errors import AccessDenied, ScenarioError
from bus.files import read_regular
from outrider.cli.console import print_warnings
from outrider.experiments.sweep.definition import describe_sweep
from outrider.experiments.sweep.plan import lay_out
from outrider.running.flying import run
from outrider.running.user_code import foreign_code
from processes import python
from refusals import SMALL
from sim.scenario.loading import load_scenario, scenario_names, shipped_text

pytest.importorskip("mcap", reason="the extra [record] is not installed")
zstandard = pytest.importorskip("zstandard", reason="the extra [record] is not installed")


MAGIC = b"\x89MCAP0\r\n"
EMPTY = struct.pack("<BQHIQQ", 5, 22, 1, 0, 0, 0)
"""A message of zero bytes."""


def zeros(size: int, *, sized: bool) -> bytes:
    """Return a zstd frame of zeros, with or without its size in the header."""
    packer = zstandard.ZstdCompressor(level=1, write_content_size=sized).compressobj(
        *([size] if sized else [])
    )
    block = bytes(1 << 20)
    return b"".join([*(packer.compress(block) for _ in range(size >> 20)), packer.flush()])


def chunk(packed: bytes, declared: int, compression: bytes = b"zstd") -> bytes:
    content = (
        struct.pack("<QQQII", 0, 0, declared, 0, len(compression))
        + compression
        + struct.pack("<Q", len(packed))
        + packed
    )
    return struct.pack("<BQ", 6, len(content)) + content


def many_small() -> bytes:
    """Return chunks within bounds that contain millions of almost empty messages."""
    content = EMPTY * 500_000
    return chunk(zstandard.compress(content), len(content)) * 100


BOMBS: dict[str, tuple[Callable[[], bytes], str]] = {
    "declared": (lambda: chunk(zeros(1 << 30, sized=True), 1 << 30), "allowed: 16,777,216 at most"),
    "hidden": (lambda: chunk(zeros(64 << 20, sized=False), 1 << 20), "that it declares"),
    "belied": (
        lambda: chunk(zeros(64 << 20, sized=True), 1 << 20),
        "1,048,576 bytes that it declares",
    ),
    "small": (many_small, "unpacks to more than 200 times its size"),
    "filled": (
        lambda: chunk(zeros(16 << 20, sized=True), 16 << 20) * 50,
        "damaged at byte 8: EndOfFile",
    ),
    "unknown": (lambda: chunk(b"", 0, b"zip"), "compression type 'zip'"),
    "trusted": (
        lambda: struct.pack("<BQQQQIIQ", 6, 40, 0, 0, 0, 0, 0, 1 << 30),
        "a part of 1073741824 bytes",
    ),
    "negative": (lambda: struct.pack("<BQHIQQ", 5, 21, 1, 0, 0, 0), "a part of -1 bytes"),
    "sparse": (lambda: struct.pack("<BQ", 5, 1 << 30), "record has length 1073741824"),
}


def bomb(folder: Path, name: str) -> Path:
    path = folder / f"{name}.mcap"
    with path.open("wb") as file:
        file.write(MAGIC + BOMBS[name][0]())
        if name in ("sparse", "trusted", "negative"):
            file.truncate(2 << 30)
    return path


_PEAK = """
import sys
from pathlib import Path
from outrider.cli.main import _run
for words in sys.stdin.read().splitlines():
    sys.argv = ["outrider", *words.split()]
    assert _run() == 2, words
lines = Path("/proc/self/status").read_text("utf-8").splitlines()  # getrusage would tell the parent's peak, too
print(dict(line.split(":", 1) for line in lines)["VmHWM"].removesuffix("kB"))
"""


def test_no_file_fills_the_memory_or_keeps_the_reader_waiting(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "title.toml").write_bytes(b'title = "' + b"a" * (100 << 20) + b'"\n')
    (tmp_path / "folder.toml").mkdir()
    endless = ("/dev/zero", tmp_path / "fifo")
    lines = [
        f"{command} {file}"
        for command in ("check", "sweep", "replay", "record --repair")
        for file in endless
    ]
    lines += [f"check {tmp_path / name}" for name in ("title.toml", "folder.toml")]
    lines += [f"replay {bomb(tmp_path, name)}" for name in BOMBS]
    done = python(_PEAK, input="\n".join(lines), check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    errors = done.stderr.splitlines()
    assert len(errors) == len(lines), done.stderr
    assert sum("not a regular file" in line for line in errors) == 8
    assert "larger than 1 MiB" in errors[8]
    for error, (_, wrong) in zip(errors[10:], BOMBS.values(), strict=True):
        assert wrong in error
    assert int(done.stdout) < 300 * 1024  # [kB], including all libraries


@pytest.mark.parametrize(
    "text", [".".join("a" * 500_000) + " = 1", "[" + ".".join("a" * 64 + "b") + "]"]
)
def test_a_key_of_a_million_parts_is_refused_unparsed(text: str, tmp_path: Path) -> None:
    (tmp_path / "deep.toml").write_text(text, encoding="utf-8")
    with pytest.raises(ScenarioError, match="a key of more than 64 parts"):
        load_scenario(tmp_path / "deep.toml")


def test_other_files_are_bounded_too(tmp_path: Path) -> None:
    fifo, large = tmp_path / "fifo", tmp_path / "large"
    os.mkfifo(fifo, 0o600)
    with large.open("wb") as file:
        file.truncate(1 << 31)
    large.chmod(0o600)
    for path, wrong in ((fifo, "not a regular file"), (large, "larger than")):
        with pytest.raises(AccessDenied, match=wrong):
            read_credential(path)
        with pytest.raises(ScenarioError, match=wrong):
            load_scenario(
                "escort", overrides={"ugv.0.driver": "script", "ugv.0.trajectory": str(path)}
            )
    with pytest.raises(IsADirectoryError):
        read_regular(tmp_path, 1)
    rows = "time [s],ugv_0.vx [m/s],ugv_0.vy [m/s]\n" + "0,0,0\n" * 250_001
    (tmp_path / "track.csv").write_text(rows, encoding="utf-8")
    with pytest.raises(ScenarioError, match="too long; allowed: 250,000 ticks"):
        load_scenario(
            "escort",
            overrides={"ugv.0.driver": "script", "ugv.0.trajectory": str(tmp_path / "track.csv")},
        )


def test_warnings_that_differ_in_numbers_alone_are_one_line(capsys):
    print_warnings(
        [*(f"ugv.{k}.goals = []: ugv_{k} will stand still" for k in range(1000)), "x [/y]"]
    )
    lines = capsys.readouterr().err.splitlines()
    assert lines == [
        "warning: ugv.0.goals = []: ugv_0 will stand still (and 999 similar warnings)",
        "warning: x [/y]",
    ]


@pytest.fixture
def foreign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a scenario with code beside it that leaves a file when it is loaded."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    body = "from pathlib import Path\nPath('loaded').touch()\ndef policy(seen, briefing):\n    return (0.0, 0.0)\n"
    (tmp_path / "theirs.py").write_text(body, encoding="utf-8")
    text = f'duration = 0.5\n{SMALL}driver = "policy"\n[custom]\npolicy = "theirs:policy"\n'
    (tmp_path / "theirs.toml").write_text(text, encoding="utf-8")
    (tmp_path / "sweep.toml").write_text('scenario = "theirs.toml"\nseeds = 1\n', encoding="utf-8")
    monkeypatch.delitem(sys.modules, "theirs", raising=False)
    return tmp_path / "theirs.toml"


def test_code_that_a_file_names_is_loaded_on_demand_alone(foreign: Path, command) -> None:
    refused = pytest.raises(
        ScenarioError, match=r"custom\.policy = 'theirs:policy': the file names code.*--allow-code"
    )
    with refused:
        run(foreign)
    sweep, _ = describe_sweep("sweep.toml")
    with refused:
        lay_out(sweep)
    by_command = command("run", foreign)
    assert (by_command.returncode, "--allow-code" in by_command.stderr) == (2, True)
    assert not Path("loaded").exists()
    assert lay_out(sweep, named=["custom.policy=theirs:policy"]).points
    assert Path("loaded").exists()
    assert run(foreign, allow_code=True).complete
    assert run(load_scenario(foreign)).complete  # scenarios passed by a program are trusted


def test_code_that_the_user_names_is_the_users(foreign: Path) -> None:
    scenario = load_scenario(foreign)
    assert len(foreign_code(scenario)) == len(foreign_code(scenario, ["custom.path=a:b"])) == 1
    assert (
        foreign_code(scenario, ['custom.policy="theirs:policy"'])
        == foreign_code(scenario, ["custom={}"])
        == ()
    )


def test_no_shipped_scenario_names_code() -> None:
    assert not any(foreign_code(load_scenario(name)) for name in scenario_names())


def test_a_trace_of_many_rows_is_refused_unread(tmp_path: Path) -> None:
    for name, text in (("a.csv", "sent,delay\n" + "0,0\n" * 1_000_001), ("b", "1\n" * 1_000_002)):
        (tmp_path / name).write_text(text)
        with pytest.raises(ScenarioError, match="more than 1,000,000 rows"):
            load_scenario("escort", overrides={"links.detections.trace": str(tmp_path / name)})


@pytest.mark.parametrize(
    ("rows", "error", "wrong"), [(1_001_000, "", "1,001,000 rows"), (60_000, "x" * 20_000, "GiB")]
)
def test_results_are_bounded_before_they_are_unpacked(tmp_path, rows, error, wrong) -> None:
    pa = pytest.importorskip("pyarrow")
    from pyarrow import parquet  # noqa: PLC0415 - an extra

    from outrider.experiments.sweep.folder import RESULTS, read_results  # noqa: PLC0415 - an extra

    batch = pa.record_batch({"run": pa.array(np.arange(1000)), "error": pa.array([error] * 1000)})
    path = tmp_path / RESULTS
    with parquet.ParquetWriter(path, batch.schema, compression="zstd") as writer:
        for _ in range(rows // 1000):
            writer.write_batch(batch, row_group_size=1000)
    assert path.stat().st_size < 20 << 20
    with pytest.raises(ScenarioError, match=wrong):
        read_results(tmp_path, {"run": "int64", "error": "string"})


def test_a_sweep_of_too_many_runs_is_refused() -> None:
    described, _ = describe_sweep("escort", laws="linear,switching", seeds=500_001)
    with pytest.raises(ScenarioError, match="1,000,002 runs; allowed: 1,000,000"):
        lay_out(described)


def test_titles_and_names_reach_no_terminal_and_no_picture(tmp_path, command, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = shipped_text("circle").replace('title = "', 'title = "$\\\\frac{1$ ')
    odd = tmp_path / "e$\\frac{vil$\x1b[31m.toml"
    odd.write_text(text)
    flown = command("run", odd, "--in-process", "--duration", "1")
    assert flown.returncode == 0, flown.stderr
    assert "\x1b" not in flown.stdout + flown.stderr
    odd.write_text(text.replace("$", "\\u001b[31m"))
    refused = command("check", odd)
    assert refused.returncode == 2
    assert "\x1b" not in refused.stderr
