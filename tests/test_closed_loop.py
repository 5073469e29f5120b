"""The closed loop in many worlds.

Whoever flies and drives in it gives the commands of the pilots in a single flight.
"""

from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np
import pytest
from blas import blas_fuses
from flights import escort
from test_batch import LATE, SMALL

from bus.errors import ScenarioError
from bus.messages import Command, Estimator, Law, LinkKind, Observation, ScriptStep, UavCommand
from bus.profiles import PROFILES
from outrider.envs.closed_loop import ClosedLoop
from outrider.envs.closed_loop_state import DISTANCE, SURE
from outrider.running.flying import InProcess, fly, make_pilots
from sim.env.patch import CoveragePatch
from sim.env.rewards import RewardWeights
from sim.scenario.loading import load_scenario
from sim.scenario.types import Certificate, Detections, LinkTable, Scenario, Uav, Ugv
from sim.server.flight import Flight

pytestmark = pytest.mark.xdist_group(
    "many worlds"
)  # on one worker: what they compile takes a minute, once

NOISY = Detections(noise=0.2, dropout=0.2)
HERE = (8.0, 6.0)
GOALS = ((12.0, 6.0), (12.0, 9.0), (4.0, 3.0))


def _small(law: str, driver: str = "waypoints", **fields: Any) -> Scenario:
    script = (ScriptStep(time=1.0, velocity=(0.2, 0.0)), ScriptStep(time=4.0, velocity=(-0.1, 0.3)))
    ugv = Ugv(position=HERE, driver=driver, goals=GOALS, goal_tolerance=0.3, script=script)
    given = {"area": SMALL, "detections": NOISY, "duration": 20.0} | fields
    return escort(law, uav=Uav(position=(8.0, 7.0)), ugv=ugv, **given)


SEVERAL = Scenario(
    area=SMALL,
    detections=NOISY,
    duration=15.0,
    law=Law(name="certified"),
    uav=(
        Uav(name="uav_1", position=(4.0, 4.0), escorts="ugv_0"),
        Uav(name="uav_0", position=(9.0, 4.0), escorts="ugv_1"),
        Uav(name="uav_2", position=(9.0, 6.0), escorts="ugv_1", max_speed=0.8),
    ),
    ugv=(
        Ugv(name="ugv_0", position=(4.0, 5.0), goals=((6.0, 6.0),), driver="wander"),
        Ugv(name="ugv_1", position=(9.0, 5.0), goals=((3.0, 3.0), (5.0, 3.0)), driver="evade"),
    ),
)
POOR = LinkTable(detections=LATE, commands=LATE, radio=LATE)
SCENARIOS: dict[str, Scenario] = {
    **{
        law: _small(law)
        for law in (
            "tracking",
            "coverage",
            "linear",
            "switching",
            "logarithmic",
            "circle",
            "certified",
        )
    },
    **{driver: _small("certified", driver) for driver in ("wander", "script", "evade")},
    "raw detections": _small("logarithmic", estimator=Estimator(enabled=False)),
    "network": _small("certified", "evade", links=POOR, duration=30.0),
    "delayed commands": _small(
        "certified",
        links=LinkTable(commands=msgspec.structs.replace(PROFILES["perfect"], delay=0.2)),
    ),
    "uncertifiable": _small("certified", certificate=Certificate(error=0.01)),
    "several": SEVERAL,
}


def _same(one: np.ndarray, other: np.ndarray) -> bool:
    """Bit for bit where NumPy's products are fused as everywhere but on old processors.

    Else as near as rounding allows.
    """
    if blas_fuses():
        return one.tobytes() == np.ascontiguousarray(other).tobytes()
    return np.allclose(one, other, rtol=1e-6, atol=1e-6, equal_nan=True)


