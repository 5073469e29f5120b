"""The page's radio links: status, controls, and charts."""

from pathlib import Path

import msgspec
import pytest

from bus.messages.control import Action, Change, Control
from bus.messages.links import LinkKind, LinkSettings, LinkStatus
from bus.messages.scenario import Limits
from bus.messages.telemetry import Status
from bus.messages.vehicle import UavReport
from bus.profiles import PROFILES
from observed import recorded
from outrider.recording.reader import flight_of
from outrider_dashboard.chart_data import ChartData
from outrider_dashboard.controls.link_settings import (
    ALL,
    controls_for,
    describe,
    describe_links,
    select_links,
    with_blackout,
    with_field,
)
from outrider_dashboard.controls.teleoperation import SharedTeleoperation
from outrider_dashboard.hub import Hub
from outrider_dashboard.sources.recorded import RecordedRun
from sim.channel.description import check_link
from sim.scenario.loading import load_scenario
from sim.scene.known import geometry_of
from statuses import a_status, a_truth, a_vehicle

NAMES = ("uav_0/detections", "uav_0/commands", "ugv_0/commands", "ugv_0/operator", "uav_0/radio")
PERFECT, BURSTS = LinkSettings(), LinkSettings(jitter=0.1, burst_length=0.3, burst_interval=4.0)


def link(sent: int = 0, **lost: int) -> LinkStatus:
    return LinkStatus(
        sent=sent, delivered=sent, duplicated=0, queued=0, in_transit=0, lost=lost, settings=PERFECT
    )


def status(time: float, **links: LinkStatus) -> Status:
    named = {name.replace("__", "/"): link_status for name, link_status in links.items()}
    return a_status(time=time, links=named)


# Descriptions


@pytest.mark.parametrize("name", PROFILES)
def test_a_profile_is_called_by_its_name_whatever_is_planned(name: str) -> None:
    assert describe(PROFILES[name]) == name
    assert describe(with_blackout(PROFILES[name], 1.0, 2.0)) == name


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        (LinkSettings(delay=0.5, loss=0.2), "delay 0.5 s, loss 20 %"),
        (BURSTS, "jitter 0.1 s, bursts 0.3 s every 4 s"),
        (LinkSettings(burst_interval=5.0, burst_loss=0.5), "perfect"),  # no bursts of 0 s
        (msgspec.structs.replace(PROFILES["wifi-poor"], loss=0.5), "wifi-poor, loss 50 %"),
        (msgspec.structs.replace(PROFILES["wifi-poor"], burst_length=0.0), "wifi-poor, no bursts"),
        (LinkSettings(bandwidth=2.0), "2 messages/s"),
    ],
)
def test_settings_are_described_in_a_few_words(settings: LinkSettings, text: str) -> None:
    assert describe(settings) == text


def test_status_describes_its_links_and_link_changes() -> None:
    settings = LinkSettings(loss=0.1)
    degraded = msgspec.structs.replace(link(), settings=settings)
    changes = (
        Change(tick=1, control=Control(action=Action.PAUSE)),
        Change(tick=2, control=Control(action=Action.LINK, link=LinkKind.RADIO, settings=settings)),
    )
    described = msgspec.structs.replace(
        status(1.0, uav_0__radio=degraded, uav_0__commands=link()), changes=changes
    )
    assert describe_links(described) == {
        "of": {"uav_0/radio": "loss 10 %", "uav_0/commands": "perfect"},
        "changes": ["", "loss 10 %"],
    }


# Controls


def test_links_are_chosen_by_kind_and_vehicle() -> None:
    assert select_links(NAMES, ALL, ALL) == list(NAMES)
    assert select_links(NAMES, "commands", ALL) == ["uav_0/commands", "ugv_0/commands"]
    assert select_links(NAMES, ALL, "ugv_0") == ["ugv_0/commands", "ugv_0/operator"]
    assert select_links(NAMES, "radio", "ugv_0") == []


def test_equal_settings_give_one_control_per_kind_of_link() -> None:
    one, other = LinkSettings(loss=0.1), LinkSettings(loss=0.2)
    everywhere = controls_for(dict.fromkeys(NAMES, one), NAMES)
    assert [(control.link, control.vehicle) for control in everywhere] == [
        (kind, None) for kind in LinkKind if kind is not LinkKind.TEAM
    ]
    each = controls_for({"uav_0/commands": one, "ugv_0/commands": other}, NAMES)
    assert [(control.vehicle, control.settings) for control in each] == [
        ("uav_0", one),
        ("ugv_0", other),
    ]
    (alone,) = controls_for({"ugv_0/commands": one}, NAMES)
    assert (alone.action, alone.link, alone.vehicle) == (Action.LINK, LinkKind.COMMANDS, "ugv_0")


