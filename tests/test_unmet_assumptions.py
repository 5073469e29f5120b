"""Assumptions that links or detector cannot satisfy give a warning before the run, each with its field."""

import re
from typing import Any

import numpy as np
import pytest

from bus.errors import ScenarioError
from bus.messages.links import LinkKind, LinkSettings
from one_link import OneLink
from outrider.running.assumptions import assumption_warnings, how_certifiable, shortfalls
from outrider.running.link_assumptions import Frequency
from refusals import refused
from seeded import a_key
from sim.channel.description import arrival_share, least_ticks, link_parameters
from sim.channel.gaps import age_window, late_shares
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario
from sim.world import World
from tabular import rows

DT = 0.05
QUIET = ("detections.dropout=0.0",)


def certified(*overrides: str) -> Scenario:
    return load_scenario("escort", overrides=["law.name=certified", *QUIET, *overrides])


BROKEN = rows("""
A1 | SOMETIMES | detections.noise=0.5 & certificate.max_measurement_error=1.2
| certificate.max_measurement_error = 1.2 m
A1 | THROUGHOUT | detections.noise=0.5 & certificate.max_measurement_error=0.2 | 92.2 % of the detections
A1 | SOMETIMES | detections.truncation=inf & certificate.max_measurement_error=0.4 | detections.truncation = inf
none | ALWAYS | detections.truncation=inf | the detector noise is not truncated
A2 | CERTAIN | detections.rate=1.0 & certificate.max_measurement_age=0.5 | detections.rate = 1 /s
A2 | ALWAYS | links.detections.delay=1.05 | links.detections.delay = 1.05
A2 | SOMETIMES | links.detections.delay=0.95 & links.detections.jitter=0.3 | links.detections.jitter = 0.3
A2 | SOMETIMES | links.detections.loss=0.5 | links.detections.loss = 0.5
A2 | SOMETIMES | detections.dropout=0.7 | detections.dropout = 0.7
A2 | SOMETIMES | links.detections.reorder=0.5 & links.detections.reorder_delay=2.0 | links.detections.reorder = 0.5
A2 | SOMETIMES | links.detections.burst_length=2.0 & links.detections.burst_interval=9.0
| links.detections.burst_length = 2
A2 | SOMETIMES | links.detections.blackout_length=2.0 & links.detections.blackout_interval=9.0
| links.detections.blackout_length = 2
A2 | CERTAIN | links.detections.blackouts=[[30.0,20.0]]
| becomes 20 s old, too old from 31 s to 50 s
A2 | CERTAIN | links.detections.blackouts=[[30.0,1.05]] | from 31 s to 31.05 s
A2 | CERTAIN | links.detections.blackouts=[[0.0,0.5]] | no detection arrives before 0.5 s
A2 | CERTAIN | links.detections.bandwidth=1.0 | links.detections.bandwidth = 1
A5' | ALWAYS | links.commands.delay=0.5 & certificate.max_command_delay=0.0
| every command takes 0.5 s or longer
A5' | SOMETIMES | links.commands.reorder=0.1 & links.commands.reorder_delay=0.2 & certificate.max_command_delay=0.0
| links.commands.reorder = 0.1
A5' | THROUGHOUT | links.commands.bandwidth=5 | bandwidth to 20 messages per second
A5' | SOMETIMES | links.commands.loss=0.1 | certificate.max_command_interval = 0.05 s
A5' | SOMETIMES | links.commands.burst_length=0.5 & links.commands.burst_interval=9.0
| links.commands.burst_length = 0.5
A5' | SOMETIMES | links.commands.blackout_length=0.5 & links.commands.blackout_interval=9.0
| links.commands.blackout_length = 0.5
A5' | CERTAIN | links.commands.blackouts=[[30.0,20.0]] | links.commands.blackouts
A5' | SOMETIMES | links.only=[{vehicle="uav_0",commands={loss=0.1}}] | links.only.0.commands.loss = 0.1
""")