@pytest.mark.parametrize("name", SCENARIOS)
def test_world_k_flies_as_the_single_flight_of_its_seed(name: str) -> None:
    scenario, seeds = SCENARIOS[name], [5, 11]
    loop = ClosedLoop(scenario, len(seeds), error=True, end_on_sight_lost=False)
    loop.begin(seeds)
    loop.fly()
    for k, seed in enumerate(seeds):
        flight, summary = fly(scenario, seed)
        for single, many in zip(flight.world.state[:6], loop.state.batch.truth[:6], strict=True):
            assert _same(single, many[k])
        escorts = flight.recorder.escorts
        for u, uav in enumerate(loop.uavs):
            found = {key: values[k] for key, values in loop.metrics(uav).items()}
            assert found["ticks"] == scenario.ticks
            assert found["max_distance"] == pytest.approx(escorts[:, u, 0].max(), rel=1e-12)
            assert found["mean_error"] == pytest.approx(escorts[:, u, 1].mean(), rel=1e-9)
            assert (
                found["visibility_violations"]
                == (escorts[:, u, 0] >= scenario.visibility.radius).sum()
            )
        if summary.certified_share is not None and len(loop.uavs) == 1:
            assert found["certified"] == pytest.approx(
                summary.certified_share, abs=1.5 / scenario.ticks
            )
        for count in ("certified_while_lost", "certificate_broken"):
            assert (
                sum(loop.metrics(uav)[count][k] for uav in loop.uavs)
                == getattr(summary, count)
                == 0
            )
        if loop.degraded:
            links = {
                key: one
                for key, one in flight.world.links.status().items()
                if not key.endswith(str(LinkKind.OPERATOR))
            }
            assert {key: one for key, one in loop.links(k).items() if one.degraded} == {
                key: one for key, one in links.items() if one.degraded
            }


def _flown_with(loop: ClosedLoop, seeds: list[int]) -> dict[str, np.ndarray]:
    loop.begin(seeds)
    loop.fly()
    return loop.metrics("uav_0")


def test_what_is_certified_out_of_sight_is_counted_in_every_world() -> None:
    """Sight ends at half a metre there, and the filter was told another r_v."""
    scenario, seeds = SCENARIOS["evade"], [5, 11]
    loop = ClosedLoop(scenario, len(seeds), error=True, end_on_sight_lost=False)
    world = loop.parameters.w._replace(r_v=0.5)
    loop.parameters = loop.parameters._replace(w=world)
    loop.begin(seeds)
    seats, counted = loop.state.uav_seats[:, 0], np.zeros(len(seeds))
    for _ in range(scenario.ticks):
        far = seats[:, DISTANCE] >= 0.5
        loop.fly(1)
        counted += far & (seats[:, SURE] == 1.0)  # said of the tick at which it was so far
    assert loop.metrics("uav_0")["certified_while_lost"].tolist() == counted.tolist()
    assert counted.min() > 100


def test_a_certificate_that_ends_is_counted_unless_an_assumption_has_failed() -> None:
    """Blackouts longer than declared end it; where the age is held to be allowed, that is a broken certificate."""
    dark = msgspec.structs.replace(PROFILES["perfect"], blackouts=((4.0, 2.0), (8.0, 3.0)))
    late = msgspec.structs.replace(PROFILES["perfect"], delay=0.2)
    links = LinkTable(detections=dark, commands=late)
    scenario = _small(
        "certified",
        links=links,
        certificate=Certificate(age=1.0),
        detections=Detections(noise=0.1, dropout=0.0),
    )
    loop = ClosedLoop(scenario, 1, error=True)
    assert _flown_with(loop, [5])["certificate_broken"] == 0.0
    told = loop.tables
    loop.tables = told._replace(ages=told.ages + 100)
    assert _flown_with(loop, [5])["certificate_broken"] == 2.0
    assert _flown_with(loop, [6])["certificate_broken"] == 2.0  # an episode begins at 0
    loop.tables = told._replace(ages=told.ages + 100, bounded=np.zeros_like(told.bounded))
    assert _flown_with(loop, [5])["certificate_broken"] == 0.0


def test_the_whole_escort_is_the_run_that_the_readme_shows() -> None:
    scenario = load_scenario("escort")
    loop = ClosedLoop(scenario, 1)
    loop.begin([7])
    loop.fly()
    flight, summary = fly(scenario, 7)
    assert _same(flight.world.position, loop.state.batch.truth.position[0])
    assert _same(flight.world.coverage, loop.state.batch.truth.coverage[0])
    assert loop.metrics("uav_0")["mean_error"][0] == pytest.approx(summary.mean_error, rel=1e-9)


