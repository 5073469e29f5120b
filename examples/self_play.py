"""Train UAV and UGV in turns against each other, by an evolution strategy in NumPy, without the safety filter.

    python examples/self_play.py

The UGV is an adversary: it is paid for the distance and for each tick out of sight. Each vehicle acts on its own
observation alone. All candidates of a generation fly at once, in worlds of one environment.
"""

import argparse

import numpy as np

import outrider

REPEAT = 10  # ticks per decision
RADIUS, UAV_SPEED, UAV_PUSH, UGV_SPEED, UGV_PUSH = 4.75, 0.6, 0.3, 0.2, 0.1  # of `escort`
TICK, GAINS = 0.05, 5  # tick [s]; number of gains of each policy
SPREAD, STEP = 0.5, 1.0  # of the candidates; of the mean


def pay(metrics):
    """Pay the UGV for the distance and for being out of sight; the UAV has its weighted terms."""
    uav = metrics["uav_0"]
    return {"ugv_0": 0.02 * uav["distance"] / RADIUS + 0.1 * (uav["margin"] <= 0.0)}


def fly(gains, row):
    """Follow the UGV or uncovered ground. Gains: shape (worlds, 5)."""
    relative, velocity, ground = row[:, 6:8] / RADIUS, row[:, 3:5] / UAV_SPEED, row[:, 9:11]
    far = (relative**2).sum(axis=1, keepdims=True)
    inputs = np.stack([relative, far * relative, velocity, ground, far * ground], axis=2)
    return UAV_PUSH * np.tanh((inputs * gains[:, None]).sum(axis=2))


def flee(gains, row):
    """Drive ahead, and turn in waves: the UGV does not observe the UAV. Gains: shape (worlds, 5)."""
    velocity, turn = row[:, 3:5] / UGV_SPEED, 2.0 * np.pi * row[:, :1]
    moves = np.linalg.norm(velocity, axis=1, keepdims=True) > 0.05
    ahead = np.where(moves, velocity, (0.7, 0.7))
    waves = np.hstack(
        [np.ones_like(turn), *(f(turn / 20.0) for f in (np.sin, np.cos)), np.sin(turn / 60.0)]
    )
    across = (gains[:, 1:] * waves).sum(axis=1, keepdims=True)
    push = np.tanh(gains[:, :1]) * ahead + np.tanh(across) * ahead[:, ::-1] * (-1.0, 1.0)
    return 0.7 * UGV_PUSH * push


PILOTS = {"uav_0": fly, "ugv_0": flee}


class Arena:
    """Worlds in which pairs of policies meet, all with the same noise.

    Args:
        num_envs: Number of worlds.
        duration: Length of an episode [s].
    """

    def __init__(self, num_envs, duration):
        self.worlds = outrider.parallel_vector_env(
            "escort",
            num_envs=num_envs,
            duration=duration,
            estimate=True,
            gradient=True,
            end_on_sight_lost=False,
            reward_function=pay,
            autoreset_mode="NextStep",
        )
        self.count, self.ticks = num_envs, round(duration / TICK)

    def play(self, gains, seed):
        """Return the returns by vehicle and the time out of sight [s], shape (worlds,) each.

        Args:
            gains: Gains by vehicle. Shape (gains,) or (worlds, gains).
            seed: Seed of all worlds.
        """
        gains = {name: np.broadcast_to(own, (self.count, GAINS)) for name, own in gains.items()}
        rows, _ = self.worlds.reset(seed=[seed] * self.count)
        returns = dict.fromkeys(rows, 0.0)
        for tick in range(self.ticks):
            if tick % REPEAT == 0:
                actions = {name: PILOTS[name](gains[name], row) for name, row in rows.items()}
            rows, paid, *_ = self.worlds.step(actions)
            returns = {name: total + paid[name] for name, total in returns.items()}
        return returns, TICK * self.worlds.metrics()["uav_0"]["visibility_violations"]


def improved(arena, gains, name, rng):
    """Return the gains of one vehicle after a generation against the present opponent."""
    noise = rng.normal(size=(arena.count // 2, GAINS))
    noise = np.vstack([noise, -noise])
    candidates = gains | {name: gains[name] + SPREAD * noise}
    returns = arena.play(candidates, seed=int(rng.integers(2**31)))[0][name]
    scores = (returns - returns.mean()) / (returns.std() + 1e-9)
    return gains[name] + STEP * scores @ noise / len(noise)


def main():
    parser = argparse.ArgumentParser(description="Self-play of UAV and UGV in escort.")
    parser.add_argument("--rounds", type=int, default=3, help="Times that each vehicle trains.")
    parser.add_argument("--generations", type=int, default=10, help="Generations of a training.")
    parser.add_argument("--duration", type=float, default=60.0, help="Duration of an episode [s].")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    rng, arena = np.random.default_rng(args.seed), Arena(24, args.duration)
    gains = {name: np.zeros(GAINS) for name in PILOTS}
    history = {name: [own] for name, own in gains.items()}
    for number in range(1, args.rounds + 1):
        for name in PILOTS:
            for _ in range(args.generations):
                gains = gains | {name: improved(arena, gains, name, rng)}
            history[name].append(gains[name])
            print(f"round {number}, {name}: {gains[name].round(2)}", flush=True)
    table(history, args.duration)


def table(history, duration):
    """Print the UAV's return and its time out of sight for each UAV against each UGV."""
    uavs, ugvs = history["uav_0"], history["ugv_0"]
    pairs = {"uav_0": np.repeat(uavs, len(ugvs), axis=0), "ugv_0": np.tile(ugvs, (len(uavs), 1))}
    returns, lost = Arena(len(uavs) * len(ugvs), duration).play(pairs, seed=9000)
    print("UAV's return (time out of sight [s])")
    print("      ", *(f"{f'UGV {k}':>14}" for k in range(len(ugvs))))
    cells = [
        f"{paid:7.1f} ({time:4.1f})" for paid, time in zip(returns["uav_0"], lost, strict=True)
    ]
    for k in range(len(uavs)):
        print(f"UAV {k}: ", *cells[k * len(ugvs) : (k + 1) * len(ugvs)])


if __name__ == "__main__":
    main()
