"""Teams: roles, hand-overs, shared coverage and the guarantee, in flights with the pilots, filters and world.

`test_team_protocol` attacks the rules alone.
"""

import json
import os
import random
import signal
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import pytest

from agents.uav import UavPilot
from bus.errors import ScenarioError
from bus.messages.links import LinkKind
from bus.messages.team import BLOCK_CELLS, CoverageBlock, Role, Team, TeamMessage
from bus.messages.telemetry import TeamStatus
from bus.messages.vehicle import UavCommand, UavObservation, UgvBriefing, UgvObservation
from fields import fields_within
from outrider.running.assumptions import how_certifiable
from outrider.running.deaths import MortalPilots
from outrider.running.flying import InProcess, fly, make_pilots
from outrider.running.summary import summarize
from processes import await_status, child_of, flying, observing, python
from refusals import refusal
from sim.engine.briefing import briefing
from sim.engine.team_monitor import record_team, team_counters, team_reports
from sim.scenario.checks import check_scenario, scenario_warnings
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario
from sim.server.flight import Flight
from sim.server.team_radio import TeamRadio
from sim.world import World

COARSE = {"area.cell": 0.5, "links.team": {}}


def team(duration: float, **changes: Any) -> Scenario:
    given = {key.replace("__", "."): value for key, value in changes.items()}
    return load_scenario("scouts", overrides=COARSE | {"duration": duration} | given)


def mortal(flight: Flight, dies: Callable[[int], list[str]], absent: int) -> MortalPilots:
    """Return pilots of which those that `dies` names die in a tick; each is back after `absent` ticks."""
    return MortalPilots(flight, lambda tick: dict.fromkeys(dies(tick), absent))


def status_of(flight: Flight) -> TeamStatus:
    status = flight.answers.teams.status()
    assert status is not None
    return status


def assert_guaranteed(flight: Flight) -> TeamStatus:
    status, certificates = status_of(flight), flight.answers.assurance.status()
    assert status.team_certified_while_lost == status.team_certificate_broken == 0
    assert certificates is not None
    assert certificates.certified_while_lost == certificates.certificate_broken == 0
    return status


def guards_of(flight: Flight) -> list[str]:
    """Return the guards of the last tick, the one with the largest number first."""
    radio = flight.team
    found = [name for name, role in flight.answers.roles().items() if role is Role.GUARD]
    return sorted(found, key=radio.number, reverse=True)


def test_one_guards_and_the_others_range_ahead() -> None:
    flight, summary = fly(team(60.0), 7)
    status = assert_guaranteed(flight)
    assert status.team_certified_share > 0.999
    assert (status.handovers, status.team_out_of_sight, summary.visibility_violations) == (0, 0, 0)
    assert status.extra_guard_share < 0.01
    assert summary.min_margin is not None
    assert summary.min_margin > 0.0
    far = sorted(one.max_distance or 0.0 for one in summary.uavs.values())
    assert far[0] < 4.75
    assert 7.0 < far[1] < far[2] <= 9.0
    alone = load_scenario("scouts", overrides=COARSE | {"duration": 60.0})
    alone = msgspec.structs.replace(
        alone, team=None, law=msgspec.structs.replace(alone.law, name="certified")
    )
    assert summary.mean_error is not None
    assert summary.mean_error < 0.8 * (fly(alone, 7)[1].mean_error or 0.0)


@pytest.mark.parametrize(
    "number", [*range(3), *(pytest.param(n, marks=pytest.mark.long) for n in range(3, 40))]
)
def test_a_bad_network_and_deaths_break_no_guarantee(number: int) -> None:
    """The guard's process dies in the tick of a hand-over, and others at random."""
    rng = random.Random(number)
    guards = rng.choice((1, 2))
    changes = {
        "team.guards": guards,
        "team.silence": rng.choice((0.5, 2.0)),
        "links.team.loss": rng.choice((0.0, 0.3, 0.8)),
        "links.team.delay": rng.choice((0.0, 0.5)),
        "links.team.jitter": rng.choice((0.0, 0.5)),
        "links.team.duplicates": rng.choice((0.0, 0.2)),
        "links.team.blackout_interval": 8.0,
        "links.team.blackout_length": rng.choice((1.0, 4.0)),
        "links.commands.delay": rng.choice((0.0, 0.1)),
    }
    flight = Flight(
        load_scenario("scouts", overrides=COARSE | {"duration": 60.0} | changes), number
    )
    newest: list[int] = [0]

    def dies(tick: int) -> list[str]:
        numbers = {name: flight.team.number(name) for name in flight.team.refused}
        largest = max(numbers.values())
        accepted, newest[0] = largest > newest[0], largest
        if tick > 200 and accepted and rng.random() < 0.3:
            return [max(numbers, key=numbers.__getitem__)]
        return [rng.choice(sorted(numbers))] if tick > 200 and rng.random() < 0.002 else []

    exchange = mortal(flight, dies, absent=rng.choice((10, 60)))
    flight.fly(exchange)
    status = assert_guaranteed(flight)
    assert status.team_certified_share > 0.5
    assert max(status.numbers.values()) >= 16
    assert all(refused == 0 for refused in flight.team.refused.values())