def test_new_blackout_keeps_settings_and_drops_oldest_blackouts() -> None:
    poor = PROFILES["wifi-poor"]
    added = with_blackout(poor, 10.0, 3.0)
    assert added == msgspec.structs.replace(poor, blackouts=((10.0, 3.0),))
    assert with_blackout(added, 11.0, 5.0).blackouts == ((10.0, 3.0), (11.0, 5.0))
    for k in range(3000):
        added = with_blackout(added, 20.0 + 2.0 * k, 1.0)
    assert len(added.blackouts) < 100
    assert added.blackouts[-1] == (6018.0, 1.0)
    ahead = LinkSettings(blackouts=((500.0, 9.0),))
    assert with_blackout(ahead, 1.0, 1.0).blackouts == ((500.0, 9.0), (1.0, 1.0))
    check_link(added, "link")


def test_requested_burst_length_gets_a_valid_interval() -> None:
    bursts = check_link(with_field(PERFECT, "burst_length", 0.5), "link")
    assert bursts.burst_length == 0.5
    assert bursts.burst_interval > 0.0
    assert with_field(bursts, "burst_interval", 9.0).burst_interval == 9.0
    assert with_field(LinkSettings(burst_interval=2.0), "burst_length", 1.0).burst_interval == 2.0


# Charts


def chart_row(history: ChartData, at: float, age: float | None = 0.05) -> tuple[float | None, ...]:
    of_age = {"estimate": (0.0, 0.0), "covariance": (1.0, 0.0, 1.0), "age": age, "rejected": 0}
    report = None if age is None else UavReport(**of_age)
    history.add(a_truth(at, a_vehicle(), a_vehicle(), report=report), 1.0, 0.05)
    return history.newest[-5:-2]


def test_chart_row_has_age_recent_loss_and_blackout() -> None:
    history = ChartData()
    assert chart_row(history, 0.0) == (0.05, None, 0.0)
    history.losses.update(status(0.0, uav_0__detections=link(0), ugv_0__commands=link(0)))
    history.losses.update(status(1.0, uav_0__detections=link(20, loss=5), ugv_0__commands=link(20)))
    assert chart_row(history, 1.0, 0.2) == (0.2, 0.25, 0.0)
    history.losses.update(
        status(2.0, uav_0__detections=link(40, loss=5), ugv_0__commands=link(40, blackout=3))
    )
    assert chart_row(history, 2.0) == (0.05, 0.0, 1.0)
    history.losses.update(
        status(3.0, uav_0__detections=link(60, loss=5), ugv_0__commands=link(60, blackout=3))
    )
    assert chart_row(history, 3.0, None) == (None, 0.0, 0.0)


def test_new_flight_resets_loss_and_stale_status_changes_nothing():
    history = ChartData()
    for time, sent in ((0.0, 0), (1.0, 100)):
        history.losses.update(status(time, uav_0__detections=link(sent, blackout=sent)))
    assert chart_row(history, 1.0)[1:] == (1.0, 1.0)
    history.losses.update(status(1.5, uav_0__detections=link(100, blackout=100)))
    assert chart_row(history, 1.5)[1:] == (1.0, 1.0)
    history.losses.update(status(0.1, uav_0__detections=link(2)))
    assert chart_row(history, 2.0)[1:] == (None, 0.0)


def test_seeking_a_recording_shows_its_blackout_in_place(tmp_path: Path) -> None:
    changes = ["duration=30.0", "links.detections.blackouts=[[10.0, 5.0]]"]
    recorded(tmp_path / "run.mcap", load_scenario("escort", overrides=changes))
    recorded_run = RecordedRun(flight_of(tmp_path / "run.mcap"), 1.0)
    hub = Hub(recorded_run)
    hub.update()
    recorded_run.seek(recorded_run.end)
    hub.update()
    in_blackout = [row[0] for row in hub.history.rows if row[-3]]
    assert in_blackout
    assert 9.9 <= min(t for t in in_blackout if t is not None) <= 10.6
    assert 14.4 <= max(t for t in in_blackout if t is not None) <= 15.6
    ages = {row[0]: row[-5] for row in hub.history.rows}
    assert max(age for age in ages.values() if age is not None) == pytest.approx(5.0, abs=0.2)


# Teleoperation


def test_full_deflection_requests_the_driven_vehicles_max_speed() -> None:
    teleoperation = SharedTeleoperation(lambda _control: True, lambda _name, _drive: True)
    limits = {
        "ugv_0": Limits(max_speed=0.2, max_acceleration=0.1),
        "ugv_1": Limits(max_speed=None, max_acceleration=None),
    }
    geometry = geometry_of(load_scenario("escort"))
    teleoperation.update(a_status(geometry=msgspec.structs.replace(geometry, limits=limits)))
    assert teleoperation.take_control(1, "browser 1", "ugv_0")
    assert teleoperation.full_speed == pytest.approx(0.2)
    teleoperation.speed_share = 0.5
    assert teleoperation.full_speed == pytest.approx(0.1)
    assert teleoperation.max_speed("ugv_1") == teleoperation.max_speed("unknown") == 1.0
