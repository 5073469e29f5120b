"""Modules with a page of their own in the site, and their table in the reference."""

import ast
from pathlib import Path

from structs import cell

ROOT = Path(__file__).resolve().parent.parent.parent

MODULES = {
    "Public interface": ("outrider",),
    "Environments": (
        "outrider/envs/parallel.py",
        "sim/env/settings.py",
        "sim/env/rewards.py",
        "outrider/envs/vector.py",
        "outrider/envs/single.py",
        "outrider/envs/env_pilots.py",
        "extensions/outrider_learning/transformation.py",
        "extensions/outrider_learning/egocentric.py",
        "extensions/outrider_learning/stacking.py",
        "extensions/outrider_learning/sb3.py",
        "extensions/outrider_learning/suite/tasks.py",
        "extensions/outrider_learning/suite/board.py",
        "outrider/registration.py",
        "extensions/outrider_learning/registration.py",
    ),
    "Runs": (
        "outrider/running/flying.py",
        "sim/scenario/loading.py",
        "sim/scenario/types.py",
        "sim/scenario/vehicle_types.py",
        "sim/world.py",
    ),
    "Vehicles": (
        "agents/process.py",
        "agents/uav.py",
        "agents/ugv.py",
        "agents/estimation/estimator.py",
        "agents/drivers",
    ),
    "The paper's laws": (
        "sim/models",
        "sim/models/sensors",
        "agents/control",
        "agents/laws",
        "agents/safety",
    ),
    "The bus": ("bus", "bus/messages"),
    "Links": ("sim/channel", "sim/engine"),
}
"""Modules by group: files, or folders with their content."""


def modules() -> dict[str, list[str]]:
    """Return the files of the modules with a page, by group."""
    found: dict[str, list[str]] = {}
    for group, places in MODULES.items():
        files: list[str] = []
        for place in places:
            path = ROOT / place
            inside = sorted(path.glob("*.py")) if path.is_dir() else [path]
            if place == "outrider":
                inside = [path / "__init__.py"]
            files += [
                str(one.relative_to(ROOT))
                for one in inside
                if one.name != "__init__.py" or place == "outrider"
            ]
        found[group] = files
    return found


def dotted(file: str) -> str:
    """Return the module's full name."""
    return (
        file.removeprefix("extensions/")
        .removesuffix(".py")
        .removesuffix("/__init__")
        .replace("/", ".")
    )


def first_line(file: str) -> str:
    """Return the first paragraph of the module's docstring, on one line."""
    text = ast.get_docstring(ast.parse((ROOT / file).read_text(encoding="utf-8"))) or ""
    return " ".join(text.partition("\n\n")[0].split())


def table() -> str:
    """Return a section for each group, with links to the sources, which the site redirects to the modules' pages."""
    parts = []
    for group, files in modules().items():
        rows = [f"| [{dotted(file)}](../../{file}) | {cell(first_line(file))} |" for file in files]
        parts.append("\n".join([f"## {group}", "", "| module | description |", "|---|---|", *rows]))
    return "\n\n".join(parts)