class _Overruled(InProcess):
    """The pilots, but the UAV acts as it is told; what it perceives and radios is its own."""

    def __init__(self, scenario: Scenario, seed: int, actions: np.ndarray) -> None:
        super().__init__(make_pilots(scenario, seed))
        self._actions = actions

    def publish(self, observations: Mapping[str, Observation]) -> None:
        self._tick = next(iter(observations.values())).tick
        super().publish(observations)

    def collect(self, tick: int) -> dict[str, Command]:
        commands = super().collect(tick)
        said = commands["uav_0"]
        assert isinstance(said, UavCommand)
        x, y = self._actions[tick].tolist()
        return commands | {"uav_0": msgspec.structs.replace(said, acceleration=(x, y))}


@pytest.mark.parametrize("name", ["evade", "network"])
def test_a_ugv_that_evades_hears_a_uav_that_is_flown_from_outside(name: str) -> None:
    scenario = msgspec.structs.replace(SCENARIOS[name], law=Law(name="logarithmic"))
    actions = np.random.default_rng(2).uniform(-0.3, 0.3, (scenario.ticks, 2))
    loop = ClosedLoop(scenario, 2, external=["uav_0"], end_on_sight_lost=False)
    loop.begin([4, 3])
    for action in actions:
        loop.step(np.broadcast_to(action, (2, 1, 2)).copy())
    for k, seed in enumerate([4, 3]):
        flight = Flight(scenario, seed)
        flight.fly(_Overruled(scenario, seed, actions))
        assert _same(flight.world.position, loop.state.batch.truth.position[k])
    still = ClosedLoop(
        msgspec.structs.replace(
            scenario, ugv=(msgspec.structs.replace(scenario.ugv[0], driver="wander"),)
        ),
        1,
    )
    still.begin([4])
    still.fly()
    assert not _same(still.state.batch.truth.position[0, 1], loop.state.batch.truth.position[0, 1])


def test_pilots_are_chosen_by_name() -> None:
    scenario = _small("tracking", "waypoints")
    loop = ClosedLoop(scenario, 1, pilots={"uav_0": "circle", "ugv_0": "wander"})
    loop.begin([2])
    loop.fly()
    flight, _ = fly(_small("circle", "wander"), 2)
    assert _same(flight.world.position, loop.state.batch.truth.position[0])


@pytest.mark.parametrize(
    ("settings", "error", "message"),
    [
        (
            {"external": ["uav_9"]},
            ValueError,
            "vehicle = 'uav_9'; allowed: uav_0, ugv_0|vehicle = 'uav_9'; allowed: ugv_0, uav_0",
        ),
        ({"pilots": {"uav_0": "weighted"}}, ScenarioError, "function of your own"),
        ({"pilots": {"ugv_0": "teleop"}}, ScenarioError, "no compiled form"),
        ({"pilots": {"uav_0": "nonsense"}}, ScenarioError, "unknown; allowed"),
    ],
)
def test_who_cannot_fly_in_here_is_refused(
    settings: dict[str, Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        ClosedLoop(_small("tracking"), 1, **settings)


def test_worlds_that_wait_for_actions_do_not_fly_by_themselves() -> None:
    with pytest.raises(ValueError, match="come from outside"):
        ClosedLoop(_small("tracking"), 1, external=["uav_0"]).fly()


def test_an_episode_ends_by_itself_and_begins_anew_as_if_it_were_the_first() -> None:
    scenario = _small("certified", "evade", links=POOR)
    options: dict[str, Any] = {
        "gradient": True,
        "estimate": True,
        "patch": CoveragePatch(9, 0.5),
        "rewards": RewardWeights(seen=1.0),
    }
    used, fresh = ClosedLoop(scenario, 3, **options), ClosedLoop(scenario, 3, **options)
    used.begin([1, 2, 3])
    used.fly(333)
    used.begin([7, 8, 9])
    fresh.begin([7, 8, 9])
    for loop in (used, fresh):
        loop.fly(200)
    s, f = used.state, fresh.state
    for one, other in (
        (s.rewards, f.rewards),
        (s.uav_rows, f.uav_rows),
        (s.ugv_rows, f.ugv_rows),
        (s.patches, f.patches),
    ):
        assert one.tobytes() == other.tobytes()
    assert s.batch.truth.coverage.tobytes() == f.batch.truth.coverage.tobytes()
    used.fly()
    assert s.truncated.tolist() == [1, 1, 1]
    ticks = s.batch.ticks.copy()
    assert ticks.tolist() == [scenario.ticks] * 3


def test_a_world_of_the_shipped_escort_needs_less_than_300_kb() -> None:
    assert ClosedLoop(load_scenario("escort"), 2).bytes_per_world() < 300_000