def test_two_guards_tolerate_the_death_of_one() -> None:
    flight = Flight(team(40.0, team__guards=2), 3)
    exchange = mortal(flight, lambda tick: guards_of(flight)[:1] if tick == 300 else [], absent=200)
    flight.fly(exchange)
    status = assert_guaranteed(flight)
    assert exchange.deaths == 1
    assert status.team_out_of_sight == 0
    assert status.team_certified_share > 0.999


def assert_taken_over(flight: Flight) -> None:
    """Fly, let the guard die for good at tick 300, and check that a scout has taken over."""
    dead: list[str] = []

    def dies(tick: int) -> list[str]:
        if tick == 300:
            dead.extend(guards_of(flight)[:1])
            return dead
        return []

    flight.fly(mortal(flight, dies, absent=10_000))
    assert_guaranteed(flight)
    first, *_ = guards_of(flight)
    assert first not in dead
    assert status_of(flight).handovers == 1


def test_a_scout_takes_over_from_a_dead_guard() -> None:
    assert_taken_over(Flight(team(40.0), 3))


def test_a_rejoined_guard_guards_again_before_it_scouts() -> None:
    """It reads its stored number; without a heard greater one it may not stop (R4, R3)."""
    flight = Flight(team(30.0, links__team__loss=1.0), 3)
    roles: list[Role | None] = []

    def dies(tick: int) -> list[str]:
        roles.append(flight.answers.roles().get("uav_0"))
        return ["uav_0"] if tick == 300 else []

    flight.fly(mortal(flight, dies, absent=40))
    assert_guaranteed(flight)
    assert set(roles[100:]) - {None} == {Role.GUARD}


@pytest.mark.usefixtures("nothing_left_behind")
def test_team_flies_the_same_bits_in_processes_and_after_a_kill() -> None:
    scenario = load_scenario("scouts", overrides={"duration": 20.0})
    with flying("scouts", "--duration", "20", "--no-files", "--json", "--respawn") as run:
        with observing(run) as session:
            await_status(session, lambda status: status.tick > 0)
            os.kill(child_of(run, "uav"), signal.SIGKILL)
        out, err = run.communicate(timeout=120)
    assert run.returncode == 0, err
    summary = json.loads(out)
    assert summary["trajectory_sha256"] == fly(scenario, scenario.seed)[1].trajectory_sha256
    assert [*summary["faults"].values()] == [{"lost": 1, "joined again": 1}]
    found = summary["team"]
    assert found["team_certified_while_lost"] == found["team_certificate_broken"] == 0
    assert found["team_certified_share"] > 0.99


_NEW = """
import sys
from numba.core.registry import CPUDispatcher
from agents.process import uav_maker
from outrider.running.flying import fly
from sim.engine.briefing import uav_briefing
from sim.scenario.loading import load_scenario

def signatures():
    modules = [module for name, module in sys.modules.items() if name.startswith("agents.")]
    functions = {f for module in modules for f in vars(module).values() if isinstance(f, CPUDispatcher)}
    return {(f.__module__, f.__name__, str(one)) for f in functions for one in f.signatures}

scenario = load_scenario(sys.argv[1], overrides=["duration=20", "area.cell=0.5"])
uav_maker()(uav_briefing(scenario, "uav_0", 3))
before = signatures()
fly(scenario, 3)
new = {module + "." + name for module, name, _ in signatures() - before}
print(*(name for name in new if name.startswith("agents.") and "drivers" not in name))
"""


@pytest.mark.parametrize("name", ["scouts", "relay"])
def test_the_pilot_of_a_process_has_compiled_all_before_its_first_answer(name: str) -> None:
    assert python(_NEW, name).stdout.split() == []


