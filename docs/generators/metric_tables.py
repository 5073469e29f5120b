"""Reference of the metrics, generated from their table."""

from structs import cell, check_description

from outrider.running.metrics import LINK_COLUMNS, TABLES, Metric


def tables() -> str:
    """Return a section for each table.

    Raises:
        ValueError: If a metric has no meaning, or a quantity no unit.
    """
    return "\n\n".join(_section(heading, [*rows.values()]) for heading, rows in TABLES.items())


def _section(heading: str, metrics: list[Metric]) -> str:
    rows = ["| name | unit | meaning | merged by | column in a sweep |", "|---|---|---|---|---|"]
    for one in metrics:
        check_description(f"{heading}, {one.name}", one.meaning, quantity=False)
        if one.column == "double" and not one.unit:
            raise ValueError(f"{heading}, {one.name}: no unit")
        unit = "share" if one.unit == "%" else one.unit
        meaning = f"{one.meaning} Any value other than 0 contradicts a guarantee." * one.guaranteed
        cells = (unit, meaning or one.meaning, one.total, _column(heading, one))
        rows.append(f"| `{one.name}` | {' | '.join(map(cell, cells))} |")
    return f"## {heading}\n\n" + "\n".join(rows)


def _column(heading: str, metric: Metric) -> str:
    """Return the columns of a metric in a sweep."""
    if not metric.column:
        return ""
    kinds = [f"{kind}_" for kind in LINK_COLUMNS] if heading == "Link" else [""]
    return ", ".join(f"`{kind}{metric.name}`" for kind in kinds)