@pytest.mark.parametrize(("assumption", "how", "changes", "phrase"), BROKEN)
def test_warning_names_assumption_field_and_frequency(assumption, how, changes, phrase):
    scenario = certified(*changes.split(" & "))
    found = [
        fault
        for fault in shortfalls(scenario)
        if fault.assumption == assumption.removeprefix("none") and phrase in fault.line
    ]
    assert [fault.frequency for fault in found] == [Frequency[how]]
    assert found[0].line in assumption_warnings(scenario)
    certifiable = {"ALWAYS": "never", "THROUGHOUT": "hardly ever"}
    assert how_certifiable(scenario) == certifiable.get(how, "not always")


def test_the_largest_bound_tried_is_named_if_none_suffices() -> None:
    blackouts = "links.detections.blackout_length=60", "links.detections.blackout_interval=20"
    (line,) = assumption_warnings(certified(*blackouts))
    assert "even certificate.max_measurement_age = 30 s is exceeded" in line


KEPT = [
    [],
    ["links.commands.delay=0.5"],
    ["certificate.max_command_delay=0.3"],  # early messages wait
    ["links.commands.delay=0.3", "links.commands.jitter=0.1"],
    ["links.commands.reorder=0.1", "links.commands.reorder_delay=0.2"],
    ["links.commands.delay=0.02", "links.commands.jitter=0.01"],  # one tick, with any jitter
    ["links.commands.delay=0.2", "links.commands.duplicates=0.5"],
    ["links.commands.bandwidth=20"],
    ["links.commands.blackouts=[[300.0,20.0]]"],  # after the run
    ["links.detections.delay=1.0"],
    ["links.detections.duplicates=0.5"],
    ["links.detections.loss=0.1"],
    ["links.detections.blackouts=[[30.0,1.0]]"],  # the newest detection is exactly 1 s old
    ["links.detections.bandwidth=2.0"],
    ['links.only=[{vehicle="ugv_0",commands={loss=0.1}}]'],
    ["law.name=linear", "links.commands.loss=0.1"],
]


@pytest.mark.parametrize("changes", KEPT)
def test_satisfied_assumptions_give_no_warning(changes: list[str]) -> None:
    assert assumption_warnings(certified(*changes)) == ()


def test_changed_link_is_compared_with_the_briefed_bounds() -> None:
    scenario = certified("links.commands.delay=0.2")
    world = World(scenario, 7)
    world.change_links(LinkKind.COMMANDS, "ugv_0", LinkSettings(loss=0.5))
    assert assumption_warnings(scenario, world.link_table) == ()
    world.change_links(LinkKind.COMMANDS, None, LinkSettings(delay=0.4))
    (line,) = assumption_warnings(scenario, world.link_table)
    assert "A5" in line
    assert "links.commands.delay = 0.4: every command takes 0.4 s or longer" in line
    assert world.link_table.of("ugv_0", LinkKind.COMMANDS).delay == 0.4
    world.change_links(LinkKind.COMMANDS, "uav_0", LinkSettings(delay=0.3))
    assert "links.only.1.commands.delay = 0.3" in assumption_warnings(scenario, world.link_table)[0]
    world.change_links(LinkKind.COMMANDS, "uav_0", LinkSettings(delay=0.2))
    assert assumption_warnings(scenario, world.link_table) == ()
    assert world.link_table.of("ugv_0", LinkKind.COMMANDS).delay == 0.4


COMMANDS: list[dict[str, Any]] = [
    {"delay": 0.3, "jitter": 0.1},
    {"delay": 0.1, "jitter": 0.05, "jitter_shape": "exponential", "max_jitter": 0.2},
    {"delay": 0.2, "jitter": 0.08, "jitter_shape": "normal", "max_jitter": 0.2},
    {"delay": 0.05, "reorder": 0.3, "reorder_delay": 0.1},
    {"delay": 0.1, "duplicates": 0.5},
    {"delay": 0.1, "bandwidth": 7.0, "queue": 3},
    {"delay": 0.1, "bandwidth": 7.0, "queue": 3, "keep": "oldest"},
    {"bandwidth": 15.0, "queue": 4},
]