def test_shared_coverage_equals_the_union_once_received() -> None:
    """After the UAVs have rested long enough for all blocks, each knows the coverage of the others."""
    scenario = team(60.0)
    flight = Flight(scenario, 7)
    exchange = InProcess(make_pilots(scenario, 7))
    flight.fly(exchange)
    pilots = [pilot for pilot in exchange._pilots.values() if isinstance(pilot, UavPilot)]
    union = sum(pilot.coverage for pilot in pilots)
    np.testing.assert_allclose(union, flight.world.coverage, rtol=0.0, atol=3.0 * scenario.dt)
    for pilot in pilots:
        memory = pilot._memory.team
        assert memory is not None
        heard = memory.heard.astype(float).sum(axis=0) * scenario.coverage.desired / 255.0
        missing = union - pilot.coverage - heard
        assert missing.min() > -1e-9  # never more than the union
        known = np.minimum(union, scenario.coverage.desired).sum()
        shown = np.minimum(pilot.coverage + heard, scenario.coverage.desired).sum()
        assert shown > 0.9 * known


def observed(*messages: TeamMessage, tick: int = 100, number: int = 0) -> UavObservation:
    return UavObservation(
        tick=tick,
        time=tick * 0.05,
        position=(8.0, 9.0),
        velocity=(0.0, 0.0),
        team=messages,
        number=number,
    )


def message(tick: int, number: int = 31, **changes: Any) -> TeamMessage:
    given: dict[str, Any] = {
        "sender": "uav_0",
        "role": Role.GUARD,
        "certified": True,
        "position": (9.0, 9.0),
    }
    return TeamMessage(
        tick=tick, number=number, **given | {"measured": tick, "measurement": (8.0, 8.0)} | changes
    )


def pilot_of(name: str = "uav_1") -> UavPilot:
    brief: Any = briefing(team(10.0), name, 7)
    return UavPilot(brief)


def role_after(*observations: UavObservation, name: str = "uav_1") -> Role:
    pilot = pilot_of(name)
    for observation in observations:
        pilot.act(observation)
    assert pilot.team is not None
    return pilot.team.role


def test_roles_follow_what_is_heard() -> None:
    assert role_after(observed()) is Role.RELIEF
    assert role_after(observed(message(99))) is Role.SCOUT
    assert role_after(observed(message(99, certified=False))) is Role.RELIEF
    assert role_after(observed(message(99)), observed(tick=139)) is Role.SCOUT
    assert role_after(observed(message(99)), observed(tick=141)) is Role.RELIEF
    # stored numbers: a process that rejoins guards, until it hears of a greater one
    assert role_after(observed(number=30)) is Role.GUARD
    assert role_after(observed(message(20, number=29), number=30)) is Role.GUARD
    assert role_after(observed(message(99, number=31), number=30)) is Role.SCOUT


def test_a_guard_needs_greater_numbers_from_as_many_uavs_as_guards() -> None:
    two = team(10.0, team__guards=2)
    pilot = UavPilot(briefing(two, "uav_1", 7))  # type: ignore[arg-type] - of a UAV
    assert pilot.team is not None
    pilot.act(observed(message(99, 47), message(98, 63), number=30))
    assert pilot.team.role is Role.GUARD
    pilot.act(observed(message(100, 45, sender="uav_2"), tick=101, number=30))
    assert pilot.team.role is Role.SCOUT


def test_scouts_use_the_measurements_of_their_mates() -> None:
    pilot = pilot_of()
    for tick in range(100, 110):
        pilot.act(observed(message(tick), tick=tick))
    estimate = pilot.estimator.target
    assert estimate.known
    assert (estimate.p_x, estimate.p_y) == pytest.approx((8.0, 8.0))


def sent(number: int = 0, **changes: Any) -> UavCommand:
    given: dict[str, Any] = {
        "sender": "uav_1",
        "tick": 0,
        "number": number,
        "role": Role.RELIEF,
        "position": (0.0, 0.0),
    }
    return UavCommand(
        tick=0, acceleration=(0.0, 0.0), number=number, team=TeamMessage(**given | changes)
    )


@pytest.mark.parametrize(
    ("command", "refused_messages", "stored"),
    [
        (sent(), 0, 0),
        (sent(30), 0, 30),
        (sent(31), 1, 0),  # the number of another UAV
        (sent(14, sender="uav_0"), 1, 14),
        (sent(14, tick=1), 1, 14),
    ],
)
def test_simulator_stores_a_number_before_it_sends_a_message(
    command: UavCommand, refused_messages: int, stored: int
) -> None:
    radio = TeamRadio(World(team(10.0), 7))
    radio.received("uav_1", 0)
    radio.send("uav_1", command)
    assert (radio.refused["uav_1"], radio.number("uav_1")) == (refused_messages, stored)
    assert radio.number("uav_1", 0) == 0  # it is in the next observation
    radio.send("uav_1", msgspec.structs.replace(command, number=14, team=None))
    assert radio.number("uav_1") == max(stored, 14)


