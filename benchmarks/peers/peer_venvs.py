"""A virtual environment for each peer.

Made, filled by pip, stamped when it is whole, and used again while the stamp holds.
"""

import json
import shutil
import sys
from pathlib import Path

from peer_processes import Failed, run

STAMP = "requirements.json"
DEADLINE = 1800.0
"""Time [s] that pip may take."""
_CUDA = ("nvidia-", "cuda-", "triton")
ONLY_CUDA = (
    "pip finds torch only as the CUDA build of several GB; README.md says how to offer it the CPU build, "
    "or use --cuda"
)


def python_of(folder: Path) -> Path:
    """Return the interpreter of a virtual environment."""
    return folder / "bin" / "python"


def stamp_of(requirements: tuple[str, ...]) -> str:
    """Return the stamp of a complete environment."""
    stamp = {"python": sys.version.split()[0], "requirements": list(requirements)}
    return json.dumps(stamp, indent=2) + "\n"


def is_whole(folder: Path, requirements: tuple[str, ...]) -> bool:
    """Return true if the environment exists and is complete with these requirements."""
    stamp = folder / STAMP
    return (
        python_of(folder).exists()
        and stamp.is_file()
        and stamp.read_text(encoding="utf-8") == stamp_of(requirements)
    )


def provide(folder: Path, requirements: tuple[str, ...], *, cuda: bool = False) -> Path:
    """Return the interpreter of an environment with these requirements; an outdated one is recreated.

    Args:
        folder: Of the environment.
        requirements: As pip takes them.
        cuda: Whether torch may come as its CUDA build.

    Raises:
        Failed: If it cannot be made.
    """
    if is_whole(folder, requirements):
        return python_of(folder)
    shutil.rmtree(folder, ignore_errors=True)
    folder.parent.mkdir(parents=True, exist_ok=True)
    run([sys.executable, "-m", "venv", str(folder)], cwd=folder.parent, deadline=DEADLINE)
    if not cuda:
        _refuse_cuda(folder, requirements)
    _pip(folder, "install", *requirements)
    (folder / STAMP).write_text(stamp_of(requirements), encoding="utf-8")
    return python_of(folder)


def _pip(folder: Path, *arguments: str) -> None:
    command = [str(python_of(folder)), "-m", "pip", *arguments]
    quietly = ["--quiet", "--no-input", "--disable-pip-version-check"]
    run([*command, *quietly], cwd=folder, deadline=DEADLINE)


def _refuse_cuda(folder: Path, requirements: tuple[str, ...]) -> None:
    """Check pip's plan for torch before installing it."""
    torch = [requirement for requirement in requirements if requirement.startswith("torch")]
    if not torch:
        return
    answer = folder / "plan.json"
    _pip(folder, "install", "--dry-run", "--report", str(answer), *torch)
    plan = json.loads(answer.read_text(encoding="utf-8"))
    if any(package["metadata"]["name"].lower().startswith(_CUDA) for package in plan["install"]):
        raise Failed(ONLY_CUDA)
