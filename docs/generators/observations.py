"""Observations and state of the environment, from the tables of their entries."""

from functools import partial

from structs import cell

from bus.observations import SYMBOLS, TABLES, markdown
from outrider_learning.egocentric import UAV_BODY, UGV_BODY

TABLE_OF = {**TABLES, "uav_body": UAV_BODY, "ugv_body": UGV_BODY}
"""Tables by their marks."""


def symbols() -> str:
    """Return the symbols in the ranges."""
    return "\n".join(
        ["| symbol | meaning |", "|---|---|"]
        + [f"| `{name}` | {cell(meaning)} |" for name, meaning in SYMBOLS.items()]
    )


PAGES = {
    **{name: partial(markdown, table) for name, table in TABLE_OF.items()},
    "observation_symbols": symbols,
}
"""Generated text of each mark."""
