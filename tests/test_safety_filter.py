"""The safety filter around a law, a policy and an operator's choice.

It also reports when nothing can be certified.
"""

from typing import Any

import msgspec
import numpy as np
import pytest

from agents.safety.levels import bounds_of
from agents.uav import UavPilot
from bus.messages.decision import NotCertified
from bus.messages.links import LinkSettings
from bus.messages.scenario import Law
from flights import DT, U_A, V_A, briefing_of, distances, uav_sees
from outrider.envs.parallel import parallel_env
from outrider.running.assumptions import assumption_warnings
from outrider.running.flying import fly
from sim.compiling.records import code
from sim.models.vehicles import step_vehicle
from sim.scenario.loading import load_scenario
from sim.scenario.types import Certificate, Detections, LinkTable, Scenario
from tabular import rows, words
from worlds import equal

R_V = 4.75
DROPPED = Detections(dropout=1.0)


def watched(*overrides: str, driver: str = "evade", duration: float = 120.0) -> Scenario:
    flown = ["law.name=certified", f"ugv.0.driver={driver}", f"duration={duration}"]
    return load_scenario("escort", overrides=[*flown, "area.cell=0.5", *overrides])


BLACKOUTS = [
    *(f"links.detections.blackout_{what}" for what in ("interval=12.0", "length=8.0")),
    "certificate.max_measurement_age=9.0",
]
NETWORKS = {
    "perfect": [],
    "late detections": ["links.detections.delay=1.0", "certificate.max_measurement_age=1.5"],
    "blackouts": BLACKOUTS,
    "late commands": ["links.commands.delay=0.5"],
    "loss": ["links.detections.loss=0.5"],
}


@pytest.mark.parametrize("network", NETWORKS.values(), ids=NETWORKS)
def test_sight_is_kept_and_certified_in_every_tick(network: list[str]) -> None:
    scenario = watched(*network)
    assert not [
        line for line in assumption_warnings(scenario) if "cannot always be certified" not in line
    ]  # random violations give a warning
    flight, summary = fly(scenario, 7)
    assert summary.max_distance < R_V
    until = int(np.flatnonzero(~np.isnan(flight.recorder.escorts[:, 0, 4]))[0])
    silent = {NotCertified.NO_REPORT: until}
    assert summary.uncertified == {cause: count for cause, count in silent.items() if count}
    assert flight.answers.assurance.certified == flight.answers.assurance.ticks - until
    assert summary.certified_while_lost == summary.certificate_broken == 0


def test_the_paper_s_law_loses_sight_where_the_filter_keeps_it() -> None:
    """The filter keeps sight in the same run above."""
    assert fly(watched(*BLACKOUTS, "law.name=switching"), 7)[1].max_distance > R_V


def test_safety_filter_does_not_override_the_undegraded_law() -> None:
    certified = fly(watched(driver="waypoints"), 7)
    plain = fly(watched("law.name=logarithmic", driver="waypoints"), 7)
    assert certified[1].overridden_share == 0.0
    assert np.allclose(distances(certified[0]), distances(plain[0]), atol=1e-6)


@pytest.mark.parametrize(
    ("changes", "reason"),
    rows("""
links.detections.blackouts=[[20.0,6.0]] | MEASUREMENT_TOO_OLD
links.commands.delay=0.5 certificate.max_command_delay=0.0 | COMMAND_INTERVAL
links.commands.blackouts=[[20.0,3.0]] certificate.max_command_interval=2.0 | COMMAND_INTERVAL
detections.noise=0.5 certificate.max_measurement_error=0.2 | CONTRADICTION
"""),
)
def test_broken_assumption_is_reported_by_name(changes: str, reason: str) -> None:
    _, summary = fly(watched(*words(changes), duration=60.0), 7)
    assert summary.certified_share < 1.0
    assert reason in summary.uncertified
    assert summary.certified_while_lost == summary.certificate_broken == 0


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        (["detections.truncation=inf"], "the detector noise is not truncated"),
        (["certificate.max_measurement_age=60.0"], "too much for visibility"),
        (["certificate.max_command_delay=30.0"], "too much for visibility"),
    ],
)
def test_uncertifiable_scenario_warns_and_reports_each_tick(changes, reason):
    scenario = watched(*changes, duration=5.0)
    assert any(reason in line for line in assumption_warnings(scenario))
    _, summary = fly(scenario, 7)
    assert summary.certified_share == 0.0
    assert set(summary.uncertified) <= {NotCertified.ASSUMPTIONS, NotCertified.NO_REPORT}
    assert NotCertified.ASSUMPTIONS in summary.uncertified


