"""The notebooks in examples run from the first to the last cell."""

import json
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import pytest

pytest.importorskip("outrider_learning", reason="a notebook uses the suite")
from outrider.style import texts
from pages import ROOT, blocks, run_shown, words

FOLDER = ROOT / "examples" / "notebooks"
PRINTED = {
    "paper": "r_s = 3.683 m of r_v = 4.75 m",
    "environment": "observations (8, 11) actions (8, 2)",
}
"""A line that each notebook prints."""
SMALLER = {
    "EACH, GENERATIONS = 16, 4, 6": "EACH, GENERATIONS = 4, 2, 2",
    '("noise", "late-commands")': '("noise",)',
    'ENTRIES = {"tracking": {}, mine: HELPERS, "certified": {}}': "ENTRIES = {mine: HELPERS}",
    '("tracking", "ours", "certified")': '("ours",)',
}
"""Settings with which a notebook runs faster."""


def cells(name: str) -> list[str]:
    """Return the code cells of a notebook."""
    notebook = json.loads((FOLDER / f"{name}.ipynb").read_text(encoding="utf-8"))
    return ["".join(one["source"]) for one in notebook["cells"] if one["cell_type"] == "code"]


@pytest.mark.parametrize("name", PRINTED)
@pytest.mark.filterwarnings("ignore:.*non-interactive")
def test_notebook_runs_in_ten_cells(name: str, here: Path, capsys: Any) -> None:
    assert len(cells(name)) == 10
    program = "\n\n".join(cells(name))
    for full, smaller in SMALLER.items():
        assert name == "paper" or full in program
        program = program.replace(full, smaller)
    with mpl.rc_context({"backend": "Agg"}):
        run_shown(program, name)
    if name == "environment":  # fewer entries, so fewer keys in the legend
        assert {*texts(plt.gcf())} < {*words(ROOT / "docs" / "tutorial.png")}
    plt.close("all")
    assert PRINTED[name] in capsys.readouterr().out.splitlines()


def test_tutorial_shows_cells_of_the_notebooks() -> None:
    known = {cell for name in PRINTED for cell in cells(name)}
    shown = [block.strip() for block in blocks("python", "docs/tutorial.md")]
    assert shown
    assert set(shown) <= known
