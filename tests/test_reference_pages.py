"""The generated text of the documentation is complete, and the pages have it."""

import importlib
import inspect
import re
from pathlib import Path
from types import ModuleType

import msgspec
import pytest

from bus.keys import KEYS
from bus.messages.links import LinkSettings
from bus.observations import ALTITUDE, SYMBOLS, UAV, UGV
from outrider.cli.main import COMMANDS
from outrider.envs.parallel import OutriderEnv
from pages import PAGES
from sim.scenario.loading import scenario_names
from sim.scenario.types import Scenario

GENERATORS = Path(__file__).resolve().parent.parent / "docs" / "generators"


@pytest.fixture
def generator(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> ModuleType:
    if request.param in ("observations", "reference"):  # they also show the tables of extensions
        pytest.importorskip("outrider_learning", reason="the extension is not installed")
    monkeypatch.syspath_prepend(GENERATORS)
    return importlib.import_module(request.param)


@pytest.mark.parametrize("generator", ["command_line"], indirect=True)
def test_reference_covers_every_command_and_option(generator):
    sections = dict(
        part.split("\n", 1) for part in ("\n" + generator.page()).split("\n## outrider ")[1:]
    )
    assert set(sections) >= {*COMMANDS, "scenarios show"}
    for name, text in sections.items():
        assert f"```sh\noutrider {name}" in text
        rows = [line.split(" | ") for line in text.splitlines() if line.startswith("| `")]
        assert all(len(row) == 3 and row[1].strip() for row in rows), name
    assert "| `--seed` INTEGER | Set the seed of all random numbers" in sections["run"]


@pytest.mark.parametrize("generator", ["bus_messages"], indirect=True)
def test_every_key_and_message_field_is_documented(generator: ModuleType) -> None:
    rows, sections = generator.keys().splitlines()[2:], generator.messages()
    assert len(rows) == len(KEYS)
    for key, row in zip(KEYS, rows, strict=True):
        assert f"[{key.message.__name__}]" in row
        assert f"### {key.message.__name__}\n" in sections
        text = sections.split(f"### {key.message.__name__}\n")[1].split("\n###")[0]
        for field in msgspec.structs.fields(key.message):
            assert f"| `{field.encode_name}` | " in text


@pytest.mark.parametrize("generator", ["scenario_fields"], indirect=True)
def test_every_scenario_field_is_documented_in_its_table(generator: ModuleType) -> None:
    text = generator.tables()
    sections = dict(part.split("\n", 1) for part in ("\n" + text).split("\n### ")[1:])
    assert {"`[area]`", "`[law]`", "`[[uav]]`", "`[[ugv]]`", "`[[ugv.script]]`"} <= set(sections)
    for heading, struct in (("Top level", Scenario), ("`[links.detections]`", LinkSettings)):
        for field in msgspec.structs.fields(struct):
            assert f"| `{field.encode_name}` | " in sections[heading]
    assert "| `duration` | number > 0 | `160.0` | Duration [s], a whole number of ticks. |" in text
    rows = generator.shipped().splitlines()[2:]
    assert [row.split("`")[1] for row in rows] == [*scenario_names()]


@pytest.mark.parametrize("generator", ["observations"], indirect=True)
def test_every_entry_of_an_observation_is_on_a_page(generator: ModuleType) -> None:
    for name, table in generator.TABLE_OF.items():
        lines = generator.PAGES[name]().splitlines()[2:]
        assert len(lines) == len(table)
        for k, (entry, line) in enumerate(zip(table, lines, strict=True)):
            assert line.startswith(f"| {k} | `{entry.name}` | {entry.meaning} | ")
    symbols = generator.symbols()
    assert all(f"| `{name}` | {meaning} |" in symbols for name, meaning in SYMBOLS.items())


@pytest.mark.parametrize("generator", ["reference"], indirect=True)
def test_generated_text_of_the_pages_is_current(generator: ModuleType) -> None:
    if generator.missing():
        pytest.skip(f"commands without their libraries: {', '.join(generator.missing())}")
    marks = [mark for page in PAGES.values() for mark in re.findall(r"<!-- (/?\w+) -->", page)]
    assert {f"/{mark}" for mark in marks if not mark.startswith("/")} <= {*marks}
    assert generator.GENERATED.keys() <= {*marks}
    old = [str(file.relative_to(generator.ROOT)) for file, _ in generator.outdated()]
    assert not old, f"generated text is not current in {', '.join(old)}; update it: make reference"


def test_help_of_the_environment_shows_every_entry() -> None:
    shown = inspect.getdoc(OutriderEnv) or ""
    for entry in (*UAV, *ALTITUDE, *UGV):
        assert f"| `{entry.name}` | {entry.meaning} | " in shown
