"""The README and the pages of docs agree with the program."""

import inspect
import json
import pkgutil
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("outrider_learning", reason="the pages show extensions, too")
import typer

import outrider
from agents.process import Pilot
from bus.messages.links import LinkKind
from bus.observations import ALTITUDE, GRADIENT, STATE, UAV, UAV_STATE, UGV, UGV_STATE
from bus.plugins import GROUPS
from outrider.cli.main import make_app
from outrider.running.assumptions import certified_from
from outrider.running.own_functions import check_own_functions
from pages import PAGES, ROOT, blocks, run_shown
from processes import ran, started, wait_until
from sim.channel.recorded import MOST_BYTES, MOST_LINES
from sim.engine.briefing import uav_briefing
from sim.scenario.link_profiles import read_profiles
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario
from tabular import words


def prose(page: str) -> str:
    return re.sub(r"```.*?```|`[^`\n]*`", "", PAGES[page], flags=re.DOTALL)


@pytest.mark.parametrize(
    ("example", "page"),
    [
        ("environment", "README.md"),
        ("environment", "docs/reference/environment.md"),
        ("own_pilot", "docs/how-to/own-code.md"),
        ("external_ugv", "docs/how-to/own-code.md"),
    ],
)
def test_the_examples_are_shown_as_they_are(example: str, page: str) -> None:
    text = (ROOT / "examples" / f"{example}.py").read_text(encoding="utf-8")
    assert text.split('"""')[2].strip() in [shown.strip() for shown in blocks("python", page)]


