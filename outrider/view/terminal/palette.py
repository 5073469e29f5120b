"""The scene's colours on a dark terminal."""

from sim.scene import colors

BACKGROUND = "#12151a"
PANEL = "#191d24"
INK = "#dfe3ea"
FAINT = "#8a93a2"
EDGE = "#4a5362"
LIMIT = "#f0576b"
"""`LIMIT`, lighter."""
GOOD = "#5fc48f"
"""`GOOD`, lighter."""
UAV = (colors.UAV[1], "#3a6c9c")
"""The UAV, and where it has been."""
UGV = (colors.UGV[0], "#99602a")
"""The UGV, and where it has been."""
ALARM = colors.LIMIT
HAZARDS = {"block": "#c3cad6", "rough": "#b8945f", "find": "#f2c230"}
"""Of hazards by their kind, on a dark ground."""
UNKNOWN = {"block": "#5d6675", "rough": "#665640", "find": "#86712f"}
"""Of those that no UGV knows of."""
TILES = ("", "", "#3a2f20", "#565e6b", "", "")
"""Of tiles that are known to be more than ground, by their code in a `GroundMap`; empty: as it is covered."""
COVERED = tuple(f"#{18 + 6 * k:02x}{21 + 8 * k:02x}{26 + 5 * k:02x}" for k in range(6))
"""From unseen ground to covered ground; so little colour that they become greys where there are only 256."""
