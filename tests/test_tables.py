"""The registry: every row can be flown, and its names stand nowhere else."""

import ast
import re
from collections import Counter
from importlib import import_module
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from flights import escort, parameters
from tabular import words

from agents.control.laws import OwnTerms, weights
from agents.drivers import parameters as parameters_of_drivers
from bus.keys import KEYS, Key
from bus.messages import LinkKind
from bus.profiles import PROFILES
from bus.registry import (
    DEFAULT_DRIVER,
    DEFAULT_LAW,
    DEFAULT_SENSOR,
    DRIVERS,
    LAWS,
    SAVED_POLICIES,
    SENSORS,
    TELEOP,
    LawRow,
    _table,
    resolve,
)
from outrider.cli import options
from sim.models.field import sensor_quality, sensor_slope
from sim.scenario.types import Custom, LinkTable, Ugv, VehicleLinks

ROOT = Path(__file__).resolve().parent.parent
PRODUCT = [
    path
    for folder in ("agents", "bus", "outrider", "sim")
    for path in sorted((ROOT / folder).rglob("*.py"))
    if path != ROOT / "bus" / "registry.py"
]
CHOSEN = {
    "outrider/experiments/paper_figures.py": "the flights of the paper's figure 3",
    "outrider/experiments/claims.py": "likewise",
    "outrider/experiments/falsify/attacks.py": "guards that are known to be wrong, no laws",
}
"""Files that name a few of them on purpose, and why: an experiment's choice, which no new row changes."""


@pytest.fixture(scope="module")
def trees() -> dict[Path, ast.Module]:
    """The product's files, parsed once, and not kept longer: they are large."""
    return {path: ast.parse(path.read_text(encoding="utf-8")) for path in PRODUCT}


def _names_in(node: ast.AST) -> list[str]:
    if isinstance(node, ast.Tuple | ast.List | ast.Set):
        parts = node.elts
    elif isinstance(node, ast.Dict):
        parts = [part for part in node.keys if part is not None]
    elif isinstance(node, ast.Constant) and isinstance(node.value, str):
        return re.findall(r"\w+", node.value)
    else:
        return []
    return [part.value for part in parts if isinstance(part, ast.Constant)]


def _docstrings(tree: ast.AST) -> set[ast.AST]:
    return {node.value for node in ast.walk(tree) if isinstance(node, ast.Expr)}


def copies(tree: ast.AST) -> list[str]:
    """Literals of a file, but docstrings, that list names of laws, drivers or saved policies."""
    prose, found = _docstrings(tree), []
    for node in ast.walk(tree):
        names = [] if node in prose else _names_in(node)
        if len(names) < 2:
            continue
        least = 3 if isinstance(node, ast.Constant) else 2
        for table in (LAWS, DRIVERS, SAVED_POLICIES, SENSORS):
            listed = [name for name in dict.fromkeys(names) if name in table]
            if len(listed) >= least:
                found.append(f"line {node.lineno}: {', '.join(listed)}")
    return found


@pytest.mark.parametrize(
    "text",
    [
        'X = ("tracking", "circle")',
        'X = {"wander": 1, "evade": 2}',
        'f(help="linear, switching or circle")',
        'X = ["sb3", "onnx"]',
    ],
)
def test_a_copied_list_of_names_would_be_found(text: str) -> None:
    assert copies(ast.parse(text))
    assert not copies(ast.parse('"""Of linear, switching and circle."""'))


def test_no_list_of_laws_drivers_sensors_or_saved_policies_stands_outside_the_registry(trees):
    found = {
        str(path.relative_to(ROOT)): lines
        for path, tree in trees.items()
        if (lines := copies(tree))
    }
    assert {file: lines for file, lines in found.items() if file not in CHOSEN} == {}
    assert set(CHOSEN) == set(found)  # an excuse that is no longer needed goes


