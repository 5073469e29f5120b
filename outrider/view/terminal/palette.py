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
COVERED = tuple(f"#{18 + 6 * k:02x}{21 + 8 * k:02x}{26 + 5 * k:02x}" for k in range(6))
"""From unseen ground to covered ground; so little colour that they become greys where there are only 256."""