@pytest.mark.parametrize("fields", COMMANDS, ids=str)
def test_description_of_a_link_matches_its_behaviour(fields: dict[str, Any]) -> None:
    settings, ticks = LinkSettings(**fields), 6_000
    link, p = OneLink(settings, dt=DT, key=a_key(1)), link_parameters(settings, DT)
    newest, ages, arrived = -1, np.zeros(ticks, dtype=int), np.full(ticks, 999)
    for tick in range(ticks):
        link.send(tick, tick, tick)
        for sent in link.arrivals(tick):
            arrived[sent] = min(arrived[sent], tick - sent)
            newest = max(newest, sent)
        ages[tick] = tick - newest
    settled = ages[1000:]
    assert settled.min() >= least_ticks(p)
    if settings.bandwidth:
        assert settled.min() == least_ticks(p)
    elif not settings.duplicates:
        shares = [arrival_share(p, age) for age in range(12)]
        older = np.cumprod([1.0, *(1.0 - share for share in shares)])
        for age, share in enumerate(shares):
            assert np.mean(arrived[: ticks - 100] <= age) == pytest.approx(share, abs=0.025)
            assert np.mean(settled == age) == pytest.approx(share * older[age], abs=0.025)


@pytest.mark.parametrize(
    ("changes", "phrase"),
    rows("""
command_timeout=0.2 & links.commands.delay=0.25
| command_timeout = 0.2: commands are 0.25 s old or more on arrival (links.commands of uav_0)
command_timeout=0.0 & links.commands.delay=0.01 | allowed: 0.05 s or more
dt=0.2 & detections.rate=5.0 & links.commands.delay=0.5 | allowed: 0.6 s or more
links.only=[{vehicle="uav_0",commands={delay=0.8,jitter=0.2}}]
| 0.6 s old or more on arrival (links.only.0.commands of uav_0)
links.commands.bandwidth=10.0 & links.commands.queue=20 | allowed: 1 s or more
"""),
)
def test_permanently_late_commands_are_refused(changes, phrase):
    """In the third case the command timeout is two ticks."""
    for law in ("linear", "certified"):
        with refused(ScenarioError, re.escape(phrase)):
            load_scenario("escort", overrides=[f"law.name={law}", *changes.split(" & ")])


def test_delay_within_the_command_timeout_is_flown() -> None:
    for timeout, delay in ((0.5, 0.5), (0.0, 0.0), (0.35, 0.35)):
        changes = [f"command_timeout={timeout}", f"links.commands.delay={delay}"]
        assert load_scenario("escort", overrides=changes).command_timeout == timeout


def test_check_reports_that_nothing_can_be_certified(command) -> None:
    changes = ("--set", "links.commands.delay=0.3", "--set", "certificate.max_command_delay=0.1")
    done = command("check", "escort", *changes)
    assert done.returncode == 0
    assert "sight never certified" in " ".join(done.stdout.split())
    text = " ".join(done.stderr.split())
    assert "links.commands.delay = 0.3: every command takes 0.3 s or longer" in text


@pytest.mark.parametrize(
    ("link", "bound", "assumption", "phrase"),
    rows("""
detections.loss=0.5 | measurement_age=0.25 | A2 | too old in 1.56 % of the ticks
commands.loss=0.1 | command_interval=0.2 | A5' | in 0.01 % of the ticks
"""),
)
def test_random_losses_warn_with_their_share_of_ticks(link, bound, assumption, phrase) -> None:
    (found,) = shortfalls(certified(f"links.{link}", f"certificate.max_{bound}"))
    assert (found.assumption, found.frequency) == (assumption, Frequency.SOMETIMES)
    assert found.by_chance
    assert f"{phrase}: sight cannot always be certified with" in found.line


