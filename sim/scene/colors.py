"""Colors of all pictures: blue for UAVs, orange for UGVs, red for the limit of visibility and for faults."""

from collections.abc import Iterable

from bus.messages.buildings import Building

UAV = ("#1f5fbf", "#5aa9e6", "#173b7a", "#7d8fe0")
"""Blues of the UAVs, in name order; repeated after the last."""
UGV = ("#e8740c", "#f2a65a", "#a8500a", "#f6c453")
"""Oranges of the UGVs, in name order; repeated after the last."""
ESTIMATE = UAV[2]
LIMIT = "#cf2a3c"
"""Color of r_v, r_s and faults."""
GOOD = "#2e8b57"
INK = "#22262d"
MUTED = "#727985"
RULE = "#e6e8ec"
COVERED = ("#fafafa", "#d9e8de", "#86bb9f")
"""Colors from uncovered to covered ground, evenly spaced."""

BUILDINGS = ("#ccd1d8", "#6f7782")
"""Greys of buildings, from the lowest to the highest of a run."""
SHADOW = (INK, 0.2, 0.42)
"""Color of ground hidden from a camera, and the opacities of its paper and of its hatching."""

HAZARDS = {"block": INK, "rough": "#7d6748", "find": "#d9a200"}
"""Colors of hazards, by kind."""
FAINT = 0.35
"""Opacity of a hazard unknown to all UGVs."""
TILES = (
    (MUTED, 0.3),
    ("#ffffff", 0.0),
    (HAZARDS["rough"], 0.3),
    (INK, 0.38),
    (HAZARDS["find"], 0.35),
    (MUTED, 0.14),
)
"""Color and opacity of a tile over its coverage, by its code in a `GroundMap`: unknown tiles are shaded."""


def color(colors: tuple[str, ...], index: int) -> str:
    """Return the color of the vehicle with this index."""
    return colors[index % len(colors)]


def rgb(code: str) -> tuple[float, float, float]:
    """Return red, green and blue of a color, each from 0 to 1."""
    r, g, b = (int(code[k : k + 2], 16) / 255.0 for k in (1, 3, 5))
    return r, g, b


def mixed(start: str, end: str, share: float) -> str:
    """Return the color at this share between two colors."""
    parts = (a + share * (b - a) for a, b in zip(rgb(start), rgb(end), strict=True))
    return "#" + "".join(f"{round(255.0 * part):02x}" for part in parts)


def building(height: float, buildings: Iterable[Building]) -> str:
    """Return the grey of a building of this height [m] among others: the taller, the darker."""
    heights = [one.height for one in buildings]
    lowest, highest = min(heights), max(heights)
    return mixed(*BUILDINGS, (height - lowest) / (highest - lowest) if highest > lowest else 0.5)


def covered(share: float, stops: tuple[str, ...] = COVERED) -> str:
    """Return the color of ground with this share of the desired coverage, from 0 to 1."""
    position = share * (len(stops) - 1)
    k = min(int(position), len(stops) - 2)
    return mixed(stops[k], stops[k + 1], position - k)
