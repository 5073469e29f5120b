"""`outrider check`: validation of a scenario."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated

import typer

from bus.errors import ScenarioError
from outrider.cli import options
from outrider.cli.console import ERR, OUT, print_json, print_warnings
from outrider.running.assumptions import (
    assumption_warnings,
    certified_from,
    how_certifiable,
)
from outrider.running.first_tick import check_first_tick
from outrider.running.own_functions import check_own_functions
from outrider.running.reacquisition import reacquisition
from outrider.running.resolve import resolve
from outrider.running.tolerance import verdict
from outrider.running.user_code import foreign_code
from sim.engine.briefing import uav_briefing
from sim.scenario.checks import scenario_warnings
from sim.scenario.laws import law_title
from sim.scenario.types import NO_UAV, Scenario

_LISTED = 12
"""Largest number of vehicles that are listed by name."""


def command(
    file: Annotated[str, typer.Argument(help="TOML file, or name of a shipped scenario.")],
    seed: options.Seed = None,
    duration: options.Duration = None,
    law: options.LawName = None,
    driver: options.DriverName = None,
    changes: options.Set = None,
    network: options.NetworkName = "",
    allow_code: options.AllowCode = False,
    json: options.Json = False,
) -> None:
    """Validate a scenario without flying it.

    Exits with 0, or with 2 and a line for each independent fault, which names file, field and value. The command
    accepts the options of `run` that change the scenario, and prints the same warnings. With a safety filter, it
    reports the bounds that links or detector may exceed, whether sight can be certified always, not always, hardly ever
    or never, for each single field the smallest change that would make it certifiable, and the time of a search
    after lost sight. Your own functions are loaded and called for one tick; functions named in the file need
    --allow-code.

    Example: outrider check my-scenario.toml --network wifi-poor
    """
    with _each_fault():
        scenario, named = resolve(
            file,
            seed=seed,
            duration=duration,
            law=law,
            driver=driver,
            network=network,
            changes=changes,
        )
    foreign = () if allow_code else foreign_code(scenario, named)
    warnings = [
        *scenario_warnings(scenario),
        *foreign,
        *(() if foreign else check_own_functions(scenario)),
        *assumption_warnings(scenario),
    ]
    if not foreign:
        check_first_tick(scenario)
    certifiable = how_certifiable(scenario)
    verdicts = {uav.name: verdict(scenario, uav) for uav in filter(scenario.filters, scenario.uav)}
    searches = {uav.name: reacquisition(scenario, uav) for uav in scenario.uav}
    if json:
        print_json(
            {
                "scenario": scenario.name,
                "valid": True,
                "certifiable": certifiable,
                "verdicts": {name: one._asdict() for name, one in verdicts.items()},
                "searches": {name: one and one._asdict() for name, one in searches.items()},
                "warnings": warnings,
            }
        )
        return
    print_warnings(warnings)
    for name, one in verdicts.items():
        for line in one.lines:
            OUT.tell(f"{name}: {line}")
    for uav in filter(scenario.filters, scenario.uav):
        lowest = certified_from(uav_briefing(scenario, uav.name, scenario.seed))
        if lowest:
            OUT.tell(f"{uav.name}: {lowest}")
    for name, search in searches.items():
        if search is not None:
            OUT.tell(f"{name}: {search.line}")
    _print_valid(scenario, certifiable)


@contextmanager
def _each_fault() -> Iterator[None]:
    """Print each fault of a scenario that is refused, on a line of its own."""
    try:
        yield
    except ScenarioError as error:
        for line in error.args[:-1]:
            ERR.tell(f"outrider: {line}")
        raise ScenarioError(error.args[-1]) from error


def _print_valid(scenario: Scenario, certifiable: str | None) -> None:
    """Print the vehicles, the law and the duration."""
    names = [vehicle.name for vehicle in scenario.vehicles]
    many = f"{len(scenario.uav):,} UAVs and {len(scenario.ugv):,} UGVs"
    vehicles = ", ".join(names) if len(names) <= _LISTED else many
    law_text = f"law {law_title(scenario)}" if scenario.uav else NO_UAV
    if certifiable not in (None, "always"):
        law_text += f", sight {certifiable} certified"
    OUT.tell(
        f"{scenario.name}: valid ({vehicles}; {law_text}; {scenario.duration:g} s, {scenario.ticks} ticks)"
    )
