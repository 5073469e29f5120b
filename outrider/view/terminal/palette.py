"""Colors of the scene on a dark terminal."""

from sim.scene import colors

BACKGROUND = "#12151a"
PANEL = "#191d24"
INK = "#dfe3ea"
FAINT = "#8a93a2"
EDGE = "#4a5362"
LIMIT = "#f0576b"
"""Lighter shade of the scene's `LIMIT`."""
GOOD = "#5fc48f"
"""Lighter shade of the scene's `GOOD`."""
UAV = (colors.UAV[1], "#3a6c9c")
"""Colors of the UAV and of its track."""
UGV = (colors.UGV[0], "#99602a")
"""Colors of the UGV and of its track."""
ALARM = colors.LIMIT
HAZARDS = {"block": "#c3cad6", "rough": "#b8945f", "find": "#f2c230"}
"""Colors of known hazards by kind."""
UNKNOWN = {"block": "#5d6675", "rough": "#665640", "find": "#86712f"}
"""Colors of unknown hazards by kind."""
TILES = ("", "", "#3a2f20", "#565e6b", "", "")
"""Colors of tiles by their code in a `GroundMap`; empty: the color of the coverage."""
COVERED = tuple(f"#{18 + 6 * k:02x}{21 + 8 * k:02x}{26 + 5 * k:02x}" for k in range(6))
"""Colors from uncovered to covered ground; muted, so that they become greys on a terminal with 256 colors."""
