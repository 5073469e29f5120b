"""Train UAV and UGV as one team to cross a minefield: multi-agent PPO (MAPPO) in many worlds at once.

Each side has its own observation: the UGV the tiles from its sensor and the radio, the UAV its estimate of the UGV and
the coverage gradient. The critic, used in training only, has both. The UAV runs inside the safety filter. Initially the
UGV drives straight at its goal, and the UAV follows the gradient.

    pip install -e '.[sb3]'        # for PyTorch
    python examples/train_mission.py --minutes 5
"""

import argparse
import copy
import time
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import nn

import outrider
from outrider_learning.suite.board import leaderboard
from outrider_learning.suite.scoring import Team
from outrider_learning.suite.tasks import SEEDS, suite
from sim.models.ground import UNSEEN
from sim.models.hazards import BLOCK

REPEAT = 20  # ticks (one second) between two decisions
SECTORS, TILE, LAG = 16, 0.5, 8  # sectors of the UGV's view; tile size [m]; decisions
DISCOUNT, TRACE, CLIP, RATE, EPOCHS, MINIBATCHES = 0.97, 0.95, 0.2, 1e-3, 4, 8
STEPS, SCALE = 64, 0.1  # decisions per rollout; scale of the rewards
LOG_STD = -0.7  # initial value
HIT = 20.0
REPORT = 5  # rollouts between two printed lines
REWARDS = outrider.RewardWeights(
    uncovered=0.0, sight_lost=0.0, out_of_sight=0.0, progress=1.0, goal=5.0, hit=HIT, reported=0.02
)
VIEW = {"estimate": True, "gradient": True, "safety_filter": True}
V_UGV, V_UAV = 0.2, 0.5  # largest chosen speeds [m/s]


def frame(row):
    """Return the unit vector to the UGV's goal in each world, and its distance [m]."""
    offset = row[:, 6:8] - row[:, 1:3]
    far = np.linalg.norm(offset, axis=1)
    return offset / np.maximum(far, 1e-6)[:, None], far


def turned(vectors, axis):
    """Rotate vectors into the frame whose first axis is `axis`."""
    ahead = (vectors * axis).sum(-1)
    left = vectors[..., 1] * axis[..., 0] - vectors[..., 0] * axis[..., 1]
    return np.stack([ahead, left], -1)


@dataclass
class UgvSide:
    """Inputs of the UGV's network, and the velocity of an action."""

    size: int = 2 * SECTORS + 4

    def features(self, seen):
        """Return the proximity of blocked and unknown ground by sector around the goal's direction, and velocity."""
        row, tiles = seen["row"], seen["tiles"]
        axis, far = frame(row)
        middle = np.arange(tiles.shape[1]) - tiles.shape[1] // 2
        grid = TILE * np.stack(np.meshgrid(middle, middle), -1).reshape(1, -1, 2)
        inside = np.mod(row[:, 1:3], TILE) - 0.5 * TILE
        points = turned(grid - inside[:, None], axis[:, None])
        near = np.exp(-np.linalg.norm(points, axis=2))
        sector = np.floor(np.arctan2(points[..., 1], points[..., 0]) / (2 * np.pi) * SECTORS + 0.5)
        sector = sector.astype(int) % SECTORS
        flat, worlds = tiles.reshape(len(tiles), -1), np.arange(len(tiles))[:, None]
        columns = []
        for state in (BLOCK, UNSEEN):
            nearest = np.zeros((len(tiles), SECTORS))
            np.maximum.at(nearest, (worlds, sector), np.where(flat == state, near, 0.0))
            columns.append(nearest)
        own = turned(row[:, 3:5], axis) / V_UGV
        return np.hstack([*columns, own, np.minimum(far, 10.0)[:, None] / 10.0, row[:, 5:6]])

    def velocity(self, seen, action):
        """Return the velocity straight at the goal, corrected by the action."""
        axis, _ = frame(seen["row"])
        wanted = np.array([1.0, 0.0]) + action
        wanted /= np.maximum(np.linalg.norm(wanted, axis=1), 1.0)[:, None]
        return V_UGV * turned(wanted, axis * [1.0, -1.0])


