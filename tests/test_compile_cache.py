"""The compile cache: what is damaged is compiled again, and no fault of its folder stops a process."""

import os
import random
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from processes import outrider, python

USE = """
from sim.models.vehicles import clip_norm
print(clip_norm(0.0, 4.0, 1.0)[1], sum(clip_norm.stats.cache_hits.values()))
"""
"""Compile one function, or load it from the cache."""
COMPILED, LOADED = "1.0 0\n", "1.0 1\n"
WHOLE = {"PYTHONDONTWRITEBYTECODE": "1"}
"""Environment of a process whose files are limited: Python would truncate the bytecode of modules that it imports."""


def used(folder: Path) -> tuple[str, str]:
    """Return what a process that uses this cache writes to standard output and standard error."""
    done = python(USE, env=os.environ | {"OUTRIDER_CACHE": str(folder)})
    return done.stdout, done.stderr


@pytest.fixture(scope="module")
def filled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("filled")
    assert used(folder) == (COMPILED, "")
    return folder


@pytest.fixture
def cache(filled: Path, tmp_path: Path) -> Path:
    """Return a cache with that function, which the test may damage."""
    shutil.copytree(filled, tmp_path / "cache")
    return tmp_path / "cache"


def _empty(file: Path) -> None:
    file.write_bytes(b"")


def _truncate(file: Path) -> None:
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])


def _fill_with_garbage(file: Path) -> None:
    file.write_bytes(random.Random(7).randbytes(file.stat().st_size))


def _replace_by_folder(file: Path) -> None:
    file.unlink()
    file.mkdir()


@pytest.mark.parametrize(
    ("kind", "damage"),
    [
        ("nbi", _empty),
        ("nbc", _truncate),
        ("nb?", _fill_with_garbage),
        ("nbi", _replace_by_folder),
    ],
)
def test_a_damaged_cache_is_compiled_again(
    kind: str, damage: Callable[[Path], None], cache: Path
) -> None:
    files = list(cache.rglob(f"*.{kind}"))
    for file in files:
        damage(file)
    out, err = used(cache)
    assert out == COMPILED
    (line,) = err.splitlines()
    assert f"compile cache {cache}" in line
    assert f"{len(files)} damaged files removed" in line
    assert used(cache) == (LOADED, "")


def test_a_file_without_a_checksum_is_compiled_again(cache: Path) -> None:
    """A process that is killed may leave files that never reached the disk."""
    (sums,) = cache.rglob("checksums")
    sums.write_bytes(bytes(50))
    for file in cache.rglob("*.nb?"):
        _empty(file)
    assert used(cache) == (COMPILED, "")


def test_a_process_trusts_the_files_of_one_that_lives(cache: Path) -> None:
    code = (
        "import subprocess, sys; from sim.compiling.compile import cache_folder; folder = cache_folder();"
        "(folder / 'checksums').unlink(); sys.stdout.write(subprocess.check_output([sys.executable, '-c', sys.argv[1]],"
        "text=True))"
    )
    done = python(code, USE, env=os.environ | {"OUTRIDER_CACHE": str(cache)})
    assert (done.stdout, done.stderr) == (LOADED, "")


def test_a_limit_on_files_disables_the_cache(tmp_path: Path) -> None:
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))\n"
    done = python(limit + USE, env=os.environ | WHOLE | {"OUTRIDER_CACHE": str(tmp_path)})
    assert done.stdout == COMPILED
    (line,) = done.stderr.splitlines()
    assert f"no compile cache ({tmp_path}" in line
    assert "File too large" in line


def test_a_disk_that_fills_up_is_one_line(tmp_path: Path) -> None:
    code = (
        "import resource, sys\n"
        "from sim.compiling.compile import cache_folder\n"
        "cache_folder()\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))\n"
        "sys.argv = ['outrider', 'check', 'escort']\n"
        "from outrider.cli.main import main\n"
        "main()\n"
    )
    done = python(code, env=os.environ | WHOLE | {"OUTRIDER_CACHE": str(tmp_path)}, check=False)
    (line,) = done.stderr.splitlines()
    assert (done.returncode, done.stdout) == (1, "")
    assert line.startswith(f"outrider: compile cache {tmp_path}")
    assert "File too large" in line


def test_doctor_reports_a_damaged_cache(cache: Path) -> None:
    for file in cache.rglob("*.nb?"):
        _empty(file)
    env = os.environ | {"OUTRIDER_CACHE": str(cache), "COLUMNS": "200"}
    report = outrider("doctor", env=env).stdout
    assert "damaged files removed" in report


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """Return the folder of a package with an entry point, whose sources the cache depends on."""
    info = tmp_path / "mine-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1.0\n", "utf-8")
    (info / "entry_points.txt").write_text("[outrider.sinks]\nmine = mine:Sink\n", "utf-8")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "__init__.py").touch()
    return tmp_path / "mine"


@pytest.mark.parametrize(
    ("name", "target", "complaint"),
    [
        (".#world.py", "user@host.1:2", ""),  # Emacs marks a file that is being edited
        ("world.py", "/proc/self/mem", "no compile cache ("),  # cannot be read
    ],
)
def test_a_link_among_the_sources_stops_no_command(
    name: str, target: str, complaint: str, package: Path
) -> None:
    (package / name).symlink_to(target)
    path = os.pathsep.join((str(package.parent), os.environ.get("PYTHONPATH", "")))
    done = python(USE, env=os.environ | {"PYTHONPATH": path})
    assert done.stdout.startswith("1.0 ")
    assert complaint in done.stderr
    assert len(done.stderr.splitlines()) == bool(complaint)
