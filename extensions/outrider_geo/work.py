"""Work of `outrider scenarios import`."""

import shlex
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from bus.errors import ScenarioError
from bus.files import write_whole
from bus.numbers import exact
from outrider.cli.console import ERR, OUT, print_json, print_table, print_warnings
from outrider.running.tolerance import Verdict, verdict
from outrider_geo.heights import STOREY
from outrider_geo.reading import Buildings, read_buildings
from outrider_geo.scenario_text import scenario_text
from outrider_geo.statements import NO_LICENCE
from outrider_geo.town import Options, Town, as_json, highest_building, import_town
from outrider_geo.vehicles import plan_vehicles
from sim.input.faults import one_line
from sim.input.reading import parse_toml, typed
from sim.scenario.checks import check_scenario
from sim.scenario.loading import scenario_names
from sim.scenario.types import Scenario

_SKIPPED = {
    "not_buildings": "features that are no buildings",
    "underground": "underground buildings",
    "without_polygon": "buildings without a polygon: points and lines have no walls",
    "outside": "polygons outside the area",
    "dropped": "merged buildings smaller than --min-area",
}
_DONE = {
    "repaired": "invalid polygons repaired; all their walls are kept",
    "contacts": "pairs of buildings touched or overlapped",
    "courts": "courts filled: no vehicle can be there",
    "raised": "buildings raised to the highest one they are merged with",
}


def write_town(file: Path, out: Path, options: Options, *, force: bool, json: bool) -> None:
    """Import a town, write its scenario and report what was done.

    Args:
        file: GeoJSON file.
        out: Scenario file.
        options: Options of the import.
        force: Replace an existing file.
        json: Print a JSON object instead of tables.

    Raises:
        ScenarioError: If the file has no usable buildings, or the scenario cannot be written there.
    """
    _check_out(out, force=force)
    name = one_line(str(file))
    with ERR.status("importing"):
        found = read_buildings(file)
        town = import_town(found, options, name)
        vehicles = plan_vehicles(town, options.clearance, name)
        title = f"A UGV crosses {one_line(out.stem)}"
        text = scenario_text(town, vehicles, options.clearance, title, [*_comments(file, found)])
        fault, seen = _judged(text, str(out))
    write_whole(out, text.encode("utf-8"))
    if json:
        report = {
            "scenario": str(out),
            "valid": not fault,
            "certifiable": seen and seen.certifiable,
        }
        print_json({**report, **as_json(town), "statements": found.statements})
    else:
        _print(town, found.statements, options)
    if fault:
        raise ScenarioError(f"{fault} (the scenario is written)")
    if seen is not None and not json:
        for line in seen.lines:
            OUT.tell(f"uav_0: {line}")
        quoted = shlex.quote(str(out))
        OUT.tell(
            f"{out}: written; outrider check {quoted} validates it, outrider run {quoted} flies it"
        )


def _judged(text: str, file: str) -> tuple[str, Verdict | None]:
    """Return the fault of a scenario's text, empty if it is valid, and then the verdict on the sight of its UGV."""
    try:
        scenario = typed(parse_toml(text, file=file), Scenario, file=file)
        scenario = check_scenario(scenario, source=file)
    except ScenarioError as error:
        return str(error), None
    return "", verdict(scenario, scenario.uav[0])


def _check_out(out: Path, *, force: bool) -> None:
    """Check that a scenario can be written there, before the work."""
    name = one_line(str(out))
    if out.suffix != ".toml":
        raise ScenarioError(f"--out {name}: wrong ending; allowed: {one_line(out.name)}.toml")
    if out.stem in scenario_names():
        raise ScenarioError(f"--out {name}: name of a shipped scenario; allowed: another name")
    if out.exists() and not force:
        raise ScenarioError(f"--out {name}: exists already; --force replaces it")


def _comments(file: Path, found: Buildings) -> Iterator[str]:
    yield f"Buildings of {one_line(file.name)}, imported with outrider scenarios import."
    yield from found.statements


def _print(town: Town, stated: tuple[str, ...], options: Options) -> None:
    """Print what was done."""
    rows = [
        (one.name, f"{one.buildings:,}", f"{one.corners:,}", f"{one.area:,.0f}")
        for one in town.steps
    ]
    right = ("buildings", "corners", "area [m²]")
    size = f"{exact(town.area.width)} x {exact(town.area.height)} m"
    title = f"{size}, highest building {exact(highest_building(town))} m"
    print_table(("step", *right), rows, right=right, title=title)
    for line in _lines(town.counts, options):
        OUT.tell(line)
    OUT.tell(
        f"{town.uncovered:.3g} m² of the given buildings inside the area are outside the imported ones"
    )
    for line in stated:
        (print_warnings([line]) if line == NO_LICENCE else OUT.tell(line))


def _lines(counts: Counter[str], options: Options) -> Iterator[str]:
    for key, text in _DONE.items():
        if counts[key]:
            yield f"{counts[key]:,} {text}"
    default = counts["height_missing"] + counts["height_unreadable"]
    yield (
        f"heights: {counts['height_height']:,} given, {counts['height_levels']:,} from levels of {exact(STOREY)} m, "
        f"{default:,} unknown: {exact(options.height)} m"
    )
    if counts["height_unreadable"]:
        yield f"{counts['height_unreadable']:,} heights unreadable: taken for unknown"
    for key, text in _SKIPPED.items():
        if counts[key]:
            yield f"not imported: {counts[key]:,} {text}"