@dataclass
class UavSide:
    """Inputs of the UAV's network, with a memory of the UGV's positions."""

    size: int = 9
    past: list = field(default_factory=list)

    def features(self, seen):
        """Return the relative position, both velocities, and the coverage gradient."""
        ugv = seen[:, 1:3] - seen[:, 6:8]
        starting = seen[:, 0] < 0.01
        self.past = [np.where(starting[:, None], ugv, one) for one in self.past[-LAG:]] + [ugv]
        moved = (ugv - self.past[0]) / (V_UGV * REPEAT * 0.05 * LAG)
        return np.hstack(
            [seen[:, 6:8] / 3.0, seen[:, 3:5] / V_UAV, moved, seen[:, 9:11], seen[:, 5:6]]
        )

    def velocity(self, seen, action):
        """Return the velocity along the gradient, limited in distance and corrected by the action."""
        wanted = 0.8 * seen[:, 9:11] - 0.2 * seen[:, 6:8] + action
        wanted /= np.maximum(np.linalg.norm(wanted, axis=1), 1.0)[:, None]
        return V_UAV * wanted


def acceleration(seen, wanted):
    """Return the acceleration that reaches a velocity in half a second [m/s²]."""
    row = seen["row"] if isinstance(seen, dict) else seen
    return (wanted - row[:, 3:5]) / 0.5


class Actor(nn.Module):
    """Normal distribution of one side's actions, with an initial mean of 0."""

    def __init__(self, size):
        super().__init__()
        self.net = nn.Sequential(
            nn.Linear(size, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, 2)
        )
        nn.init.zeros_(self.net[-1].weight)
        nn.init.zeros_(self.net[-1].bias)
        self.log_std = nn.Parameter(torch.full((2,), LOG_STD))

    def forward(self, features):
        return torch.distributions.Normal(self.net(features), self.log_std.exp())


class Pilot:
    """Trained side for `leaderboard`: observations of all worlds in, accelerations out."""

    def __init__(self, side, actor):
        self.side, self.actor, self.tick = side, actor, 0

    def __call__(self, seen):
        if self.tick % REPEAT == 0:
            with torch.no_grad():
                features = torch.as_tensor(self.side.features(seen), dtype=torch.float32)
                self.action = self.actor(features).mean.numpy().astype(float)
            self.wanted = self.side.velocity(seen, self.action)
        self.tick += 1
        return acceleration(seen, self.wanted)