def test_scenarios_shown_are_valid(tmp_path: Path) -> None:
    def loaded(text: str) -> Scenario:
        (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
        return load_scenario(tmp_path / "mine.toml")

    shown, car, pairs, laws, hazards, buildings = blocks("toml", "docs/how-to/scenario.md")
    assert loaded(shown).title == "Across the yard"
    assert loaded(car).ugv[0].kinematics == "ackermann"
    assert loaded(f"{shown}\n{hazards}").has_ground
    assert loaded(buildings).has_buildings
    assert [uav.escorts for uav in loaded(pairs).uav] == ["ugv_0", "ugv_1"]
    assert [loaded(laws).law_of(uav).name for uav in loaded(laws).uav] == ["certified", "lookahead"]
    (robot,) = blocks("toml", "docs/how-to/own-robot.md")
    assert loaded(robot).law.name == "certified"
    links, profiles = blocks("toml", "docs/how-to/network.md")
    assert read_profiles(profiles.encode(), "radios.toml")["mesh-far"].loss == 0.08
    settings = loaded(shown + links).links
    assert (settings.commands.delay, settings.detections.jitter_shape) == (0.1, "exponential")
    assert settings.of("uav_0", LinkKind.DETECTIONS).blackouts == ((30.0, 5.0),)


@pytest.mark.parametrize(
    ("page", "output"),
    [
        ("how-to/keep-sight", r"(?!100 )[1-9]\d{2,} commands were overridden; certified: True\n"),
        ("explanation/proof", r"\(\)\nNOMINAL 1\.42 m True\n"),
    ],
)
def test_the_safety_filter_shown_certifies(page: str, output: str, capsys: Any) -> None:
    (shown,) = blocks("python", f"docs/{page}.md")
    run_shown(shown, page)
    assert re.fullmatch(output, capsys.readouterr().out)


def test_the_commands_and_options_shown_exist() -> None:
    known = {
        name: {"--help"}
        | {
            opt
            for command in (one, *getattr(one, "commands", {}).values())
            for p in command.params
            for opt in (*p.opts, *p.secondary_opts)
        }
        for name, one in typer.main.get_command(make_app(whole=True)).commands.items()
    }
    shown = set()
    for page in PAGES:
        text = re.sub(r"\$\(([^)]*)\)", r"\n\1\n", "\n".join(blocks("sh", page)))
        for line in re.findall(r"^outrider .*$", text, re.MULTILINE):
            for part in shlex.join(shlex.split(line, comments=True)).split("outrider ")[1:]:
                command, *rest = shlex.split(part.replace("'&&'", ""))
                options = {word.partition("=")[0] for word in rest if word.startswith("--")}
                assert options <= known[command], f"{page}: {line}"
                shown.add(command)
    assert {"run", "simulator", "uav", "ugv", "scenarios", "figures", "suite"} <= shown


def test_the_weighting_shown_flies(here: Path, command: Any) -> None:
    shown = next(block for block in blocks("python", "README.md") if "def careful" in block)
    assert shown.partition("\n")[2] in PAGES["docs/how-to/own-code.md"]
    (here / "careful_as_shown.py").write_text(shown, encoding="utf-8")
    own = words("--law weighted --set custom.weighting=careful_as_shown:careful --duration 5")
    run = command("run", "--in-process", *own, "--no-files", "--json")
    assert run.returncode == 0, run.stderr
    assert json.loads(run.stdout)["visibility_violations"] == 0


def test_the_path_and_the_policy_shown_fly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own = blocks("python", "docs/how-to/own-code.md")
    shown = "\n".join(block for block in own if block.startswith("# mine.py"))
    (tmp_path / "shown_in_docs.py").write_text(shown, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    changes = {
        "duration": 60.0,
        "law.name": "path",
        "custom.path": "shown_in_docs:ellipse",
        "ugv.0.driver": "policy",
        "custom.policy": "shown_in_docs:drive",
    }
    scenario = load_scenario("escort", overrides=changes)
    assert check_own_functions(scenario) == ()
    summary = outrider.run(scenario, allow_code=True)
    assert summary.visibility_violations == 0
    assert summary.max_distance > 2.5


@pytest.mark.parametrize("page", PAGES)
def test_links_within_the_repository_lead_somewhere(page: str) -> None:
    for target, heading in re.findall(r"\]\(([^)#:\s]*)(?:#([^)\s]*))?\)", prose(page)):
        path = (ROOT / page).parent / target if target else ROOT / page
        assert path.exists(), target
        if heading:
            headings = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
            anchors = {re.sub(r"[^\w -]", "", one.lower()).replace(" ", "-") for one in headings}
            assert heading in anchors, f"{target}#{heading}"


@pytest.mark.parametrize("page", PAGES)
def test_documented_names_and_paths_exist(page: str) -> None:
    groups = {f"outrider.{group}" for group in GROUPS}  # of entry points
    shown = set(re.findall(r"`((?:agents|sim|bus|outrider)(?:\.[A-Za-z_]\w*)+)", PAGES[page]))
    for name in shown - groups:
        pkgutil.resolve_name(name)
    folders = "agents|sim|bus|outrider|extensions|tests|benchmarks|examples|docs"
    paths = set(re.findall(rf"`((?:{folders})/[\w./-]*)", PAGES[page]))
    for path in paths - {one for one in paths if re.match(r"outrider/[A-Z]", one)}:
        assert (ROOT / path).exists(), path
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    assert set(re.findall(r"(?:`|^)make ([a-z-]+)", PAGES[page], re.MULTILINE)) <= targets


@pytest.mark.parametrize("program", ["certificate_tables", "cautious_attacks"])
def test_documented_tables_of_benchmarks_exist(program: str) -> None:
    shown = re.findall(
        rf"benchmarks/{program}\.py (\w+)`?(?: and `(\w+)`)?", "".join(PAGES.values())
    )
    path = str(ROOT / "benchmarks" / f"{program}.py")
    found = subprocess.run([sys.executable, path], capture_output=True, text=True, check=False)
    allowed = set(found.stderr.rsplit("allowed: ", 1)[1].strip().split(", "))
    assert {name for pair in shown for name in pair if name} <= allowed
    assert shown


def test_tutorial_for_integrators_prints_what_it_shows(
    here: Path, command: Any, endpoint: str
) -> None:
    page, default = "docs/tutorial-integration.md", "tcp/127.0.0.1:17447"
    (own,) = blocks("python", page)
    (here / "circle.py").write_text(own, encoding="utf-8")
    *flights, terminals = blocks("sh", page)
    printed = ""
    for line in "\n".join(flights).splitlines():
        options = shlex.split(line)[1:]
        if line.startswith("outrider ") and "--with" not in options:
            done = command(*options, *(["--in-process"] if options[0] == "run" else []))
            assert done.returncode == 0, done.stderr
            printed += done.stdout
    simulator, uav, ugv = (shlex.split(line)[1:] for line in terminals.splitlines())
    program = (ROOT / "examples" / Path(*ugv).name).read_text(encoding="utf-8")
    (here / "ugv.py").write_text(program.replace(default, endpoint), encoding="utf-8")
    with started(*simulator, "--listen", endpoint) as run:
        wait_until(Path(endpoint.removeprefix("unixsock-stream/")).exists)
        with started(*uav, "--connect", endpoint):
            ran([sys.executable, here / "ugv.py"], check=True)
            printed += "".join(run.communicate(timeout=60.0)).replace(endpoint, default)
    for line in "".join(blocks("text", page)).splitlines():
        assert in_words(line) in in_words(printed), line


def in_words(table: str) -> str:
    return " ".join(re.split(r"[│\s]+", table))


def test_every_page_is_in_the_sites_navigation() -> None:
    nav = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").split("\nnav:\n")[1]
    shown = set(re.findall(r"[\w/-]+\.md", nav))
    assert {page.removeprefix("docs/") for page in PAGES if page.startswith("docs/")} <= shown


@pytest.mark.parametrize("page", [page for page in PAGES if page.startswith("extensions/")])
def test_files_that_an_extension_names_are_its_own(page: str) -> None:
    own = {path.name for path in (ROOT / page).parent.rglob("*.py")}
    assert set(re.findall(r"`(\w+\.py)`", PAGES[page])) <= own


def test_all_optional_methods_of_a_pilot_are_documented() -> None:
    methods = re.findall(r"- `(\w+\(\w*\))`", inspect.getdoc(Pilot) or "")
    shown = re.findall(r"^\| `(\w+\(\w*\))` \|", PAGES["docs/how-to/own-code.md"], re.MULTILINE)
    assert shown == methods != []


def test_numbers_in_prose_are_those_of_the_code() -> None:
    text = {page: " ".join(shown.split()) for page, shown in PAGES.items()}
    assert MOST_LINES == 1_000_000
    limit = f"Files of more than {MOST_BYTES >> 20} MiB or one million lines"
    assert limit in text["docs/how-to/network.md"]
    environment = text["docs/reference/environment.md"]
    row = f"shape `({len(UAV)},)` for a UAV, `({len(UAV) + len(ALTITUDE)},)` for one that has an"
    assert row in environment
    assert f"`({len(UGV)},)` for a UGV" in environment
    assert len(ALTITUDE) == len(GRADIENT) == 2
    state = f"`({len(STATE)} + {len(UAV_STATE)} · UAVs + {len(UGV_STATE)} · UGVs,)`"
    assert state in environment
    fixed = ["uav.0.min_altitude=6", "uav.0.max_altitude=24", "law.name=certified"]
    town = load_scenario("town", overrides=fixed)
    lowest = certified_from(uav_briefing(town, "uav_0", town.seed)).split(" at ")[1].split()[0]
    assert f"Below {lowest} m no tick of these flights can" in text["docs/explanation/ground.md"]
