"""`outrider drive`: messages for keys, contents of the screen, and restoration of the terminal."""

import asyncio
import codecs
import fcntl
import math
import os
import pty
import select
import signal
import struct
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from bus.joining import open_session
from bus.keys import CONTROL, OPERATOR, SAMPLED_TRUTH, STATUS, Party, Role
from bus.messages.control import Action, Control
from bus.messages.scenario import Area
from bus.messages.telemetry import Geometry, Status, Truth
from bus.messages.vehicle import Teleoperation
from bus.session import Session
from outrider.view.terminal.canvas import Canvas
from outrider.view.terminal.panel import banner
from outrider.view.terminal.pressed_keys import FIRST, REPEAT, Heading, PressedKeys
from outrider.view.terminal.teleoperation import DriveLink, DriveView
from outrider.view.terminal.topview import Trails, draw
from processes import wait_until
from staging import stage
from statuses import PRESENT, a_status, a_truth, a_vehicle

pytest.importorskip("textual", reason="the extra [drive] is not installed")

from textual.widgets import Static

from outrider.view.terminal.screen import DriveApp, TopView

CHILD = (
    "import fcntl, termios\nfcntl.ioctl(0, termios.TIOCSCTTY, 0)\n"
    "from outrider.cli import main\nmain.main()\n"
)


class Terminal:
    """`outrider drive` in a pseudo-terminal of its own."""

    def __init__(self, endpoint: str) -> None:
        self.master, self.slave = pty.openpty()
        termios.tcsetwinsize(self.slave, (24, 80))
        self.output = ""
        self._decode = codecs.getincrementaldecoder("utf-8")().decode
        self.before = termios.tcgetattr(self.slave)
        self.process = subprocess.Popen(
            [sys.executable, "-c", CHILD, "drive", "--connect", endpoint, "--run", "mine"],
            stdin=self.slave,
            stdout=self.slave,
            stderr=self.slave,
            start_new_session=True,
            env=os.environ | {"TERM": "xterm-256color", "COLORTERM": "truecolor"},
        )

    def count_unread(self) -> int:
        """Return the number of unread bytes in the terminal."""
        return int(struct.unpack("i", fcntl.ioctl(self.master, termios.FIONREAD, bytes(4)))[0])

    def press(self, keys: str) -> None:
        os.write(self.master, keys.encode())

    def await_that(
        self, condition: Callable[[], object], *, held: str = "", seconds: float = 15.0
    ) -> None:
        """Read until a condition is true; meanwhile repeat a held key, as a terminal does."""
        limit = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < limit, (
                f"waited in vain; the last output: {self.output[-2000:]!r}"
            )
            self.press(held)
            while select.select([self.master], [], [], 0.05)[0]:
                self.output += self._decode(os.read(self.master, 65536))

    def await_text(self, text: str) -> None:
        """Read until the screen shows a text that it has not shown since the last call."""
        self.await_that(lambda: text in self.output)
        self.output = self.output.partition(text)[2]

    def is_restored(self) -> bool:
        """Return whether the cursor is visible, and all modes and attributes are the previous ones."""
        modes = ("\x1b[?25", "lh"), ("\x1b[?1049", "hl"), ("\x1b[?2004", "hl")
        return termios.tcgetattr(self.slave) == self.before and all(
            self.output.rfind(mode + last) >= self.output.rfind(mode + first)
            for mode, (first, last) in modes
        )

    def hang_up(self) -> None:
        os.close(self.master)
        os.close(self.slave)
        self.master = self.slave = -1

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        for descriptor in (self.master, self.slave):
            with suppress(OSError):
                os.close(descriptor)


GEOMETRY = Geometry(
    area=Area(width=40.0, height=40.0, cell=0.25),
    visibility_radius=4.75,
    sensor_range=5.0,
    switching_radius=3.68,
    dt=0.05,
    uavs={"uav_0": "ugv_0"},
    goals={"ugv_0": ((12.0, 12.0),)},
)


