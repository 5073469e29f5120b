"""The page of a run and of a recording: real processes, and the messages to a browser."""

import contextlib
import json
import os
import re
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx2
import msgspec
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from observed import recorded
from outrider.running.metrics import MISSION, NOW, Metric
from processes import alive, child_of, family, started, wait_until
from sim.scenario.loading import load_scenario
from tabular import words

pytestmark = pytest.mark.usefixtures("nothing_left_behind")
Frame = dict[str, Any]


@dataclass(frozen=True)
class Page:
    """A page opened by one browser."""

    port: int
    cookie: str

    def text(self, path: str = "") -> str:
        answer = httpx2.get(
            f"http://127.0.0.1:{self.port}/{path}",
            headers={"Cookie": self.cookie},
            trust_env=False,
            timeout=20.0,
        )
        assert answer.status_code == 200
        return answer.text


def page_of(process: "subprocess.Popen[str]") -> Page:
    """Return the page at the address that a process prints."""
    assert process.stderr is not None
    seen = []
    for line in process.stderr:
        seen.append(line)
        if found := re.search(r"http://127\.0\.0\.1:(\d+)/\?token=[\w-]+", line):
            answer = httpx2.get(found.group(0), trust_env=False, timeout=20.0)
            assert answer.status_code == 303
            return Page(int(found.group(1)), answer.headers["Set-Cookie"].partition(";")[0])
    raise AssertionError(f"no address in: {seen}")


def browser(page: Page) -> ClientConnection:
    address = f"ws://127.0.0.1:{page.port}/frames"
    return connect(address, proxy=None, max_size=None, additional_headers={"Cookie": page.cookie})


def next_frame(channel: ClientConnection) -> Frame:
    frame: Frame = json.loads(channel.recv(20.0))
    channel.send('{"kind":"drawn"}')
    return frame


def frames(channel: ClientConnection) -> Iterator[Frame]:
    """Yield all frames until the page is no longer served."""
    with contextlib.suppress(ConnectionClosed):
        while True:
            yield next_frame(channel)


def await_truth(channel: ClientConnection, tick: int) -> Frame:
    return next(
        frame for frame in frames(channel) if frame.get("truth", {}).get("tick", -1) >= tick
    )


def serves(page: Page) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", page.port)) == 0


def test_page_opens_with_the_run_shows_all_and_ends_with_it() -> None:
    arguments = words("run --with dashboard:port=0 --realtime 40 --duration 60 --no-files --json")
    with started(*arguments) as run:
        page = page_of(run)
        assert "Network budget" in page.text()
        budget = page.text("budget")
        assert "Compute" in budget
        assert "not known here" not in budget
        rows: list[list[float]] = []
        statuses: list[Frame] = []
        with browser(page) as channel:
            for frame in frames(channel):
                rows += frame.get("rows", [])
                statuses += [frame["status"]] if "status" in frame else []
        out, err = run.communicate(timeout=60)
        assert run.returncode == 0, err
    # The page opened before the first tick and samples every 0.1 s, in which 4 s are simulated.
    assert rows[0][0] < 8.0
    assert rows[-1][0] >= 59.0
    assert statuses[-1]["over"] is True
    assert {status["target_factor"] for status in statuses} == {40.0}
    summary = json.loads(out)
    assert summary["ticks"] == 1200
    assert [process["name"] for process in summary["processes"]] == ["simulator", "uav_0", "ugv_0"]
    assert not serves(page)


def test_dead_page_is_reported_once_and_the_run_continues() -> None:
    arguments = words("run --with dashboard:port=0 --realtime 0 --duration 60 --no-files --json")
    with started(*arguments) as run:
        page = page_of(run)
        with browser(page) as channel:
            await_truth(channel, 1)
            os.kill(child_of(run, "dashboard"), signal.SIGKILL)
        out, err = run.communicate(timeout=120)
        assert run.returncode == 0, err
    assert err.count("the run continues without it") == 1
    assert "killed by signal 9" in err
    summary = json.loads(out)
    assert summary["ticks"] == 1_200
    assert summary["deterministic"] is True


def test_run_with_page_is_real_time_and_a_kill_ends_all() -> None:
    with started("run", "--with", "dashboard:port=0", "--no-files") as run:
        page = page_of(run)
        with browser(page) as channel:
            assert await_truth(channel, 20)["kind"] == "frame"
            status = next(frame["status"] for frame in frames(channel) if "status" in frame)
        assert status["target_factor"] == 1.0
        children = family(run.pid)
        assert len(children) == 4
        assert child_of(run, "dashboard") in children
        run.kill()
        run.wait()
        wait_until(lambda: not any(alive(child) for child in children))
    assert not serves(page)


def test_busy_port_is_refused_before_the_run_starts(tmp_path: Path, command) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        run = command("run", "--with", f"dashboard:port={port}", "--out", tmp_path / "flight")
    assert run.returncode == 2
    assert len(run.stderr.strip().splitlines()) == 1
    assert f"port {port}" in run.stderr
    assert "--port" in run.stderr
    assert not list((tmp_path / "flight").glob("*"))


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "run.mcap"
    recorded(path, load_scenario("escort", overrides=["duration=30.0"]))
    return path


def test_page_replays_a_recording_without_controls(recording: Path) -> None:
    arguments = words("--with dashboard:port=0 --realtime 10")
    with started("replay", str(recording), *arguments) as replay:
        page = page_of(replay)
        assert "this is a recording" in page.text()
        assert "not known here" not in page.text("budget")
        assert httpx2.get(f"http://127.0.0.1:{page.port}/", trust_env=False).status_code == 401
        began = time.monotonic()
        rows: list[list[float]] = []
        with browser(page) as channel:
            hello = json.loads(channel.recv(20.0))
            assert hello["steer"] is False
            metrics = msgspec.convert(hello["metrics"], dict[str, list[Metric]])
            assert metrics["now"] == [*NOW.values()]
            assert metrics["mission"] == [*MISSION.values()]
            channel.send('{"kind":"take","vehicle":"ugv_0"}')
            maps = 0
            for frame in frames(channel):
                rows += frame.get("rows", [])
                maps += "map" in frame
                assert frame["state"]["control"] == "free"
                if frame["state"]["replay"]["at"] >= 30.0:
                    break
            assert time.monotonic() - began < 25.0  # faster than recorded
        replay.send_signal(signal.SIGINT)
        assert replay.wait(20.0) == 130
    assert rows[0][0] == 0.0
    assert rows[-1][0] > 29.0
    assert maps > 5
    assert not serves(page)
