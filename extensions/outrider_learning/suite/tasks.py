"""Tasks of the suites: a shipped scenario each, with a few fields changed.

Heavy imports wait until a task runs, because the registration of the environments reads the names.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, SupportsIndex, overload

import msgspec

if TYPE_CHECKING:
    from outrider.envs.single import SingleEnv
    from outrider.envs.vector import OutriderVectorEnv
    from outrider_learning.suite.scoring import Entry, Result
    from sim.scenario.types import Scenario

BASE = "escort"
"""Shipped scenario of the tasks of `suite-v1`."""

NO_ESCORT = "none"
"""Mission entry without an escort: the UGV relies on its own sensor."""

SEEDS = tuple(range(9000, 9020))
"""Seeds of every evaluation. No default setting uses them for training."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """Task of the suite: a scenario, its seeds and a score."""

    name: str
    """Name in lower-case letters and '-'."""
    hard: str
    """Difficulty, in one line."""
    changes: Mapping[str, object]
    """Changed fields of the shipped scenario, as in `load_scenario(overrides=...)`."""
    base: str = BASE
    """Name of the shipped scenario."""
    mission: bool = False
    """True if the score is a mission's, and not the covered share."""

    @property
    def scenario(self) -> "Scenario":
        """Return the scenario of the task.

        Raises:
            ScenarioError: If the changes contradict the scenario.
        """
        from sim.scenario.loading import load_scenario  # noqa: PLC0415 - it imports compiled code

        found = load_scenario(
            self.base, overrides={"name": self.name, "title": self.hard, **self.changes}
        )
        # these suites are older than the search: their UAVs wait at the newest measurement
        uavs = tuple(msgspec.structs.replace(uav, search=False) for uav in found.uav)
        return msgspec.structs.replace(found, uav=uavs)

    @property
    def team(self) -> bool:
        """Return True if teams fly the task: its score has a rule of its own."""
        return self.scenario.team is not None

    @property
    def env_id(self) -> str:
        """Return the task's Gymnasium ID."""
        return f"outrider/Suite-{''.join(part.capitalize() for part in self.name.split('-'))}-v0"

    def make(self, num_envs: int, **settings: Any) -> "OutriderVectorEnv":  # noqa: ANN401 - the environment's settings
        """Return the task as `outrider.vector_env` with these settings."""
        from outrider.envs.vector import OutriderVectorEnv  # noqa: PLC0415 - it imports compiled code

        return OutriderVectorEnv(self.scenario, num_envs=num_envs, **settings)

    def make_single(self, **settings: Any) -> "SingleEnv":  # noqa: ANN401
        """Return the task as `outrider.single_env` with these settings."""
        from outrider.envs.single import SingleEnv  # noqa: PLC0415 - it imports compiled code

        return SingleEnv(self.scenario, **settings)

    def evaluate(
        self,
        entry: "Entry",
        *,
        name: str = "",
        seeds: Sequence[int] = SEEDS,
        secret: str | None = None,
        **settings: Any,  # noqa: ANN401 - settings of `evaluate`
    ) -> "Result":
        """Run the task with all seeds at once, and score it, see `outrider_learning.suite.evaluation.evaluate`."""
        from outrider_learning.suite.evaluation import evaluate  # noqa: PLC0415 - it imports compiled code

        return evaluate(self, entry, name=name, seeds=seeds, secret=secret, **settings)


_QUIET: dict[str, object] = {"detections.noise": 0.0, "detections.dropout": 0.0}
"""Every detection succeeds and is exact, as in the paper."""

_PAIRS: dict[str, object] = {
    "uav": [
        {"name": "uav_0", "escorts": "ugv_0", "position": [10.0, 13.0]},
        {"name": "uav_1", "escorts": "ugv_1", "position": [30.0, 29.0]},
    ],
    "ugv": [
        {
            "name": "ugv_0",
            "position": [10.0, 12.0],
            "goals": [[20.0, 18.0], [28.0, 12.0], [30.0, 28.0]],
        },
        {
            "name": "ugv_1",
            "position": [30.0, 28.0],
            "goals": [[20.0, 20.0], [12.0, 28.0], [10.0, 12.0]],
        },
    ],
}