def test_what_is_declared_follows_from_the_scenario() -> None:
    commands = LinkSettings(delay=0.2, jitter=0.1, reorder=0.1, reorder_delay=0.05)
    scenario = msgspec.structs.replace(watched(), links=LinkTable(commands=commands))
    declared = briefing_of(scenario).safety
    assert declared.max_measurement_error == pytest.approx(0.3)
    assert declared.max_command_delay == pytest.approx(0.35)
    own = msgspec.structs.replace(
        scenario, certificate=Certificate(max_command_delay=0.1, max_measurement_error=0.5)
    )
    assert briefing_of(own).safety.max_measurement_error == 0.5


def outward(env: Any) -> Any:
    """Return the acceleration away from the UGV at full thrust."""
    x, y = env.unwrapped.world.position[0] - env.unwrapped.world.position[1]
    length = max(np.hypot(x, y), 1e-9)
    return np.array([x, y]) / length * 0.3


FLEEING = np.array([-0.1, 0.0])
"""Acceleration of a UGV that drives away."""


def test_policy_without_a_filter_loses_sight() -> None:
    env = parallel_env(watched(duration=60.0))
    env.reset(seed=7)
    while env.agents:
        env.step({"uav_0": outward(env), "ugv_0": FLEEING})
    assert env.world.tick < 60.0 / DT


@pytest.mark.parametrize(
    "options", [{}, {"estimate": True, "dtype": np.float32}], ids=["exact", "rounded"]
)
def test_filtered_environment_keeps_sight_for_any_policy(options) -> None:
    env = parallel_env(watched(), safety_filter=True, **options)
    env.reset(seed=7)
    intervened, infos = 0, {}
    while env.agents:
        *_, infos = env.step({"uav_0": outward(env), "ugv_0": FLEEING})
        intervened += infos["uav_0"]["overridden"]
        assert infos["uav_0"]["certified"], infos
        assert infos["uav_0"]["uncertified"] == 0
        bound = infos["uav_0"]["certified_distance"] + 0.05
        assert env.metrics()["uav_0"]["distance"] < min(R_V, bound)
    assert env.world.tick == 120.0 / DT
    assert intervened > 100
    assert "overridden" not in infos["ugv_0"]


@pytest.mark.parametrize("agent", ["uav_0", "ugv_0"])
@pytest.mark.parametrize("action", [[np.nan, 0.0], [1.0], "fast"])
def test_nonsense_is_refused_before_anything_is_filtered(agent, action) -> None:
    env, untouched = (parallel_env(watched(duration=5.0), safety_filter=True) for _ in range(2))
    env.reset(seed=7)
    untouched.reset(seed=7)
    good = {"uav_0": np.zeros(2), "ugv_0": np.zeros(2)}
    with pytest.raises(ValueError, match=f"action of {agent}"):
        env.step(good | {agent: action})
    assert equal(env.step(good), untouched.step(good))


def test_a_tick_that_is_not_certified_says_why() -> None:
    for change, reason in (
        ("certificate.max_measurement_age=60.0", "ASSUMPTIONS"),
        ("uav.0.position=[7.0, 9.0]", "NO_MEASUREMENT"),
    ):
        blind = msgspec.structs.replace(watched(change, duration=5.0), detections=DROPPED)
        env = parallel_env(blind, safety_filter=True)
        env.reset(seed=7)
        *_, infos = env.step(dict.fromkeys(env.agents, np.zeros(2)))
        assert not infos["uav_0"]["certified"]
        assert infos["uav_0"]["uncertified"] == code(NotCertified(reason))
        assert env.metrics()["uav_0"]["uncertified"] == reason


def test_safety_filter_can_start_in_flight() -> None:
    """An operator selects the law during the run: the certificate starts with the next detection."""
    scenario = watched("law.name=logarithmic", duration=10.0)
    pilot = UavPilot(briefing_of(scenario))
    assert pilot.filter is None
    there = {"position": (7.0, 9.0)}
    pilot.act(uav_sees(0, (0.0, (0.0, 1.0)), **there))
    command = pilot.act(uav_sees(1, law=Law(name="certified"), **there))
    assert command.report.decision.reason is NotCertified.NO_MEASUREMENT
    command = pilot.act(uav_sees(2, (0.1, (0.0, 1.0)), **there))
    assert command.report.decision.certified_distance == pytest.approx(1.3)
    moved = step_vehicle(7.0, 9.0, 0.0, 0.0, *command.acceleration, V_A, U_A, DT)
    there = {"position": moved[:2], "velocity": moved[2:4]}
    command = pilot.act(uav_sees(3, **there))  # it flies a checked plan
    assert command.report.decision.certified
    assert bounds_of(briefing_of(scenario)).placed_error == pytest.approx(0.3)
