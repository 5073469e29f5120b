"""`outrider drive` in a real pseudo-terminal.

Messages for keys, contents of the screen, and restoration of the terminal.
"""

import asyncio
import codecs
import fcntl
import math
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

import msgspec
import pytest

from bus.joining import open_session
from bus.keys import CONTROL, OPERATOR, SAMPLED_TRUTH, STATUS, Party, Role
from bus.messages.control import Action, Control
from bus.messages.scenario import Area
from bus.messages.telemetry import Geometry, Status, Truth, VehicleTruth
from bus.messages.vehicle import Teleoperation
from bus.session import Session
from outrider.view.terminal.canvas import Canvas
from outrider.view.terminal.pressed_keys import FIRST, REPEAT, Heading, PressedKeys
from outrider.view.terminal.teleoperation import DriveLink, DriveView
from outrider.view.terminal.topview import Trails, draw
from processes import await_status, wait_until
from scattered import scattered
from statuses import PRESENT, a_status, a_truth, a_vehicle

pytest.importorskip("textual", reason="the extra [drive] is not installed")

CHILD = (
    "import fcntl, sys, termios\n"
    "if sys.stdin.isatty(): fcntl.ioctl(0, termios.TIOCSCTTY, 0)\n"
    "from outrider.cli import drive, main\nmain.main()\n"
)


class Screen:
    """A minimal terminal: characters by position, the cursor, the alternate screen."""

    def __init__(self, columns: int, rows: int) -> None:
        self.resize(columns, rows)
        self.modes: dict[str, bool] = {}
        self._rest = ""

    def resize(self, columns: int, rows: int) -> None:
        self.cells = [[" "] * columns for _ in range(rows)]
        self._x = self._y = 0

    def feed(self, text: str) -> None:
        text = self._rest + text
        cut = re.search(r"\x1b(?:\[[^@-~]*)?$", text)
        text, self._rest = (text[: cut.start()], cut[0]) if cut else (text, "")
        for found in re.finditer(
            r"\x1b(?:\[([?<>=]?)([\d;:]*)([$ ]?[@-~])|[^\[])|\r|\n|[^\x00-\x1f]", text
        ):
            self._apply(found[0], found[1], found[2], found[3])

    def _apply(self, piece: str, mark: str, numbers: str, kind: str) -> None:
        if kind == "H" and not mark:
            row, _, column = numbers.partition(";")
            self._y, self._x = int(row or 1) - 1, int(column or 1) - 1
        elif kind in ("h", "l") and mark == "?":
            self.modes[numbers] = kind == "h"
        elif piece == "\r":
            self._x = 0
        elif piece == "\n":
            self._y += 1
        elif not piece.startswith("\x1b"):
            if self._y < len(self.cells) and self._x < len(self.cells[0]):
                self.cells[self._y][self._x] = piece
            self._x += 1

    @property
    def text(self) -> str:
        return "\n".join("".join(row).rstrip() for row in self.cells)