def status_at(tick: int = 100, **changes: object) -> Status:
    shown = {"ticks": 4000, "target_factor": 1.0, "geometry": GEOMETRY, "vehicles": PRESENT}
    shown |= {"tick": tick, "time": tick * 0.05, "drivers": {"ugv_0": "script"}}
    return a_status(**shown | changes)


def truth_at(tick: int = 100, distance: float = 1.25) -> Truth:
    uav = a_vehicle((10.0 + distance, 10.0), (0.3, 0.0))
    ugv = a_vehicle((10.0, 10.0), (0.2, 0.0))
    return a_truth(tick * 0.05, uav, ugv, distance=distance, coverage_error=321.5)


class Scripted:
    """A simulator that flies nothing: it sends a status, follows controls, and records all messages."""

    def __init__(self, session: Session) -> None:
        self.controls: list[Control] = []
        self.drives: list[Teleoperation] = []
        self.drivers = {"ugv_0": "script"}
        self._operators: dict[str, str] = {}
        self._tick = 100
        self._over = threading.Event()
        self._statuses, self._truths = session.outbox(STATUS), session.outbox(SAMPLED_TRUTH)
        self._controls = session.inbox(CONTROL)
        self._drives = session.inbox_of_all({"ugv_0": OPERATOR})
        session.announce()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._over.wait(0.03):
            while (envelope := self._controls.next_waiting()) is not None:
                assert isinstance(envelope.message, Control)
                self.controls.append(envelope.message)
                vehicle = envelope.message.vehicle or ""
                self.drivers[vehicle] = envelope.message.driver or ""
                self._operators[vehicle] = envelope.message.operator or ""
            while (envelope := self._drives.next_waiting()) is not None:
                assert isinstance(envelope.message, Teleoperation)
                self.drives.append(envelope.message)
            self._tick += 1
            operators = {name: who for name, who in self._operators.items() if who}
            self._statuses.send(
                status_at(self._tick, drivers=dict(self.drivers), operators=operators)
            )
            self._truths.send(truth_at(self._tick))

    def count_requests(self, driver: str) -> int:
        return sum(without_operator(one) == request(driver) for one in self.controls)

    def close(self) -> None:
        self._over.set()
        self._thread.join()


def request(driver: str) -> Control:
    return Control(action=Action.DRIVER, vehicle="ugv_0", driver=driver)


def without_operator(control: Any) -> Control:
    return msgspec.structs.replace(control, operator=None)


def joined(role: Role, endpoint: str, run: str = "mine") -> Any:
    return open_session(Party(role=role, name=role.value), run, connect=endpoint)


@contextmanager
def scripted(endpoint: str) -> Iterator[Scripted]:
    with joined(Role.SIMULATOR, endpoint) as session, closing(Scripted(session)) as one:
        yield one


@contextmanager
def linked(session: Session, **fields: Any) -> Iterator[DriveLink]:
    """Start the link of an operator's terminal, and end it."""
    link = DriveLink(session, "ugv_0", **{"speed": 0.2, "status": status_at()} | fields)
    link.start()
    try:
        yield link
    finally:
        link.leave()
        assert link.wait(10.0)


def press_until(link: DriveLink, heading: Heading, condition: Callable[[], object]) -> None:
    """Press a key repeatedly until a condition is true."""

    def is_reached() -> object:
        link.press(heading)
        return condition()

    wait_until(is_reached)


def await_banner(link: DriveLink, text: str) -> None:
    wait_until(lambda: text in banner(link.view(), "ugv_0", leaving=link.leaving).text)