_LONG_ROUTE = [
    [14.0, 8.0],
    [20.0, 13.0],
    [15.0, 19.0],
    [22.0, 24.0],
    [28.0, 21.0],
    [32.0, 30.0],
    [22.0, 34.0],
    [8.0, 30.0],
]
"""Route that is long enough for a UGV at 0.4 m/s."""

TASKS: tuple[Task, ...] = (
    Task(
        name="paper",
        hard="the paper's conditions: every detection succeeds and is exact",
        changes=_QUIET,
    ),
    Task(
        name="covered",
        hard="two regions are covered from the start, where the gradient vanishes",
        changes={
            **_QUIET,
            "coverage.covered": [
                {"lower": [4.0, 4.0], "upper": [16.0, 14.0]},
                {"lower": [17.0, 16.0], "upper": [27.0, 26.0]},
            ],
        },
    ),
    Task(
        name="noise",
        hard="noise of 0.5 m per axis, truncated at 1.5 m",
        changes={"detections.noise": 0.5, "detections.dropout": 0.0},
    ),
    Task(
        name="late-looks",
        hard="detections arrive two seconds late, with half a second of jitter",
        changes={
            "links.detections.delay": 2.0,
            "links.detections.jitter": 0.5,
            "certificate.max_measurement_age": 3.0,
        },
    ),
    Task(
        name="long-way",
        hard="twice the duration on nine times the area",
        changes={
            "duration": 400.0,
            "area.width": 120.0,
            "area.height": 120.0,
            "uav.0.position": [20.0, 21.0],
            "ugv.0.position": [20.0, 20.0],
            "ugv.0.goals": [[45.0, 20.0], [45.0, 40.0], [70.0, 45.0], [70.0, 70.0]],
        },
    ),
    Task(
        name="two-pairs",
        hard="two pairs whose paths cross; a loss of sight by either ends the episode",
        changes=_PAIRS,
    ),
    Task(
        name="fast-ugv",
        hard="twice the UGV's speed and acceleration",
        changes={"ugv.0.max_speed": 0.4, "ugv.0.max_acceleration": 0.2, "ugv.0.goals": _LONG_ROUTE},
    ),
    Task(
        name="short-sight",
        hard="r_v is 2 m, half of which the UAV needs to brake and catch up",
        changes={"visibility.radius": 2.0},
    ),
    Task(
        name="wander",
        hard="the UGV wanders unpredictably",
        changes={"ugv.0.driver": "wander"},
    ),
    Task(name="evade", hard="the UGV evades the UAV", changes={"ugv.0.driver": "evade"}),
    Task(
        name="dropouts",
        hard="two detection attempts per second, four of five fail",
        changes={
            "detections.rate": 2.0,
            "detections.dropout": 0.8,
            "certificate.max_measurement_age": 6.0,
        },
    ),
    Task(
        name="bursts",
        hard="all links are jammed, with blackouts of detections of five seconds",
        changes={
            "links.profile": "jammed",
            "links.detections.blackout_length": 5.0,
            "certificate.max_measurement_age": 6.0,
        },
    ),
    Task(
        name="late-commands",
        hard="commands take effect half a second late",
        changes={"links.commands.delay": 0.5, "command_timeout": 2.0},
    ),
    Task(
        name="all-at-once",
        hard="an evading UGV, noise, dropouts, jammed detections and late commands",
        changes={
            "detections.noise": 0.2,
            "detections.dropout": 0.3,
            "links.detections.profile": "jammed",
            "links.commands.delay": 0.5,
            "command_timeout": 2.0,
            "certificate.max_measurement_age": 6.0,
            "ugv.0.driver": "evade",
        },
    ),
)
"""Tasks in order of difficulty: first those in which no law of the paper loses sight, then the others."""


_BAD: dict[str, object] = {"links.profile": "jammed", "certificate.max_measurement_age": 6.0}
"""Network of `bursts`: bursts of loss and half a second of delay on every link."""


