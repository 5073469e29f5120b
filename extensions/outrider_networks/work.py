"""Work of `outrider network chances`, `bounds` and `budget`."""

import math

from bus.errors import ScenarioError
from bus.numbers import exact
from outrider.cli.console import ERR, OUT, print_json, print_table, print_warnings
from outrider_networks.budget import budget
from outrider_networks.scenario_bounds import bounds_for, exceedance, in_runs
from sim.scenario.types import Scenario


def _check_risk(risk: float) -> None:
    """Check a probability.

    Raises:
        ScenarioError: If it is not between 0 and 1.
    """
    if not 0.0 < risk < 1.0:
        raise ScenarioError(f"--risk {exact(risk)}: out of range; allowed: above 0 and below 1")


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
    _check_risk(risk)
    found = bounds_for(scenario, risk)
    if json:
        print_json(found)
        return
    for field, value in found.set.items():
        OUT.tell(f"--set {field}={value!r}")


def print_budget(scenario: Scenario, risk: float, *, json: bool) -> None:
    """Print the network budget of a scenario."""
    _check_risk(risk)
    with ERR.status("computing") as status:
        found = budget(scenario, risk, lambda now: status.update(f"computing: {now}"))
    if json:
        print_json(found)
        return
    for uav, radius in found.r_cert.items():
        room = "sight cannot be certified" if radius is None else f"r_cert {radius:.3g} m"
        OUT.tell(f"{uav}: {room} with the declared bounds")
    rows = [
        (
            one.uav,
            one.bound,
            one.symbol,
            _amount(one.declared, one.unit),
            "-" if one.needed is None else _amount(one.needed, one.unit),
            "none" if one.largest is None else _amount(one.largest, one.unit),
            "-" if one.r_cert is None else _amount(one.r_cert, "m"),
        )
        for one in found.bounds
    ]
    bounds = ("UAV", "bound", "", "declared", "needed", "largest", "r_cert")
    print_table(bounds, rows, title=f"{found.scenario}: bounds at a risk of {risk:g} per link")
    linked = [
        (
            f"{one.uav}/{one.link}",
            one.what,
            _amount(one.now, one.unit),
            "none" if one.as_declared is None else _amount(one.as_declared, one.unit),
            "none" if one.at_most is None else _amount(one.at_most, one.unit),
        )
        for one in found.links
    ]
    links = ("link", "property", "now", "with the declared bounds", "with the largest bound")
    print_table(links, linked, title="What the links may do, one property at a time")
    print_warnings(found.notes)


def _amount(value: float, unit: str) -> str:
    """Return a limit as text, rounded down; without a unit, as a percentage."""
    if not math.isfinite(value):
        return "unbounded"
    shown = 100.0 * value if not unit else value
    digits = 0 if shown == 0.0 else max(0, 2 - math.floor(math.log10(abs(shown))))
    scale = 10.0**digits
    return f"{math.floor(shown * scale * (1.0 + 1e-9)) / scale:g} {unit or '%'}"
