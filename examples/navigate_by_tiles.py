"""Navigation policy that drives where the known tiles leave room.

python examples/navigate_by_tiles.py      its row in the missions' table, beside the driver `navigate`
outrider run minefield --driver policy:navigate_by_tiles:policy      in this folder
"""

import gymnasium
import numpy as np

from outrider_learning.suite.board import leaderboard
from outrider_learning.suite.scoring import Team
from outrider_learning.suite.tasks import suite

SIDE, TILE, SPEED, BRAKES = 21, 0.5, 0.3, 0.03  # tiles, m, m/s, m/s²
HEADINGS = np.linspace(-np.pi, np.pi, 32, endpoint=False)
STEPS = np.arange(1, 2 * (SIDE // 2) + 1) / 2  # along a heading, in tiles
ALONG = STEPS * np.stack([np.sin(HEADINGS), np.cos(HEADINGS)])[..., None]
ROWS, COLUMNS = SIDE // 2 + np.rint(ALONG).astype(int)
BESIDE = (0, 0), (0, 1), (1, 0), (0, -1), (-1, 0)


def drive(observation):
    """Return accelerations (worlds, 2) from rows (worlds, 8) and tiles (worlds, 21, 21)."""
    _, x, y, v_x, v_y, underway, goal_x, goal_y = observation["row"].T
    shut = np.isin(observation["tiles"], (0, 3, 5))  # unknown, blocked, beyond the area
    room = np.pad(shut, ((0, 0), (1, 1), (1, 1)))
    shut = sum(room[:, 1 + a : 1 + a + SIDE, 1 + b : 1 + b + SIDE] for a, b in BESIDE)
    met = shut[:, ROWS, COLUMNS] > 0
    free = np.where(met.any(axis=2), met.argmax(axis=2), len(STEPS)) * TILE / 2  # m, each heading
    free = np.minimum(free, np.hypot(goal_x - x, goal_y - y)[:, None])
    towards = np.arctan2(goal_y - y, goal_x - x)[:, None]
    turn = HEADINGS - np.arctan2(v_y, v_x)[:, None]
    steady = 2.0 * np.cos(turn) * np.hypot(v_x, v_y)[:, None]
    best = np.argmax(np.cos(HEADINGS - towards) * free + steady, axis=1)
    speed = underway * np.minimum(SPEED, np.sqrt(BRAKES * free[np.arange(len(best)), best]))
    wanted = speed[:, None] * np.stack([np.cos(HEADINGS[best]), np.sin(HEADINGS[best])], axis=1)
    change = wanted - np.stack([v_x, v_y], axis=1)  # m/s², within the UGV's limit
    return change * np.minimum(1.0, BRAKES / np.maximum(np.hypot(*change.T), 1e-9))[:, None]


class Policy:
    """Policy for one UGV, for `custom.policy`."""

    observation_space = gymnasium.spaces.Dict(
        row=gymnasium.spaces.Box(-np.inf, np.inf, (8,), np.float64),
        tiles=gymnasium.spaces.Box(0, 5, (SIDE, SIDE), np.uint8),
    )

    def predict(self, observation):
        return drive({name: np.asarray(value)[None] for name, value in observation.items()})[0]


policy = Policy()

if __name__ == "__main__":
    board = leaderboard(
        {"navigate": "certified", "by tiles": Team(uav="certified", ugv=drive)},
        tasks=[suite("missions-v1")["minefield"]],
    )
    print(board.markdown())
