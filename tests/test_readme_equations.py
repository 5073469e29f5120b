"""The paper's page has the table of equations: complete, and every function and test in it is there and says so."""

import ast
import importlib
import inspect
import pkgutil
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import pytest

import agents.control
from pages import ROOT, marked

NUMBERED = re.compile(r"\((\d+)\)")
EQUATIONS = [f"({number})" for number in range(1, 26)]
WEIGHTS = {"α₁, β₁": r"\alpha_1, \beta_1", "α₂, β₂": r"\alpha_2, \beta_2"}
"""The weightings that the paper prints without a number, and how their docstrings write them."""
WRITTEN_IN = (
    "sim.models.vehicles",
    "sim.models.field",
    "sim.models.sensors.hill",
    *(f"agents.control.{module.name}" for module in pkgutil.iter_modules(agents.control.__path__)),
)


@dataclass(frozen=True)
class Row:
    """A row of the table."""

    equation: str
    functions: tuple[str, ...]
    tests: tuple[str, ...]


def _quoted(cell: str) -> tuple[str, ...]:
    return tuple(re.findall(r"`([^`]+)`", cell))


def rows() -> Iterator[Row]:
    """The table of the paper's page."""
    _, *lines = marked("equations", "docs/explanation/paper.md")
    for equation, _, functions, tests in lines:
        yield Row(equation=equation, functions=_quoted(functions), tests=_quoted(tests))


ROWS = list(rows())
FUNCTIONS = [(row.equation, function) for row in ROWS for function in row.functions]
TESTS = [test for row in ROWS for test in row.tests]


def _load(path: str) -> Callable[..., object]:
    module, _, name = path.rpartition(".")
    function: Callable[..., object] = getattr(importlib.import_module(module), name)
    return function


def _cited(function: object) -> list[str]:
    """The equations that a docstring cites as its own, in its first line."""
    first = (inspect.getdoc(function) or "").partition("\n")[0]
    return [f"({number})" for number in re.findall(r"Klodt 2015, eq\. \((\d+)[ab]?\)", first)]


def test_every_equation_of_the_paper_has_its_row() -> None:
    assert [row.equation for row in ROWS if NUMBERED.fullmatch(row.equation)] == EQUATIONS
    assert {row.equation for row in ROWS} == {*EQUATIONS, *WEIGHTS}
    assert all(row.functions and row.tests for row in ROWS)


@pytest.mark.parametrize(("equation", "path"), FUNCTIONS, ids=[path for _, path in FUNCTIONS])
def test_every_function_exists_and_cites_its_equation(equation: str, path: str) -> None:
    function = _load(path)
    if equation in WEIGHTS:
        assert WEIGHTS[equation] in (inspect.getdoc(function) or "")
    else:
        assert _cited(function) == [equation]


@pytest.mark.parametrize("test", TESTS)
def test_every_test_exists(test: str) -> None:
    path, _, name = test.partition("::")
    tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
    assert name in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


def test_no_function_that_cites_an_equation_is_missing_from_the_table() -> None:
    citing = set()
    for module in WRITTEN_IN:
        for name, function in vars(importlib.import_module(module)).items():
            if (
                getattr(function, "__module__", None) == module
                and callable(function)
                and _cited(function)
            ):
                citing.add(f"{module}.{name}")
    assert citing == {path for equation, path in FUNCTIONS if equation not in WEIGHTS}
