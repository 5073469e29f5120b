"""Tables of the environment's observations and state."""

from functools import partial

from structs import cell

from bus.observations import SYMBOLS, TABLES, markdown
from outrider_learning.egocentric import UAV_BODY, UGV_BODY

TABLE_OF = {**TABLES, "uav_body": UAV_BODY, "ugv_body": UGV_BODY}
"""All tables, by mark."""


def symbols() -> str:
    """Return the table of the symbols in the ranges."""
    return "\n".join(
        ["| symbol | meaning |", "|---|---|"]
        + [f"| `{name}` | {cell(meaning)} |" for name, meaning in SYMBOLS.items()]
    )


PAGES = {
    **{name: partial(markdown, table) for name, table in TABLE_OF.items()},
    "observation_symbols": symbols,
}
"""Generator of each mark."""
