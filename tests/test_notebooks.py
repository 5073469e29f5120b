"""The notebooks in examples run from the first to the last cell."""

import json
import os
from pathlib import Path

import pytest

pytest.importorskip("outrider_learning", reason="a notebook uses the suite")
from pages import ROOT, blocks
from processes import python

FOLDER = ROOT / "examples" / "notebooks"
PRINTED = {
    "paper": "r_s = 3.683 m of r_v = 4.75 m",
    "environment": "observations (8, 11) actions (8, 2)",
}
"""A line that each notebook prints."""
SMALLER = {
    "EACH, GENERATIONS = 16, 4, 6": "EACH, GENERATIONS = 4, 2, 2",
    '("noise", "late-commands")': '("noise",)',
}
"""Settings with which a notebook runs faster."""


def cells(name: str) -> list[str]:
    """Return the code cells of a notebook."""
    notebook = json.loads((FOLDER / f"{name}.ipynb").read_text(encoding="utf-8"))
    return ["".join(one["source"]) for one in notebook["cells"] if one["cell_type"] == "code"]


@pytest.mark.parametrize("name", PRINTED)
def test_notebook_runs_in_ten_cells(name: str, tmp_path: Path) -> None:
    assert len(cells(name)) == 10
    code = "import warnings\nwarnings.filterwarnings('ignore', '.*non-interactive')\n"
    program = code + "\n\n".join(cells(name))
    for full, smaller in SMALLER.items():
        assert name == "paper" or full in program
        program = program.replace(full, smaller)
    done = python(program, env=os.environ | {"MPLBACKEND": "Agg"}, cwd=tmp_path)
    assert PRINTED[name] in done.stdout.splitlines()


def test_tutorial_shows_cells_of_the_notebooks() -> None:
    known = {cell for name in PRINTED for cell in cells(name)}
    shown = [block.strip() for block in blocks("python", "docs/tutorial.md")]
    assert shown
    assert set(shown) <= known
