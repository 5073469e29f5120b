"""Work of `outrider network chances`, `bounds` and `budget`."""

import sys

import msgspec

from outrider.cli.console import (
    OUT,
    print_json,
    print_table,
    print_warnings,
    share_progress,
)
from outrider.running.network_budget import BudgetReport, bound_table, link_table, room
from outrider.running.parent import read_start
from outrider_networks.budget import budget, check_risk
from outrider_networks.scenario_bounds import bounds_for, exceedance, in_runs
from sim.scenario.resolved import resolved
from sim.scenario.types import Scenario


def print_chances(scenario: Scenario, *, json: bool) -> None:
    """Print the probabilities that a run exceeds its declared bounds."""
    found = exceedance(scenario)
    if json:
        print_json(found)
        return
    rows = [
        (name, "unknown" if value is None else in_runs(value))
        for name, value in found.exceedance_probability.items()
    ]
    print_table(("bound", "exceeded"), rows, title=f"{found.scenario}: declared bounds")
    lost = found.loss_probability
    kept = "is not guaranteed" if lost is None else f"is lost {in_runs(lost)}"
    OUT.tell(f"\ncertified visibility {kept}")


def print_bounds(scenario: Scenario, risk: float, *, json: bool) -> None:
    """Print the smallest bounds for a risk."""
    check_risk(risk)
    found = bounds_for(scenario, risk)
    if json:
        print_json(found)
        return
    for field, value in found.set.items():
        OUT.tell(f"--set {field}={value!r}")


def print_budget(scenario: Scenario, risk: float, *, json: bool) -> None:
    """Print the network budget of a scenario."""
    check_risk(risk)
    with share_progress("computing") as show:
        found = budget(scenario, risk, show)
    if json:
        print_json(found)
        return
    for uav, radius in found.r_cert.items():
        OUT.tell(f"{uav}: {room(radius)} with the declared bounds")
    for table in (bound_table(found), link_table(found)):
        print_table(table.headings, table.rows, title=table.title)
    print_warnings(found.notes)


def report_budget(risk: float) -> None:
    """Compute the network budget of the scenario on standard input, and report progress on standard output."""
    scenario = resolved(read_start().scenario)
    check_risk(risk)

    def report(line: BudgetReport) -> None:
        sys.stdout.write(msgspec.json.encode(line).decode() + "\n")
        sys.stdout.flush()

    found = budget(scenario, risk, lambda step, share: report(BudgetReport(step=step, share=share)))
    report(BudgetReport(share=1.0, budget=found))