@pytest.mark.parametrize(
    "lossy",
    [
        "detections.loss=0.3",
        "detections.blackout_length=0.2 & links.detections.blackout_interval=3",
    ],
)
def test_links_are_inspected_although_ticks_are_short(lossy: str) -> None:
    """An age of 0.9 s has 900,000 ticks, and the time between two detections 50,000."""
    short = ["dt=1e-6", "duration=1", "certificate.max_measurement_age=0.9"]
    (found,) = shortfalls(certified(*short, *f"links.{lossy}".split(" & ")))
    assert (found.assumption, found.frequency) == ("A2", Frequency.SOMETIMES)


def test_noise_is_checked_at_the_greatest_slant_range() -> None:
    """At 16 m above and 5 m beside the UGV it is 1.68 times the noise at the reference altitude of 10 m."""
    declared = "certificate.max_measurement_error"
    (found,) = shortfalls(load_scenario("town", overrides=[f"{declared}=0.3"]))
    assert (found.assumption, found.frequency) == ("A1", Frequency.SOMETIMES)
    assert "up to 19.3 % of the detections have a larger error" in found.what
    assert f"try --set {declared}=0.503" in found.what
    assert not shortfalls(load_scenario("town", overrides=[f"{declared}=0.503"]))
    high = [f"{declared}=0.1", "uav.0.min_altitude=14"]
    (found,) = shortfalls(load_scenario("town", overrides=high))
    assert found.frequency == Frequency.THROUGHOUT
    endless = load_scenario("town", overrides=[f"{declared}=0.3", "detections.truncation=inf"])
    assert "max_measurement_error=0.503 or more" in shortfalls(endless)[0].what


def test_longer_command_interval_admits_losses_not_blackouts() -> None:
    interval = "certificate.max_command_interval=1.0"
    assert not shortfalls(certified("links.commands.loss=0.1", interval))
    blackout = certified("links.commands.blackouts=[[5.0,3.0]]", interval)
    assert [fault.frequency for fault in shortfalls(blackout)] == [Frequency.CERTAIN]


SHARES: list[tuple[dict[str, Any], int, int, float]] = [
    ({"loss": 0.3, "delay": 0.1}, 1, 5, 0.1),
    ({"loss": 0.1, "burst_length": 0.2, "burst_interval": 0.5, "burst_loss": 0.8}, 2, 8, 0.0),
    ({"loss": 0.1, "blackout_interval": 5.0, "blackout_length": 0.5}, 2, 8, 0.1),
    ({"loss": 0.1, "jitter": 0.1, "jitter_shape": "exponential", "max_jitter": 0.4}, 1, 6, 0.1),
]


@pytest.mark.parametrize(("link", "period", "age", "dropout"), SHARES)
def test_the_share_of_old_detections_is_that_of_the_link(link, period, age, dropout) -> None:
    """Random blackouts may start and end within a tick, so that there the share is a bound."""
    settings, ticks = LinkSettings(**link), 100_000
    one, random = OneLink(settings, dt=DT, key=a_key(1)), np.random.default_rng(3)
    newest, old = 0, 0
    for tick in range(ticks):
        if tick % period == 0 and random.random() >= dropout:
            one.send(tick, tick, tick)
        newest = max([newest, *one.arrivals(tick)])
        old += tick - newest > age
    shares = late_shares(
        link_parameters(settings, DT), age_window(age), ticks=ticks, period=period, dropout=dropout
    )
    assert old > 100
    assert old / ticks == pytest.approx(shares.mean(), rel=0.15)


def test_a_planned_blackout_is_late_where_it_hides_the_window() -> None:
    parameters = link_parameters(LinkSettings(loss=0.5, blackouts=((2.0, 0.5),)), DT)
    shares = late_shares(parameters, age_window(3), ticks=100)
    assert shares[39 + 1] == 1.0  # of tick 39: the ticks 40 to 43 are covered
    assert shares[37 + 1] == 0.25
    assert set(shares[:30]) == {0.0625}
    assert len(shares) == 100 - 4 + 1