class Terminal:
    """`outrider drive` in a pseudo-terminal of its own."""

    def __init__(self, *arguments: str) -> None:
        self.master, self.slave = pty.openpty()
        self.screen = Screen(80, 24)
        self.output = ""
        self._decode = codecs.getincrementaldecoder("utf-8")().decode
        self._set_size(80, 24)
        self.before = termios.tcgetattr(self.slave)
        self.process = subprocess.Popen(
            [sys.executable, "-c", CHILD, "drive", *arguments],
            stdin=self.slave,
            stdout=self.slave,
            stderr=self.slave,
            start_new_session=True,
            env=os.environ | {"TERM": "xterm-256color", "COLORTERM": "truecolor"},
        )

    def _set_size(self, columns: int, rows: int) -> None:
        fcntl.ioctl(self.master, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))

    def resize(self, columns: int, rows: int) -> None:
        self.screen.resize(columns, rows)
        self._set_size(columns, rows)

    def read(self, patience: float = 0.02) -> None:
        while select.select([self.master], [], [], patience)[0]:
            text = self._decode(os.read(self.master, 65536))
            self.output += text
            self.screen.feed(text)
            patience = 0.0

    def waiting(self) -> int:
        """Return the number of unread bytes in the terminal."""
        return int(struct.unpack("i", fcntl.ioctl(self.master, termios.FIONREAD, bytes(4)))[0])

    def press(self, keys: str) -> None:
        os.write(self.master, keys.encode())

    def wait_until_true(self, condition: Callable[[], object], seconds: float = 15.0) -> None:
        limit = time.monotonic() + seconds
        while not condition():
            self.read()
            assert time.monotonic() < limit, (
                f"waited in vain before this screen:\n{self.screen.text}\n{self.output[-500:]!r}"
            )

    def await_text(self, *texts: str) -> None:
        self.wait_until_true(lambda: all(text in self.screen.text for text in texts))

    def hold(self, key: str, condition: Callable[[], object], seconds: float = 15.0) -> None:
        """Press a key repeatedly, as a terminal does, until a condition is true."""
        limit = time.monotonic() + seconds
        while not condition():
            self.press(key)
            self.read(0.05)
            assert time.monotonic() < limit, f"held in vain before this screen:\n{self.screen.text}"

    def ends(self) -> int:
        self.wait_until_true(lambda: self.process.poll() is not None)
        self.read()
        return int(self.process.returncode)

    def is_restored(self) -> bool:
        modes = self.screen.modes
        return (
            termios.tcgetattr(self.slave) == self.before
            and modes["25"]
            and not modes["1049"]
            and not modes.get("2004")
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


def teleoperation(*arguments: str) -> closing[Terminal]:
    return closing(Terminal(*arguments))


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
        self.operators: dict[str, str] = {}
        self.tick = 100
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
                self.operators[vehicle] = envelope.message.operator or ""
            while (envelope := self._drives.next_waiting()) is not None:
                assert isinstance(envelope.message, Teleoperation)
                self.drives.append(envelope.message)
            self.tick += 1
            fields = {"drivers": dict(self.drivers)}
            fields["operators"] = {name: who for name, who in self.operators.items() if who}
            self._statuses.send(status_at(self.tick, **fields))
            self._truths.send(truth_at(self.tick))

    def count_requests(self, driver: str) -> int:
        return sum(
            msgspec.structs.replace(one, operator=None)
            == Control(action=Action.DRIVER, vehicle="ugv_0", driver=driver)
            for one in self.controls
        )

    def close(self) -> None:
        self._over.set()
        self._thread.join()


@contextmanager
def scripted(endpoint: str) -> Iterator[Scripted]:
    with (
        open_session(
            Party(role=Role.SIMULATOR, name="simulator"), "mine", connect=endpoint
        ) as session,
        closing(Scripted(session)) as one,
    ):
        yield one


@pytest.fixture(scope="module")
def endpoint(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Open a router and return its endpoint."""
    where = f"unixsock-stream/{tmp_path_factory.mktemp('r') / 's'}"
    with open_session(Party(role=Role.OBSERVER, name="observer"), "mine", listen=(where,)):
        yield where


def arguments(endpoint: str, *more: str) -> tuple[str, ...]:
    return ("--connect", endpoint, "--run", "mine", *more)


def test_keys_drive_the_ugv_and_restore_the_terminal(endpoint):
    with scripted(endpoint) as simulator, teleoperation(*arguments(endpoint)) as one:
        one.await_text(
            "script drives ugv_0",
            "distance uav_0",
            "1.25 m",
            "+3.50 m",
            "e(t)",
            "321.5 m²",
            "▲",
            "■",
            "real time (target x 1)",
        )
        assert not simulator.controls  # watching changes nothing
        assert termios.tcgetattr(one.slave) != one.before
        one.hold("d", lambda: len(simulator.drives) > 5)
        assert simulator.count_requests("teleop") == 1
        assert all(
            drive == Teleoperation(operator="operator", velocity=(0.2, 0.0))
            for drive in simulator.drives
        )
        one.await_text("YOU DRIVE ugv_0")
        one.wait_until_true(lambda: simulator.drives[-1].velocity is None)  # the key was released
        one.hold("\x1b[A", lambda: simulator.drives[-1].velocity == (0.0, 0.2))
        received = len(simulator.drives)
        one.press(" ")
        one.wait_until_true(lambda: simulator.drives[-1] == Teleoperation(operator="operator"))
        assert len(simulator.drives) <= received + 2  # at once, not after the timeout of the key
        one.press("h")
        one.await_text("script drives ugv_0")
        one.hold("S", lambda: simulator.drives[-1].velocity == (0.0, -0.2))
        assert simulator.count_requests("teleop") == 2
        one.press("q")
        assert one.ends() == 0
        assert simulator.count_requests("script") == 2
        assert simulator.drivers == {"ugv_0": "script"}
        assert one.is_restored()
        assert "ugv_0: control returned to script" in one.output


def test_of_two_terminals_only_one_drives_and_hands_back(endpoint: str) -> None:
    with (
        scripted(endpoint) as simulator,
        teleoperation(*arguments(endpoint)) as first,
        teleoperation(*arguments(endpoint)) as second,
    ):
        for one in (first, second):
            one.await_text("script drives ugv_0")
        first.hold("d", lambda: simulator.drives)
        first.await_text("YOU DRIVE ugv_0")
        second.await_text("another operator drives ugv_0")
        second.press("h")
        second.hold("w", lambda: simulator.drives[-1].velocity == (0.0, 0.2))
        assert (
            simulator.count_requests("script") == 0
        )  # `h` has no effect for an operator without control
        second.await_text("YOU DRIVE ugv_0")
        first.await_text("another operator drives ugv_0")
        for key in "hq":
            first.press(key)
        assert first.ends() == 0
        assert "another operator drives" in first.output
        assert simulator.count_requests("script") == 0
        second.press("\x03")
        assert second.ends() == 130
        assert second.is_restored()
        wait_until(lambda: simulator.drivers["ugv_0"] == "script")


def test_drive_continues_with_the_next_simulator(endpoint: str) -> None:
    with teleoperation(*arguments(endpoint, "--speed", "0.1", "--back", "waypoints")) as one:
        one.wait_until_true(lambda: "waiting for the simulator of the run mine" in one.output)
        with scripted(endpoint) as simulator:
            one.await_text("script drives ugv_0")
            one.hold("a", lambda: simulator.drives)
            assert simulator.drives[0].velocity == (-0.1, 0.0)
            one.await_text("YOU DRIVE")
        one.await_text("SIMULATOR DISCONNECTED")
        with scripted(endpoint) as simulator:
            one.await_text("drives ugv_0")
            one.wait_until_true(lambda: "DISCONNECTED" not in one.screen.text)
            one.hold("w", lambda: simulator.drivers["ugv_0"] == "teleop" and simulator.drives)
            assert simulator.drives[-1].velocity == (0.0, 0.1)
            one.resize(46, 20)
            one.await_text("YOU DRIVE", "distance uav_0", "1.25 m", "e(t)")
            assert "■" not in one.screen.text  # no room for a map
            one.resize(120, 40)
            one.await_text("■", "return control")
            one.hang_up()
            assert one.process.wait(15.0) == 129
            wait_until(lambda: simulator.drivers["ugv_0"] == "waypoints")


def test_control_taken_in_the_last_moment_is_handed_back(endpoint: str) -> None:
    with scripted(endpoint) as simulator, teleoperation(*arguments(endpoint)) as one:
        one.await_text("script drives ugv_0")
        one.press("dq")
        assert one.ends() == 0
        tick = simulator.tick
        wait_until(lambda: simulator.tick > tick + 5)  # all pending messages were received
        assert simulator.drivers == {"ugv_0": "script"}


def test_terminal_that_is_not_read_hands_control_back(endpoint: str) -> None:
    """No process reads the output, as over a frozen SSH connection."""
    with scripted(endpoint) as simulator, teleoperation(*arguments(endpoint)) as one:
        one.await_text("script drives ugv_0")
        one.hold("d", lambda: simulator.drivers["ugv_0"] == "teleop")
        wait_until(lambda: one.waiting() > 3000)
        wait_until(lambda: simulator.drives[-1].velocity is None)
        one.process.send_signal(signal.SIGTERM)
        assert one.process.wait(15.0) == 143
        assert termios.tcgetattr(one.slave) == one.before
        wait_until(lambda: simulator.drivers["ugv_0"] == "script")


def test_control_taken_before_the_first_status_is_handed_back(endpoint: str) -> None:
    simulator = Party(role=Role.SIMULATOR, name="simulator")
    operator = Party(role=Role.OPERATOR, name="operator")
    with (
        open_session(simulator, "silent", connect=endpoint) as mute,
        open_session(operator, "silent", connect=endpoint) as session,
    ):
        controls = mute.inbox(CONTROL)
        mute.announce()
        link = DriveLink(session, "ugv_0", speed=0.2, status=status_at())
        link.start()
        requests = []
        for driver in ("teleop", "script"):
            wait_until(lambda: link.press(Heading.EAST) or controls.holds_any(), 10.0)  # type: ignore[func-returns-value]
            envelope = controls.next_waiting()
            assert envelope is not None
            requests.append((driver, msgspec.structs.replace(envelope.message, operator=None)))
            link.leave()
        assert link.wait(10.0)
        assert requests == [
            (driver, Control(action=Action.DRIVER, vehicle="ugv_0", driver=driver))
            for driver in ("teleop", "script")
        ]
        assert "not confirmed yet" in link.farewell()


def test_an_unknown_vehicle_is_refused_with_those_that_there_are(endpoint: str) -> None:
    with scripted(endpoint), teleoperation(*arguments(endpoint, "--name", "ugv_7")) as one:
        assert one.ends() == 2
        assert "--name ugv_7: no UGV of this run; allowed: ugv_0" in one.output
        assert "1049" not in one.screen.modes


def test_without_a_terminal_there_is_one_clear_line(command) -> None:
    run = command("drive")  # pytest provides no terminal
    assert run.returncode == 2
    assert (
        run.stderr
        == "outrider: drive: standard input is not a terminal; over SSH use `ssh -t`, in a container `-it`\n"
    )


@pytest.mark.usefixtures("nothing_left_behind")
def test_operator_drives_in_real_time_without_jumps(tmp_path: Path) -> None:
    with scattered(tmp_path) as run:
        run.router()
        simulator = run.simulator("--realtime", "1")
        run.vehicles()
        files = tmp_path / "credentials"
        own = arguments(run.endpoint, "--credentials", str(files / "operator.json"))
        session = run.client("observer")
        with teleoperation(*own) as one:
            truths = session.inbox(SAMPLED_TRUTH)
            seen: list[VehicleTruth] = []

            def heads_west() -> bool:
                while (envelope := truths.next_waiting()) is not None:
                    if isinstance(envelope.message, Truth):
                        seen.append(envelope.message.vehicles["ugv_0"])
                return bool(seen) and seen[-1].velocity[0] < -0.15

            one.await_text("waypoints drives ugv_0", "4.75 m")
            one.hold("\x1b[D", heads_west)
            one.await_text("YOU DRIVE")
            assert max(math.hypot(*state.acceleration) for state in seen) <= 0.1 + 1e-9
            one.press("q")
            assert one.ends() == 0
            assert one.is_restored()
            assert "ugv_0: control returned to waypoints" in one.output
            after = await_status(session, lambda status: status.drivers == {"ugv_0": "waypoints"})
            drivers = [change.control.driver for change in after.changes]
            assert list(dict.fromkeys(drivers)) == ["teleop", "waypoints"]
        simulator.kill()


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
    ugv = next((row.index("■"), k) for k, row in enumerate(rows) if "■" in row)
    uav = next((row.index("▲"), k) for k, row in enumerate(rows) if "▲" in row)
    assert uav[1] == ugv[1]
    goal = next((row.index("×"), k) for k, row in enumerate(rows) if "×" in row)
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
    assert (
        "no position yet"
        in characters(draw(DriveView(), "ugv_0", trails, width=30, height=4, wide=False))[1]
    )


class Watching:
    """A link that only observes."""

    vehicle, over, leaving = "ugv_0", False, False

    def view(self) -> DriveView:
        return DriveView(status=status_at(), truth=truth_at(), driver="script", speed=0.2)


@pytest.mark.parametrize("columns", [44, 120])
def test_narrow_screen_shows_every_key_and_the_time(columns: int) -> None:
    from textual.widgets import Static

    from outrider.view.terminal.screen import DriveApp

    async def shown() -> dict[str, list[str]]:
        app = DriveApp(Watching(), "flight")  # type: ignore[arg-type]
        async with app.run_test(size=(columns, 24)) as pilot:
            await pilot.pause()
            parts = {
                name: app.query_one(f"#{name}", Static) for name in ("title", "banner", "keys")
            }
            return {
                name: [
                    "".join(piece.text for piece in part.render_line(y))
                    for y in range(part.size.height)
                ]
                for name, part in parts.items()
            }

    lines = asyncio.run(shown())
    for key in (
        "WASD ←↑↓→ drive",
        "space brake",
        "+- 0.20 m/s",
        "h return control",
        "z zoom",
        "q quit",
    ):
        assert any(key in line for line in lines["keys"]), lines
    assert "t = 5.0 s of 200 s" in lines["title"][0]
    assert "takes control" in " ".join(" ".join(lines["banner"]).split())