def _missions() -> Iterator[Task]:
    for base, hard in (
        (
            "minefield",
            "sixty mines; the UGV needs 1.5 m to stop and senses half a metre; the first hit ends the mission",
        ),
        ("rubble", "walls with dead ends, and rough ground that is slower than a detour"),
        (
            "rescue",
            "eight objects to find beside the path",
        ),
    ):
        yield Task(name=base, hard=hard, changes={}, base=base, mission=True)
        jammed = f"{hard}; every link is jammed"
        yield Task(name=f"{base}-jammed", hard=jammed, changes=_BAD, base=base, mission=True)


MISSIONS: tuple[Task, ...] = tuple(_missions())
"""Ground with hazards, over a perfect and a degraded network."""


TOWNS: tuple[Task, ...] = tuple(
    Task(name=base, hard=hard, changes={}, base=base)
    for base, hard in (
        ("town", "streets between blocks of up to 5 m, other ones for each seed"),
        ("courtyard", "a courtyard between wings of 6 m, which hide the UGV from afar"),
        ("rescue-town", "a long round through a town, past eight objects"),
    )
)
"""Buildings, seen by a UAV that has an altitude; the score is the covered share, as in `suite-v1`."""


_BANDS = [
    {
        "position": [3.0 + 0.5 * k, 4.0],
        "min_altitude": lowest,
        "initial_altitude": lowest + 1.0,
        "max_altitude": lowest + 2.0,
    }
    for k, lowest in enumerate((12.0, 16.0, 20.0))
]
"""Altitudes that keep three UAVs 2 m apart."""

TEAMS: tuple[Task, ...] = (
    Task(
        name="scouts",
        hard="a guard and two scouts, whose messages pass over poor Wi-Fi",
        changes={"area.cell": 0.5},
        base="scouts",
    ),
    Task(
        name="relay",
        hard="three UAVs with charge for five minutes relieve one another for ten",
        changes={"area.cell": 0.5, "duration": 600.0},
        base="relay",
    ),
    Task(
        name="team-town",
        hard="a guard and two scouts at separate altitudes over a town, other blocks for each seed",
        changes={"area.cell": 0.5, "team": {}, "uav": _BANDS},
        base="town",
    ),
)
"""Teams of UAVs; the score is the covered share, and 0 for an episode in which the team loses sight."""


class Suite(tuple[Task, ...]):
    """Tasks by index or by name."""

    __slots__ = ()

    @overload
    def __getitem__(self, key: SupportsIndex | str) -> Task: ...
    @overload
    def __getitem__(self, key: slice) -> "Suite": ...
    def __getitem__(self, key: SupportsIndex | str | slice) -> "Task | Suite":
        """Return a task by index or name, or a slice of the suite.

        Raises:
            ValueError: If the name is unknown.
        """
        if isinstance(key, slice):
            return Suite(super().__getitem__(key))
        if not isinstance(key, str):
            return super().__getitem__(key)
        for task in self:
            if task.name == key:
                return task
        raise ValueError(f"task = {key!r}: unknown task; allowed: {', '.join(self.names)}")

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the tasks in order."""
        return tuple(task.name for task in self)


SUITE, MISSION_SUITE, TOWN_SUITE = "suite-v1", "missions-v1", "towns-v1"
TEAM_SUITE = "teams-v1"
SUITES: Mapping[str, tuple[Task, ...]] = {
    SUITE: TASKS,
    MISSION_SUITE: MISSIONS,
    TOWN_SUITE: TOWNS,
    TEAM_SUITE: TEAMS,
}
"""Suites by name. A numbered suite never changes; changes go into the next one."""


def suite(name: str = SUITE) -> Suite:
    """Return a benchmark suite; `extensions/outrider_learning/README.md` explains tasks and score.

    Raises:
        ValueError: If the name is unknown.
    """
    if name not in SUITES:
        raise ValueError(f"suite = {name!r}: unknown suite; allowed: {', '.join(SUITES)}")
    return Suite(SUITES[name])