def test_two_rows_of_one_name_or_code_are_refused() -> None:
    one, other = LAWS["linear"], LAWS["switching"]
    with pytest.raises(ValueError, match="the same name"):
        _table(one, LawRow(name=one.name, code=99, about="", color="#000000"))
    with pytest.raises(ValueError, match="the same code"):
        _table(one, LawRow(name="new", code=other.code, about="", color="#000000"), other)


def test_the_defaults_are_rows() -> None:
    assert DEFAULT_LAW in LAWS
    assert DEFAULT_SENSOR in SENSORS
    assert {DEFAULT_DRIVER, TELEOP} <= set(DRIVERS)
    assert [row.name for row in DRIVERS.values() if row.operated] == [TELEOP]


@pytest.mark.parametrize("name", LAWS)
def test_every_law_has_its_branch(name: str) -> None:
    alpha, beta = weights(parameters(escort(name)), OwnTerms(), 1.0)
    assert np.isfinite([alpha, beta]).all()
    assert LAWS[name].covers or beta == 0.0


def test_a_row_without_its_branch_flies_no_other_law() -> None:
    missing = parameters(escort("linear"))._replace(law=1 + max(row.code for row in LAWS.values()))
    assert np.isnan(weights(missing, OwnTerms(), 1.0)).all()


def test_every_compiled_driver_has_its_branch(trees: dict[Path, ast.Module]) -> None:
    tree = trees[ROOT / "agents" / "drivers" / "ugv_tick.py"]
    asked = [
        node.comparators[0].id
        for node in ast.walk(tree)
        if isinstance(node, ast.Compare) and ast.unparse(node.left) == "parameters.driver"
    ]
    last = "EVADE"  # what is none of the others
    codes = [getattr(parameters_of_drivers, name) for name in (*asked, last)]
    assert sorted(codes) == sorted(parameters_of_drivers.COMPILED_DRIVERS.values())


@pytest.mark.parametrize("name", SENSORS)
def test_every_sensor_has_its_branches(name: str) -> None:
    code, h = SENSORS[name].code, 1e-6
    rise = (sensor_quality(code, 4.0 + h, 1.0, 5.0) - sensor_quality(code, 4.0 - h, 1.0, 5.0)) / (
        2.0 * h
    )
    assert rise == pytest.approx(sensor_slope(code, 4.0, 1.0, 5.0), rel=1e-6)
    others = {row.code for row in SENSORS.values()} - {code}
    assert all(
        sensor_quality(code, 4.0, 1.0, 5.0) != sensor_quality(other, 4.0, 1.0, 5.0)
        for other in others
    )


@pytest.mark.parametrize(
    "where",
    [row.make for row in DRIVERS.values() if row.make]
    + [row.load for row in SAVED_POLICIES.values()],
)
def test_every_row_names_code_that_is_there(where: str) -> None:
    assert callable(resolve(where))


def test_every_field_that_a_row_names_is_one() -> None:
    own = {row.own for row in (*LAWS.values(), *DRIVERS.values()) if row.own}
    tasks = {task for row in DRIVERS.values() for task in (row.needs, row.wants) if task}
    assert own == set(Custom.__struct_fields__)
    assert tasks <= set(Ugv.__struct_fields__)


def test_every_key_is_in_the_table_of_keys() -> None:
    rows = {name: row for name, row in vars(import_module("bus.keys")).items() if type(row) is Key}
    assert sorted(rows.values(), key=repr) == sorted(KEYS, key=repr)


def test_every_kind_of_link_has_its_field_in_a_scenario() -> None:
    kinds = {str(kind) for kind in LinkKind}
    assert kinds | {"only", "traces"} == set(LinkTable.__struct_fields__)
    assert kinds | {"vehicle"} == set(VehicleLinks.__struct_fields__)


