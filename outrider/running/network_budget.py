"""Network budget of a scenario as data and as tables, shared by `outrider network budget` and the page of a run."""

import math
from typing import NamedTuple

import msgspec


class BoundRow(msgspec.Struct, frozen=True, kw_only=True):
    """One declared bound of a UAV."""

    uav: str
    bound: str
    """Field of `[certificate]`."""
    symbol: str
    unit: str
    declared: float
    needed: float | None
    """Smallest bound that the UAV's links keep at this risk; None: not a bound of a link, or none does."""
    largest: float | None
    """Largest bound with which sight can be certified, the others as declared; None: there is none."""
    r_cert: float | None
    """r_cert at the largest bound [m]."""


class LinkRow(msgspec.Struct, frozen=True, kw_only=True):
    """Largest value of one property of a link, its others unchanged."""

    uav: str
    link: str
    """`detections` or `commands`."""
    what: str
    """`loss`, `burst`, `delay` or `blackout`."""
    unit: str
    now: float
    as_declared: float | None
    """Largest value with which sight stays certified with the declared bounds; None: even 0 breaks one."""
    at_most: float | None
    """The same with the link's bound as large as the vehicles tolerate."""


class Budget(msgspec.Struct, frozen=True, kw_only=True):
    """Network budget of a scenario."""

    scenario: str
    risk: float
    """Probability with which a run may exceed a bound because of one link."""
    certifiable: str | None
    """As from `outrider check`."""
    r_cert: dict[str, float | None]
    """r_cert with the declared bounds, by UAV [m]; None: nothing can be certified."""
    bounds: list[BoundRow]
    links: list[LinkRow]
    notes: list[str]


class BudgetReport(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Line that `outrider network budget --child` writes to standard output."""

    step: str = ""
    """Current step of the computation."""
    share: float = 0.0
    """Share of the work that is done, 0 to 1."""
    budget: Budget | None = None
    """Result, in the last line."""


class Table(NamedTuple):
    """Table of texts."""

    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    exceeded: tuple[bool, ...]
    """True for a row that breaks the certificate as declared."""


def room(radius: float | None) -> str:
    """Return r_cert with the declared bounds [m] as text; None: nothing can be certified."""
    return "sight cannot be certified" if radius is None else f"r_cert {radius:.3g} m"


def bound_table(found: Budget) -> Table:
    """Return what the vehicles tolerate: each bound as declared, as the links need it, and the largest."""
    rows = tuple(
        (
            one.uav,
            one.bound,
            one.symbol,
            amount(one.declared, one.unit),
            "-" if one.needed is None else amount(one.needed, one.unit),
            "none" if one.largest is None else amount(one.largest, one.unit),
            "-" if one.r_cert is None else amount(one.r_cert, "m"),
        )
        for one in found.bounds
    )
    return Table(
        f"{found.scenario}: bounds at a risk of {found.risk:g} per link",
        ("UAV", "bound", "", "declared", "needed", "largest", "r_cert"),
        rows,
        tuple(
            one.largest is None
            or one.declared > one.largest
            or (one.needed is not None and one.needed > one.declared)
            for one in found.bounds
        ),
    )


def link_table(found: Budget) -> Table:
    """Return what the links may do: the largest value of each property, its others unchanged."""
    rows = tuple(
        (
            f"{one.uav}/{one.link}",
            one.what,
            amount(one.now, one.unit),
            "none" if one.as_declared is None else amount(one.as_declared, one.unit),
            "none" if one.at_most is None else amount(one.at_most, one.unit),
        )
        for one in found.links
    )
    return Table(
        "What the links may do, one property at a time",
        ("link", "property", "now", "with the declared bounds", "with the largest bound"),
        rows,
        tuple(one.as_declared is None or one.now > one.as_declared for one in found.links),
    )


def amount(value: float, unit: str) -> str:
    """Return a limit as text, rounded down; without a unit, as a percentage."""
    if not math.isfinite(value):
        return "unbounded"
    shown = 100.0 * value if not unit else value
    digits = 0 if shown == 0.0 else max(0, 2 - math.floor(math.log10(abs(shown))))
    scale = 10.0**digits
    return f"{math.floor(shown * scale * (1.0 + 1e-9)) / scale:g} {unit or '%'}"