class Trainer:
    """Both actors, the critic, and the training worlds."""

    def __init__(self, task, worlds, seed):
        torch.manual_seed(seed)
        self.env = outrider.parallel_vector_env(
            task.scenario,
            num_envs=worlds,
            rewards=REWARDS,
            end_on_sight_lost=False,
            end_on_goals_reached=True,
            dtype=np.float64,
            **VIEW,
        )
        self.sides = {"uav_0": UavSide(), "ugv_0": UgvSide()}
        self.actors = {name: Actor(side.size) for name, side in self.sides.items()}
        size = sum(side.size for side in self.sides.values())
        self.critic = nn.Sequential(
            nn.Linear(size, 128), nn.Tanh(), nn.Linear(128, 128), nn.Tanh(), nn.Linear(128, 1)
        )
        own = [parameter for actor in self.actors.values() for parameter in actor.parameters()]
        self.parameters = [*own, *self.critic.parameters()]
        self.optimizer = torch.optim.Adam(self.parameters, lr=RATE)
        self.seen, _ = self.env.reset(seed=seed * 1000)
        self.steps, self.ended, self.hits = 0, 0, 0
        self.now = self.inputs()

    def inputs(self):
        """Return the features of both sides."""
        return {
            name: torch.as_tensor(side.features(self.seen[name]), dtype=torch.float32)
            for name, side in self.sides.items()
        }

    def step(self, actions):
        """Make one decision in all worlds; return the team's reward and the ended episodes."""
        worlds = self.env.num_envs
        paid, over, hit = np.zeros(worlds), np.zeros(worlds, bool), np.zeros(worlds, bool)
        wanted = {
            name: side.velocity(self.seen[name], actions[name].numpy().astype(float))
            for name, side in self.sides.items()
        }
        for _ in range(REPEAT):
            commands = {name: acceleration(self.seen[name], wanted[name]) for name in wanted}
            self.seen, rewards, terminated, truncated, _ = self.env.step(commands)
            paid += np.where(over | hit, 0.0, sum(rewards.values()))
            hit |= rewards["ugv_0"] < -0.5 * HIT
            over |= terminated["ugv_0"] | truncated["ugv_0"]
        if hit.any():  # restart after a hit
            self.seen, _ = self.env.reset(options={"reset_mask": hit})
        self.steps, self.hits = self.steps + worlds, self.hits + int(hit.sum())
        self.ended += int((over | hit).sum())
        return torch.as_tensor(SCALE * paid, dtype=torch.float32), torch.as_tensor(over | hit)

    def rollout(self):
        """Return decisions with their rewards, and their advantages."""
        kept, features = [], self.now
        with torch.no_grad():
            for _ in range(STEPS):
                chances = {name: actor(features[name]) for name, actor in self.actors.items()}
                actions = {name: chance.sample() for name, chance in chances.items()}
                logs = {name: chances[name].log_prob(actions[name]).sum(-1) for name in actions}
                value = self.critic(torch.cat(list(features.values()), 1)).squeeze(1)
                reward, over = self.step(actions)
                kept.append((features, actions, logs, value, reward, over))
                features = self.now = self.inputs()
            value = self.critic(torch.cat(list(features.values()), 1)).squeeze(1)
            gain, gains = torch.zeros_like(value), []
            for *_, before, reward, over in reversed(kept):
                value = torch.where(over, 0.0, value)
                gain = (
                    reward
                    + DISCOUNT * value
                    - before
                    + DISCOUNT * TRACE * torch.where(over, 0.0, gain)
                )
                gains.append(gain)
                value = before
        return kept, torch.cat(gains[::-1])

    def learn(self):
        """Learn from one rollout; return the mean reward per decision."""
        kept, gains = self.rollout()
        stacked = {
            name: [torch.cat([one[k][name] for one in kept]) for k in range(3)]
            for name in self.actors
        }
        targets = gains + torch.cat([one[3] for one in kept])
        gains = (gains - gains.mean()) / (gains.std() + 1e-6)
        for _ in range(EPOCHS):
            for chosen in torch.randperm(len(gains)).chunk(MINIBATCHES):
                loss = torch.zeros(())
                for name, actor in self.actors.items():
                    features, actions, logs = (one[chosen] for one in stacked[name])
                    chance = actor(features)
                    ratio = (chance.log_prob(actions).sum(-1) - logs).exp()
                    bound = ratio.clamp(1.0 - CLIP, 1.0 + CLIP)
                    loss = loss - torch.minimum(ratio * gains[chosen], bound * gains[chosen]).mean()
                both = torch.cat([stacked[name][0][chosen] for name in self.actors], 1)
                loss = loss + 0.5 * (self.critic(both).squeeze(1) - targets[chosen]).square().mean()
                self.optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(self.parameters, 0.5)
                self.optimizer.step()
        return float(torch.cat([one[4] for one in kept]).mean()) / SCALE

    def team(self):
        """Return both sides as a team."""
        return Team(
            uav=Pilot(UavSide(), self.actors["uav_0"]), ugv=Pilot(UgvSide(), self.actors["ugv_0"])
        )


def main():
    """Train, and compare the team with other entries."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--minutes", type=float, default=5.0, help="Training time [min].")
    parser.add_argument("--task", default="minefield", help="Task of the suite missions-v1.")
    parser.add_argument("--worlds", type=int, default=64)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--flights", type=int, default=20, help="Runs per entry in the table.")
    parser.add_argument(
        "--laws",
        default="none,certified,lookahead",
        help="Entries beside the team, comma-separated.",
    )
    given = parser.parse_args()
    torch.set_num_threads(1)
    task = suite("missions-v1")[given.task]
    trainer = Trainer(task, given.worlds, given.seed)
    untrained = copy.deepcopy(trainer.team())
    started, rollouts, ended, hits, paid = time.perf_counter(), 0, 0, 0, 0.0
    while time.perf_counter() - started < 60.0 * given.minutes:
        paid, rollouts = paid + trainer.learn() / REPORT, rollouts + 1
        if rollouts % REPORT == 0:
            minutes = (time.perf_counter() - started) / 60.0
            print(
                f"{minutes:5.2f} min {trainer.steps:8d} decisions  reward per decision {paid:+.3f}  "
                f"episodes ended {trainer.ended - ended}, by a hazard {trainer.hits - hits}",
                flush=True,
            )
            ended, hits, paid = trainer.ended, trainer.hits, 0.0
    trainer.env.close()
    entries = {name: name for name in given.laws.split(",") if name} | {
        "untrained": untrained,
        "learned": trainer.team(),
    }
    board = leaderboard(entries, tasks=[task], seeds=SEEDS[: given.flights], **VIEW)
    print(board.markdown())
    for standing in board.standings:
        (r,) = standing.results
        print(
            f"{r.entry}: {r.arrived} of {r.episodes} arrived in {r.mission_time:.0f} s, {r.hazards_hit} hits"
        )


if __name__ == "__main__":
    main()