def test_simulator_sends_no_number_that_is_not_stored() -> None:
    radio = TeamRadio(World(team(10.0), 7))
    radio.received("uav_1", 0)
    command = sent(30)
    radio.send("uav_1", msgspec.structs.replace(command, number=0))
    assert radio.refused["uav_1"] == 1


def test_other_teams_and_ugvs_receive_nothing() -> None:
    scenario = team(10.0)
    ugv = msgspec.structs.replace(scenario.ugv[0], name="ugv_1", position=(30.0, 30.0))
    others = tuple(
        msgspec.structs.replace(uav, name=f"uav_{k}", escorts="ugv_1", position=(30.0 + k, 31.0))
        for k, uav in enumerate(scenario.uav, 3)
    )
    both = msgspec.structs.replace(scenario, uav=(*scenario.uav, *others), ugv=(*scenario.ugv, ugv))
    flight = Flight(both, 7)
    pilots = make_pilots(both, 7)
    senders: dict[str, set[str]] = {}
    for _ in range(120):
        observations = flight.observations()
        for name, observation in observations.items():
            if isinstance(observation, UavObservation):
                senders.setdefault(name, set()).update(one.sender for one in observation.team)
        flight.apply({name: pilot.act(observations[name]) for name, pilot in pilots.items()})
    first, second = {"uav_0", "uav_1", "uav_2"}, {"uav_3", "uav_4", "uav_5"}
    for name, heard in senders.items():
        assert heard == (first if name in first else second) - {name}
    assert "team" not in fields_within(UgvObservation) | fields_within(UgvBriefing)
    assert assert_guaranteed(flight).team_certified_share > 0.9


def test_a_message_has_no_field_for_what_the_ugv_knows() -> None:
    known = """sender tick number role certified position measured measurement charge asks
        blocks column row cells"""
    assert fields_within(TeamMessage) == {*known.split()}


def test_monitor_counts_what_contradicts_the_guarantee() -> None:
    counts, reports = team_counters(1), team_reports(3)
    reports["number"], reports["current"], reports["lost"] = [31, 46, 0], True, True
    reports["guards"], reports["certified"] = [True, False, False], [True, False, False]
    record_team(counts[0], reports, 1)
    one = counts[0]
    assert (one["certified_while_lost"], one["broken"], one["lost"], one["top"]) == (1, 1, 1, 1)
    reports["current"][1], reports["lost"][2] = False, False  # its process is away; a scout sees
    record_team(counts[0], reports, 1)
    assert (one["certified_while_lost"], one["broken"], one["handovers"]) == (1, 1, 0)
    reports["number"][0] = 63
    record_team(counts[0], reports, 2)
    assert (one["handovers"], one["broken"], one["extra"]) == (1, 1, 0)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            {"team.guards": 4},
            "team.guards = 4: more than the UAVs of the team: uav_0, uav_1, uav_2; allowed: up to 3",
        ),
        ({"team.guards": 0}, "team.guards = 0: out of bounds; allowed: a whole number >= 1"),
        (
            {"team.scout_range": 4.0},
            "team.scout_range = 4.0: below r_v, where a guard flies; allowed: from 4.75 m",
        ),
        ({"team.scout_range": 9.2}, "allowed: up to 9.09 m"),
        (
            {"team.silence": 12.0},
            "uav_0 might return too late from r_v to find the UGV; allowed: up to 9.233 s",
        ),
        ({"detections.truncation": float("inf")}, "whatever `silence` is"),
        (
            {"team.scout_rnge": 9.0},
            "did you mean 'scout_range'?; allowed: guards, silence, scout_range, separation",
        ),
    ],
)
def test_impossible_teams_are_refused(change: dict[str, Any], said: str) -> None:
    assert said in refusal("scouts", change)


def test_a_team_of_seventeen_is_refused_and_of_sixteen_flies() -> None:
    scenario = team(1.0, team__guards=2)
    uav = scenario.uav[0]

    def of(count: int) -> Scenario:
        uavs = [
            msgspec.structs.replace(uav, name=f"uav_{k}", position=(7.0 + 0.2 * k, 9.0))
            for k in range(count)
        ]
        return msgspec.structs.replace(scenario, uav=tuple(uavs))

    with pytest.raises(ScenarioError, match="too many for one team"):
        check_scenario(of(17))
    assert_guaranteed(fly(check_scenario(of(16)), 1)[0])


def test_scouts_keep_within_their_range_whatever_the_law() -> None:
    flight, summary = fly(team(40.0, law__name="logarithmic"), 5)
    assert_guaranteed(flight)
    assert max(one.max_distance or 0.0 for one in summary.uavs.values()) < 9.2