@pytest.fixture(scope="module")
def endpoint(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Open a router and return its endpoint."""
    where = f"unixsock-stream/{tmp_path_factory.mktemp('r') / 's'}"
    with open_session(Party(role=Role.OBSERVER, name="observer"), "mine", listen=(where,)):
        yield where


# Real terminals


def test_keys_drive_the_ugv_and_restore_the_terminal(endpoint: str) -> None:
    with closing(Terminal(endpoint)) as one, ExitStack() as stack:
        one.await_text("waiting for the simulator of the run mine")
        simulator = stack.enter_context(scripted(endpoint))
        one.await_text("script drives ugv_0")
        assert not simulator.controls  # watching changes nothing
        assert termios.tcgetattr(one.slave) != one.before
        one.await_that(lambda: len(simulator.drives) > 5, held="d")
        assert simulator.count_requests("teleop") == 1
        east = Teleoperation(operator="operator", velocity=(0.2, 0.0))
        assert all(drive == east for drive in simulator.drives)
        one.await_text("YOU DRIVE ugv_0")
        one.await_that(lambda: simulator.drives[-1].velocity is None)  # the key was released
        one.await_that(lambda: simulator.drives[-1].velocity == (0.0, 0.2), held="\x1b[A")
        received = len(simulator.drives)
        one.press(" ")
        one.await_that(lambda: simulator.drives[-1] == Teleoperation(operator="operator"))
        assert len(simulator.drives) <= received + 2  # at once, not after the timeout of the key
        one.press("h")
        one.await_text("script drives ugv_0")
        one.await_that(lambda: simulator.drives[-1].velocity == (0.0, -0.2), held="S")
        assert simulator.count_requests("teleop") == 2
        one.press("q")
        one.await_that(lambda: one.process.poll() is not None)
        assert one.process.returncode == 0
        assert simulator.count_requests("script") == 2
        assert simulator.drivers == {"ugv_0": "script"}
        assert one.is_restored()
        assert "ugv_0: control returned to script" in one.output


@pytest.mark.parametrize("fault", ["frozen", "closed"])
def test_lost_terminal_hands_control_back(fault: str, endpoint: str) -> None:
    """No process reads the output, as over a frozen SSH connection, or the terminal is closed."""
    with scripted(endpoint) as simulator, closing(Terminal(endpoint)) as one:
        one.await_text("script drives ugv_0")
        one.await_that(lambda: simulator.drivers["ugv_0"] == "teleop", held="d")
        if fault == "frozen":
            wait_until(lambda: one.count_unread() > 3000)
            wait_until(lambda: simulator.drives[-1].velocity is None)
            one.process.send_signal(signal.SIGTERM)
            assert one.process.wait(15.0) == 143
            assert termios.tcgetattr(one.slave) == one.before
        else:
            one.hang_up()
            assert one.process.wait(15.0) == 129
        wait_until(lambda: simulator.drivers["ugv_0"] == "script")


def test_unknown_vehicle_or_missing_terminal_is_refused(endpoint, command, monkeypatch) -> None:
    words = ("drive", "--connect", endpoint, "--run", "mine", "--name", "ugv_7")
    run = command(*words)  # pytest provides no terminal
    assert run.returncode == 2
    assert run.stderr.startswith("outrider: drive: standard input is not a terminal; over SSH use")
    monkeypatch.setattr("outrider.view.terminal.terminal.check_terminal", lambda: None)
    with scripted(endpoint):
        run = command(*words)
    assert run.returncode == 2
    assert "--name ugv_7: no UGV of this run; allowed: ugv_0" in run.stderr


# Control over the UGV


def test_of_two_operators_only_one_drives_and_hands_back(endpoint: str) -> None:
    with (
        scripted(endpoint) as simulator,
        joined(Role.OPERATOR, endpoint) as one,
        joined(Role.OPERATOR, endpoint) as other,
        linked(one) as first,
        linked(other) as second,
    ):
        press_until(first, Heading.EAST, lambda: simulator.drives)
        await_banner(first, "YOU DRIVE ugv_0")
        await_banner(second, "another operator drives ugv_0")
        second.hand_back()
        press_until(second, Heading.NORTH, lambda: simulator.drives[-1].velocity == (0.0, 0.2))
        await_banner(second, "YOU DRIVE ugv_0")
        await_banner(first, "another operator drives ugv_0")
        first.hand_back()
        first.leave()
        assert first.wait(10.0)
        assert first.farewell() == "ugv_0: another operator drives"
        assert simulator.count_requests("script") == 0  # only the operator in control returns it
        second.leave()
        assert second.wait(10.0)
        assert second.farewell() == "ugv_0: control returned to script"
        assert simulator.drivers["ugv_0"] == "script"


def test_drive_continues_with_the_next_simulator(endpoint: str) -> None:
    with (
        joined(Role.OPERATOR, endpoint) as session,
        linked(session, speed=0.1, back="waypoints") as link,
    ):
        with scripted(endpoint) as simulator:
            press_until(link, Heading.WEST, lambda: simulator.drives)
            assert simulator.drives[0].velocity == (-0.1, 0.0)
            await_banner(link, "YOU DRIVE")
        await_banner(link, "SIMULATOR DISCONNECTED")
        wait_until(lambda: link.view().wanted is None)  # a held key would not take control again
        with scripted(endpoint) as simulator:
            await_banner(link, "script drives ugv_0")
            press_until(link, Heading.NORTH, lambda: simulator.drives)
            assert simulator.drives[-1].velocity == (0.0, 0.1)
            await_banner(link, "YOU DRIVE")
            link.leave()
            assert link.wait(10.0)
            assert simulator.drivers["ugv_0"] == "waypoints"


def test_control_taken_before_the_first_status_is_handed_back(endpoint: str) -> None:
    with (
        joined(Role.SIMULATOR, endpoint, "silent") as mute,
        joined(Role.OPERATOR, endpoint, "silent") as session,
    ):
        controls = mute.inbox(CONTROL)
        mute.announce()
        with linked(session) as link:
            press_until(link, Heading.EAST, controls.holds_any)
            taken = controls.next_waiting()
        wait_until(controls.holds_any)
        returned = controls.next_waiting()
        assert [without_operator(one.message) for one in (taken, returned)] == [
            request("teleop"),
            request("script"),
        ]
        assert "not confirmed yet" in link.farewell()


def test_operator_drives_a_simulated_ugv_without_jumps(tmp_path: Path) -> None:
    with stage(tmp_path, 100_000, realtime=4.0) as run:
        run.start_both()

        def work(_send: Any, status: Any) -> None:
            with linked(run.client("operator"), status=status(lambda s: s.tick > 10)) as link:
                velocity = run.server.flight.world.velocity
                press_until(link, Heading.WEST, lambda: velocity[1, 0] < -0.15)
                await_banner(link, "YOU DRIVE ugv_0")
            assert link.farewell() == "ugv_0: control returned to waypoints"
            run.server.flight.stop()

        flight = run.fly(operator=work)
    v = flight.recorder.states[:, 1, 2:4]
    assert v[:, 0].min() < -0.15
    assert np.hypot(*np.diff(v, axis=0).T).max() <= 0.1 * 0.05 + 1e-12
    assert [change.control.driver for change in run.server.changes] == ["teleop", "waypoints"]


# Keys and screen


def test_key_expires_unless_it_is_repeated() -> None:
    keys = PressedKeys(0.2)
    assert keys.velocity(0.0) is None
    keys.press(Heading.EAST, 10.0)
    assert keys.velocity(10.0 + 0.99 * FIRST) == (0.2, 0.0)
    assert keys.velocity(10.0 + FIRST) is None
    keys.press(Heading.EAST, 20.0)
    keys.press(Heading.EAST, 20.0 + 0.9 * FIRST)
    assert keys.velocity(20.0 + 0.9 * FIRST + 0.99 * REPEAT) == (0.2, 0.0)
    assert keys.velocity(20.0 + 0.9 * FIRST + REPEAT) is None
    keys.press(Heading.WEST, 30.0)
    keys.release()
    assert keys.velocity(30.0) is None


def test_two_keys_drive_diagonally_and_successive_keys_turn() -> None:
    keys = PressedKeys(0.2)
    keys.press(Heading.NORTH, 0.0)
    keys.press(Heading.EAST, 0.1)
    assert keys.velocity(0.1) == pytest.approx((0.2 / math.sqrt(2.0), 0.2 / math.sqrt(2.0)))
    keys.press(Heading.EAST, 0.6)  # only the last key of a chord is repeated
    assert keys.velocity(0.9) == pytest.approx((0.2 / math.sqrt(2.0), 0.2 / math.sqrt(2.0)))
    keys.press(Heading.SOUTH, 0.95)
    assert keys.velocity(0.95) == (0.0, -0.2)
    keys.press(Heading.NORTH, 1.0)  # opposite keys never cancel out
    assert keys.velocity(1.0) == (0.0, 0.2)


def characters(canvas: Canvas) -> list[str]:
    return ["".join(segment.text for segment in canvas.row(row)) for row in range(canvas.height)]


def test_map_shows_vehicles_and_visibility_radius() -> None:
    trails = Trails()
    trails.follow(truth_at())
    view = DriveView(status=status_at(), truth=truth_at(distance=3.0))
    rows = characters(draw(view, "ugv_0", trails, width=44, height=21, wide=False))
    ugv, uav, goal = (
        next((row.index(mark), k) for k, row in enumerate(rows) if mark in row) for mark in "■▲×"
    )
    assert uav[1] == ugv[1]
    assert goal[0] > ugv[0]
    assert goal[1] < ugv[1]
    metres_per_cell = 3.0 / (uav[0] - ugv[0])
    line = rows[ugv[1]]
    rim = max(k for k, letter in enumerate(line) if "\u2800" < letter <= "\u28ff") - ugv[0]
    assert rim * metres_per_cell == pytest.approx(4.75, abs=1.0)
    for wide in (False, True):
        for width, height in ((1, 1), (3, 2), (200, 60)):
            drawn = characters(draw(view, "ugv_0", trails, width=width, height=height, wide=wide))
            assert [len(row) for row in drawn] == [width] * height
    empty = characters(draw(DriveView(), "ugv_0", trails, width=30, height=4, wide=False))
    assert "no position yet" in empty[1]


def test_map_shows_the_heading_of_a_ugv_that_steers() -> None:
    def around(heading: float | None) -> list[str]:
        ugv = a_vehicle((10.0, 10.0), heading=heading)
        view = DriveView(status=status_at(), truth=a_truth(5.0, a_vehicle((2.0, 2.0)), ugv))
        rows = characters(draw(view, "ugv_0", Trails(), width=44, height=21, wide=False))
        line = next(row for row in rows if "■" in row)
        place = line.index("■")
        return [line[place - 2 : place], line[place + 1 : place + 3]]

    assert around(None) == ["  ", "  "]
    west, east = around(0.0)
    assert (west, "\u2800" < east[0] <= "\u28ff") == ("  ", True)
    assert around(math.pi)[1] == "  "


class Watching:
    """A link that only observes."""

    vehicle, over, leaving = "ugv_0", False, False

    def view(self) -> DriveView:
        return DriveView(status=status_at(), truth=truth_at(), driver="script", speed=0.2)

    def leave(self) -> None:
        self.over = True


@pytest.mark.parametrize("columns", [44, 120])
def test_screen_of_any_width_shows_numbers_keys_and_time(columns: int) -> None:
    async def shown() -> dict[str, list[str]]:
        app: Any = DriveApp(Watching(), "flight")  # type: ignore[arg-type]
        async with app.run_test(size=(80, 24)) as pilot:
            await pilot.resize_terminal(columns, 24)
            await pilot.pause()
            parts = {
                name: app.query_one(f"#{name}", Static)
                for name in ("title", "banner", "numbers", "keys")
            }
            lines = {
                name: [
                    "".join(piece.text for piece in part.render_line(y))
                    for y in range(part.size.height)
                ]
                for name, part in parts.items()
            }
            assert app.query_one(TopView).display is (columns == 120)  # no room for a map
            await pilot.press("ctrl+c")
            await pilot.pause(0.3)
        assert app.return_value == 130
        return lines

    lines = asyncio.run(shown())
    for name, texts in (
        ("keys", ("WASD ←↑↓→ drive", "space brake", "+- 0.20 m/s", "h return control")),
        ("keys", ("z zoom", "q quit")),
        ("numbers", ("distance uav_0", " 1.25 m", " +3.50 m", "e(t)", "321.5 m²")),
        ("numbers", ("real time (target x 1)",)),
        ("title", ("t = 5.0 s of 200 s",)),
    ):
        assert all(any(text in line for line in lines[name]) for text in texts), lines
    assert "takes control" in " ".join(" ".join(lines["banner"]).split())