def test_the_command_line_tells_every_law_driver_and_profile_with_its_line() -> None:
    law, driver, network, policy = (
        get_args(option)[1].help
        for option in (options.LawName, options.DriverName, options.NetworkName, options.PolicyName)
    )
    assert all(name in network for name in PROFILES)
    assert all(f"{name}:" in policy for name in SAVED_POLICIES)
    assert all(f"{row.name}: {row.about}" in law for row in LAWS.values())
    assert all(f"{row.name}: {row.about}" in driver for row in DRIVERS.values())


def test_no_file_and_no_public_class_has_the_name_of_another(trees: dict[Path, ast.Module]) -> None:
    """A search for a name finds the one thing that has it."""
    beside = [
        path
        for folder in ("benchmarks", "tools", "tests")
        for path in (ROOT / folder).rglob("*.py")
    ]
    files = [
        path.name for path in (*PRODUCT, *beside) if path.name not in {"__init__.py", "conftest.py"}
    ]
    classes = [
        node.name
        for tree in trees.values()
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
    ]
    twice = [name for name, count in Counter([*files, *classes]).items() if count > 1]
    assert twice == []
    assert len(classes) > 300


PRIVATE = {
    *words("crew crews deaf deeds desk ether glance hear heard heed leash seat seats unheard")
}
"""Private metaphors that have the field's word now: pilots, operator controls, channel, receive, slot and so on."""
STRUCTURE = re.compile(r"[A-Z]\w+(?<!Array)(?<!Any)$")
"""Types with names for their parts; what has such a type has a name too."""
RIDDLE = re.compile(r"(What|Who|Whom|Whose|Whoever|Whatever|How|Which)\b")


def _words(node: ast.AST) -> list[str]:
    """The words of what this names."""
    named = [getattr(node, field, None) for field in ("name", "id", "attr", "arg")]
    names = " ".join(name for name in named if isinstance(name, str))
    return [word.lower() for word in re.findall(r"[A-Z]?[a-z]+", names)]


def unclear(tree: ast.AST) -> list[str]:
    """Docstrings of a file that are riddles, names with words that are nobody else's, and letters for structures."""
    prose = {node.value for node in _docstrings(tree) if isinstance(node, ast.Constant)}
    riddles = [text for text in prose if isinstance(text, str) and RIDDLE.match(text)]
    words = {word for node in ast.walk(tree) for word in _words(node)}
    letters = {
        f"{node.arg}: {node.annotation.id}"
        for node in ast.walk(tree)
        if isinstance(node, ast.arg) and isinstance(node.annotation, ast.Name)
        if len(node.arg) == 1 and STRUCTURE.match(node.annotation.id)
    }
    return sorted(riddles) + sorted(words & PRIVATE) + sorted(letters)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ('"""What a flight needs."""', ["What a flight needs."]),
        ('x = 1\n"""Whose it is."""', ["Whose it is."]),
        ("def hear_block(): pass", ["hear"]),
        ("class FrontSeat: pass", ["seat"]),
        ("f(heard=run.desk)", ["desk", "heard"]),
        ("def f(s: BatchState, x: float, w: FloatArray): pass", ["s: BatchState"]),
        ('"""Whether it is seated: nobody is overheard."""', []),
    ],
)
def test_a_riddle_and_a_private_word_would_be_found(text: str, found: list[str]) -> None:
    assert unclear(ast.parse(text)) == found


def test_docstrings_state_and_names_are_the_fields_words(trees: dict[Path, ast.Module]) -> None:
    beside = [
        path
        for folder in ("benchmarks", "examples", "tests", "tests_learning", "tools")
        for path in (ROOT / folder).rglob("*.py")
        if path != Path(__file__)
    ]
    parsed = trees | {path: ast.parse(path.read_text(encoding="utf-8")) for path in beside}
    found = {str(path.relative_to(ROOT)): unclear(tree) for path, tree in parsed.items()}
    assert {path: lines for path, lines in found.items() if lines} == {}
    assert len(parsed) > 400
