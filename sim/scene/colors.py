"""The colours of every picture: blue flies, orange drives, red is the limit of sight and whatever goes wrong."""

UAV = ("#1f5fbf", "#5aa9e6", "#173b7a", "#7d8fe0")
"""Blues of the UAVs, in name order; from the first again after the last."""
UGV = ("#e8740c", "#f2a65a", "#a8500a", "#f6c453")
"""Oranges of the UGVs, alike."""
ESTIMATE = UAV[2]
LIMIT = "#cf2a3c"
"""r_v, r_s, and whatever goes wrong."""
GOOD = "#2e8b57"
INK = "#22262d"
MUTED = "#727985"
RULE = "#e6e8ec"
COVERED = ("#fafafa", "#d9e8de", "#86bb9f")
"""From unseen ground to covered ground, evenly spaced."""

HAZARDS = {"block": INK, "rough": "#7d6748", "find": "#d9a200"}
"""Of hazards, by their kind."""
FAINT = 0.35
"""Opacity of a hazard that nobody who drives knows of."""
TILES = (
    (MUTED, 0.3),
    ("#ffffff", 0.0),
    (HAZARDS["rough"], 0.3),
    (INK, 0.38),
    (HAZARDS["find"], 0.35),
    (MUTED, 0.14),
)
"""Colour and opacity of a tile over its coverage, by its code in a `GroundMap`: what is not known lies under a veil."""


def color(colors: tuple[str, ...], index: int) -> str:
    """The colour of the vehicle with this index."""
    return colors[index % len(colors)]


def rgb(code: str) -> tuple[float, float, float]:
    """Red, green and blue of a colour, each from 0 to 1."""
    r, g, b = (int(code[k : k + 2], 16) / 255.0 for k in (1, 3, 5))
    return r, g, b


def mixed(start: str, end: str, share: float) -> str:
    """The colour at this share of the way from one to another."""
    parts = (a + share * (b - a) for a, b in zip(rgb(start), rgb(end), strict=True))
    return "#" + "".join(f"{round(255.0 * part):02x}" for part in parts)


def covered(share: float, stops: tuple[str, ...] = COVERED) -> str:
    """The colour of ground whose coverage is this share of what is wanted, from 0 to 1."""
    place = share * (len(stops) - 1)
    k = min(int(place), len(stops) - 2)
    return mixed(stops[k], stops[k + 1], place - k)