def test_blocks_survive_the_message() -> None:
    cells = bytes(range(BLOCK_CELLS**2))
    block = CoverageBlock(column=3, row=4, cells=cells)
    decoded = msgspec.json.decode(
        msgspec.json.encode(message(1, blocks=(block,))), type=TeamMessage
    )
    assert decoded.blocks == (block,)


def test_defaults_are_definite_in_the_briefing() -> None:
    scenario = msgspec.structs.replace(team(10.0), team=Team())
    brief: Any = briefing(scenario, "uav_2", 7)
    assert brief.team.scout_range == pytest.approx(9.09)
    assert brief.mates == ("uav_0", "uav_1", "uav_2")
    assert LinkKind.TEAM in {kind for kind, _ in Flight(scenario, 1).world.links.names}


def test_summary_of_a_run_without_a_team_has_none() -> None:
    scenario = load_scenario("escort", overrides={"duration": 1.0})
    flight, summary = fly(scenario, 1)
    assert summary.team is None
    assert summarize(flight, seconds=1.0).team is None


@pytest.mark.parametrize(
    ("duration", "cell"), [(600.0, 0.5), pytest.param(3600.0, 0.25, marks=pytest.mark.long)]
)
def test_a_watch_has_no_gap_where_check_says_so(duration: float, cell: float) -> None:
    """Three UAVs relieve one another; a scout that waits at its base is asked in time."""
    scenario = load_scenario("relay", overrides={"duration": duration, "area.cell": cell})
    assert not scenario_warnings(scenario)
    flight, summary = fly(scenario, 7)
    status = assert_guaranteed(flight)
    assert (status.team_certified_share, status.left_without_relief) == (1.0, 0)
    assert status.handovers >= 2
    assert status.extra_guard_share < 0.01
    assert all(charge > 0.0 for charge in status.charges.values())
    assert summary.visibility_violations == 0


def test_a_guard_without_relief_leaves_and_is_excused() -> None:
    changes = {"duration": 400.0, "area.cell": 0.5, "links.team": {}, "links.team.loss": 1.0}
    flight = fly(load_scenario("relay", overrides=changes), 7)[0]
    status = assert_guaranteed(flight)
    assert status.left_without_relief >= 1
    assert all(charge > 0.0 for charge in status.charges.values())


def test_check_says_what_a_watch_needs() -> None:
    slow = load_scenario("relay", overrides={"uav.*.charge_time": 300.0})
    (line,) = scenario_warnings(slow)
    assert line.endswith("needed: 4 UAVs or an endurance of 357.61 s or a charge time of 184.785 s")
    for changes in ({"uav.*.endurance": 357.61}, {"uav.*.charge_time": 184.78}):
        cured = {"uav.*.charge_time": 300.0} | changes
        assert not scenario_warnings(load_scenario("relay", overrides=cured))


def test_an_exhausted_guard_releases_no_relief() -> None:
    """Its number is greater, but it does not guard: a relief that had not heard it goes on."""
    pilot = pilot_of()
    for tick in (100, 101):
        pilot.act(
            observed(message(tick, 31, role=Role.AWAY, certified=False), tick=tick, number=30)
        )
    assert pilot.team is not None
    assert pilot.team.role is Role.GUARD
    pilot.act(observed(message(102, 31), tick=102, number=30))
    assert pilot.team.role is Role.SCOUT


def test_an_exhausted_guard_leaves_no_long_gap() -> None:
    """Its relief has heard nothing of it, and hears its number afterwards."""
    changes = {"links.team.blackouts": [[60.0, 170.0]], "duration": 500.0, "area.cell": 0.5}
    flight = fly(load_scenario("relay", overrides=changes), 7)[0]
    status = assert_guaranteed(flight)
    assert status.team_certified_share > 0.9


@pytest.mark.parametrize(
    "changes",
    [{"measured": 1}, {"asks": "uav_9"}, {"sender": "uav_2"}, {"tick": 3}],
)
def test_a_message_that_would_mislead_is_not_sent(changes: dict[str, Any]) -> None:
    radio = TeamRadio(World(team(10.0), 7))
    radio.received("uav_1", 0)
    radio.send("uav_1", sent(**changes))
    assert radio.refused["uav_1"] == 1


def test_a_law_without_a_filter_has_its_assumptions_checked_in_a_team() -> None:
    poor = {"law.name": "logarithmic", "links.detections.delay": 2.0}
    assert how_certifiable(load_scenario("scouts", overrides=poor)) == "never"
    assert how_certifiable(load_scenario("escort", overrides=poor)) is None
