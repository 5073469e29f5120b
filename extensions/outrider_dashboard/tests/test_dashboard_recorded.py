"""A recording in the page: playing, pausing, seeking."""

from pathlib import Path

import pytest

from bus.messages.control import Action, Control
from bus.messages.telemetry import CoverageMap, Status, Truth
from bus.messages.vehicle import Teleoperation
from clocks import Clock
from observed import recorded
from outrider.recording.reader import flight_of
from outrider_dashboard.hub import Hub
from outrider_dashboard.sources.recorded import RecordedRun
from sim.scenario.loading import load_scenario


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recorded") / "run.mcap"
    recorded(path, load_scenario("escort", overrides=["duration=60.0"]))
    return path


def staged(path: Path, speed: float = 1.0) -> tuple[Clock, RecordedRun, Hub]:
    clock = Clock()
    recorded_run = RecordedRun(flight_of(path), speed, clock)
    return clock, recorded_run, Hub(recorded_run)


def shown(hub: Hub) -> float:
    hub.update()
    time = hub.history.newest[0]
    assert time is not None
    return time


def test_simulated_time_passes_at_the_speed_until_the_end(path: Path) -> None:
    clock, recorded_run, hub = staged(path, speed=4.0)
    assert shown(hub) == 0.0
    clock.now += 2.0
    assert shown(hub) == pytest.approx(8.0)
    recorded_run.speed = 0.5
    clock.now += 2.0
    assert shown(hub) == pytest.approx(9.0)
    clock.now += 1000.0
    assert shown(hub) == pytest.approx(60.0)
    assert not recorded_run.playing
    assert recorded_run.state.line == "End of the recording."
    assert hub.status is not None
    assert hub.status.over


def test_paused_replay_stands_still_and_steps_by_ticks(path: Path) -> None:
    clock, recorded_run, hub = staged(path)
    shown(hub)
    recorded_run.pause()
    clock.now += 5.0
    assert shown(hub) == 0.0
    assert hub.status is not None
    assert hub.status.paused
    recorded_run.step(7)
    assert shown(hub) == pytest.approx(0.35)
    recorded_run.play()
    shown(hub)
    clock.now += 1.0
    assert shown(hub) == pytest.approx(1.35)


def test_seeking_shows_the_same_as_playing_to_that_time(path: Path) -> None:
    clock, _, hub = staged(path)
    shown(hub)
    clock.now += 20.0
    shown(hub)
    played_rows, status = hub.history.rows, hub.status
    _, recorded_run, other = staged(path)
    shown(other)
    recorded_run.pause()
    recorded_run.seek(55.0)
    assert shown(other) == pytest.approx(55.0)
    recorded_run.seek(20.0)
    assert shown(other) == pytest.approx(20.0)
    assert other.history.rows == played_rows
    assert status is not None
    assert other.status is not None
    assert (other.status.tick, other.status.law, other.status.geometry) == (
        status.tick,
        status.law,
        status.geometry,
    )
    assert other.history.rows[-1][0] == pytest.approx(20.0, abs=0.11)


def test_play_at_the_end_begins_again(path: Path) -> None:
    clock, recorded_run, hub = staged(path)
    recorded_run.seek(1e9)
    assert shown(hub) == pytest.approx(60.0)
    recorded_run.play()
    assert shown(hub) == 0.0
    clock.now += 1.0
    assert shown(hub) == pytest.approx(1.0)


def test_map_is_the_newest_at_the_replay_time(path: Path) -> None:
    _, recorded_run, _ = staged(path)
    recorded_run.seek(30.52)
    news = list(recorded_run.news())
    assert isinstance(news[0], Status)
    (ground,) = (message for message in news if isinstance(message, CoverageMap))
    truth = [message for message in news if isinstance(message, Truth)][-1]
    assert truth.tick - 20 <= ground.tick <= truth.tick


def test_recording_cannot_be_steered(path: Path) -> None:
    _, recorded_run, hub = staged(path)
    shown(hub)
    assert not recorded_run.control(Control(action=Action.PAUSE))
    assert not recorded_run.drive("ugv_0", Teleoperation(operator="me"))
    assert not hub.teleoperation.take_control(1, "me", "ugv_0")


def test_a_recording_that_was_cut_off_says_so_at_its_end(path: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    _, recorded_run, hub = staged(cut)
    recorded_run.seek(1e9)
    assert 0.0 < shown(hub) < 60.0
    assert "incomplete" in recorded_run.state.line


def test_a_recording_without_a_status_is_shown_all_the_same(path, monkeypatch) -> None:
    monkeypatch.setattr(
        "outrider_dashboard.sources.recorded.statuses", lambda *_args, **_more: iter(())
    )
    _, _, hub = staged(path)
    shown(hub)
    assert hub.status is not None
    assert hub.status.geometry is not None
    assert hub.status.law == "certified"


def test_end_is_reported_once_after_all_browsers_received_it(path: Path) -> None:
    reports: list[float] = []
    clock = Clock()
    recorded_run = RecordedRun(flight_of(path), 1.0, clock)
    hub = Hub(recorded_run, on_end=lambda: reports.append(clock.now))
    first, slow = hub.add_browser(""), hub.add_browser("")
    for seconds, ends in ((30.0, 0), (1000.0, 1)):
        clock.now += seconds
        hub.update()
        hub._report_end()
        hub.frame(first)
        hub._report_end()
        assert len(reports) == 0
        hub.frame(slow)
        for _ in range(2):
            hub._report_end()
            assert len(reports) == ends
