"""The paper's page shows each equation once, beside an existing function that cites it."""

import importlib
import inspect
import pkgutil
import re
from collections.abc import Callable, Iterator
from typing import NamedTuple

import pytest

import agents.control
from pages import PAGES

NUMBERED = re.compile(r"\((\d+)\)")
EQUATIONS = [f"({number})" for number in range(1, 26)]
WEIGHTS = {"α₁, β₁": r"\alpha_1, \beta_1", "α₂, β₂": r"\alpha_2, \beta_2"}
"""The weightings that the paper prints without a number, and their form in docstrings."""
WRITTEN_IN = (
    "sim.models.vehicles",
    "sim.models.field",
    "sim.models.sensors.hill",
    *(f"agents.control.{module.name}" for module in pkgutil.iter_modules(agents.control.__path__)),
)


class Row(NamedTuple):
    """A row of the tables."""

    equation: str
    formula: str
    functions: list[str]


def rows() -> Iterator[Row]:
    """Yield the rows of all tables of equations on the paper's page."""
    page = PAGES["docs/explanation/paper.md"]
    shown = page.split("<!-- equations -->")[1].split("<!-- /equations -->", maxsplit=1)[0]
    for line in shown.splitlines():
        if line.startswith(("| (", *(f"| {name}" for name in WEIGHTS))):
            equation, formula, functions = line.strip("| ").split(" | ")
            yield Row(equation, formula, re.findall(r"`([^`]+)`", functions))


ROWS = list(rows())
FUNCTIONS = [(row.equation, function) for row in ROWS for function in row.functions]


def _load(path: str) -> Callable[..., object]:
    module, _, name = path.rpartition(".")
    function: Callable[..., object] = getattr(importlib.import_module(module), name)
    return function


def _cited(function: object) -> list[str]:
    """Return the equations that a docstring cites as its own, in its first line."""
    first = (inspect.getdoc(function) or "").partition("\n")[0]
    return [f"({number})" for number in re.findall(r"Klodt 2015, eq\. \((\d+)[ab]?\)", first)]


def test_every_equation_of_the_paper_has_its_row() -> None:
    assert [row.equation for row in ROWS if NUMBERED.fullmatch(row.equation)] == EQUATIONS
    assert {row.equation for row in ROWS} == {*EQUATIONS, *WEIGHTS}
    assert all("$" in row.formula and row.functions for row in ROWS)


@pytest.mark.parametrize(("equation", "path"), FUNCTIONS, ids=[path for _, path in FUNCTIONS])
def test_every_function_exists_and_cites_its_equation(equation: str, path: str) -> None:
    function = _load(path)
    if equation in WEIGHTS:
        assert WEIGHTS[equation] in (inspect.getdoc(function) or "")
    else:
        assert _cited(function) == [equation]


def test_every_citing_function_is_in_the_equation_table() -> None:
    citing = set()
    for module in WRITTEN_IN:
        for name, function in vars(importlib.import_module(module)).items():
            if getattr(function, "__module__", None) == module and _cited(function):
                citing.add(f"{module}.{name}")
    assert citing == {path for equation, path in FUNCTIONS if equation not in WEIGHTS}
