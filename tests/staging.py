"""A server and its vehicles as threads of this process, with real sessions, for the tests.

The real loop and the real pilots.
"""

import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import zenoh
from processes import wait_until

from agents import process
from agents.uav import UavPilot
from agents.ugv import UgvPilot
from bus import session
from bus.access import Credential, client_settings, new_credentials
from bus.keys import CONTROL, STATUS
from bus.messages import Status
from bus.session import Session, open_session
from outrider.running.flying import fly
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario
from sim.server.flight import Flight
from sim.server.run_timing import Timing
from sim.server.serving import Server

GIVEN = new_credentials("run", ["uav_0"], ["ugv_0"])
PILOT = {"uav_0": UavPilot, "ugv_0": UgvPilot}


class Gone(Exception):
    """A vehicle's process that ends without a word."""


class Vehicle:
    """A vehicle's process as a thread: the real loop and the real pilot, watched.

    Args:
        endpoint: Of the router.
        name: The vehicle.
        until: It is gone once this tick has been answered.
        heir: Called once it is gone.
        on_tick: Called with each tick before it acts.
    """

    def __init__(self, endpoint, name, until=None, on_tick=lambda _tick: None, heir=lambda: None):
        self.name = name
        self.seen: list[Any] = []
        """All it has acted on, its past first."""
        self._endpoint, self._until, self._on_tick, self._heir = endpoint, until, on_tick, heir
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def join(self) -> None:
        self._thread.join(60.0)
        assert not self._thread.is_alive()

    def _run(self) -> None:
        credential = GIVEN.of(self.name)
        try:
            process.fly(
                credential.party,
                self._make,
                connect=self._endpoint,
                run="run",
                credential=credential,
            )
        except Gone:
            self._heir()

    def _make(self, told: Any) -> "Vehicle":
        self._pilot = PILOT[self.name](told)
        self.seen.clear()
        return self

    def act(self, observation: Any) -> Any:
        self._on_tick(observation.tick)
        if self._until is not None and observation.tick > self._until:
            raise Gone
        self.seen.append(observation)
        return self._pilot.act(observation)


class Stage:
    """A server, and what it says."""

    def __init__(self, stack: ExitStack, folder: Path, scenario: Scenario, **options: Any) -> None:
        self.endpoint = f"unixsock-stream/{folder / 'bus.sock'}"
        self.events: list[str] = []
        simulator = GIVEN.of("simulator").party
        self.server_session = stack.enter_context(
            open_session(simulator, "run", listen=(self.endpoint,), given=GIVEN)
        )
        timing = Timing(
            **{key: options.pop(key) for key in set(options) & {*Timing.__struct_fields__}}
        )
        self.server = Server(
            self.server_session,
            scenario,
            scenario.seed,
            timing,
            on_event=self.events.append,
            **options,
        )
        self.vehicles: list[Vehicle] = []
        self._stack = stack

    def start(self, name, *, until=None, again=False, on_tick=lambda _tick: None):
        """Start a vehicle; one that is gone `again` has another in its place at once."""

        def heir() -> None:
            if again:
                self.start(name)

        self.vehicles.append(Vehicle(self.endpoint, name, until, on_tick, heir))
        return self.vehicles[-1]

    def start_both(self) -> list[Vehicle]:
        return [self.start("uav_0"), self.start("ugv_0")]

    def client(self, name: str) -> Session:
        credential = GIVEN.of(name)
        return self._stack.enter_context(
            open_session(credential.party, "run", connect=self.endpoint, credential=credential)
        )

    def fly(self, on_tick: Callable[[], None] | None = None) -> Flight:
        flight = self.server.fly(on_tick=on_tick)
        for vehicle in self.vehicles:
            vehicle.join()
        return flight


@contextmanager
def stage(folder, ticks, *, scenario=None, **options):
    scenario = scenario or load_scenario("escort", overrides=[f"duration={ticks * 0.05!r}"])
    with ExitStack() as stack:
        yield Stage(stack, folder, scenario, **options)


def raw_session(endpoint: str, credential: Credential | None, **settings: Any) -> zenoh.Session:
    """A session that asks nobody's leave and does not say whose it is."""
    own = {name.replace("__", "/"): value for name, value in settings.items()}
    known = session._COMMON | session._CLIENT | client_settings(credential)
    return zenoh.open(session._config(known | {"connect/endpoints": [endpoint]} | own))


def whole(ticks: int) -> Flight:
    scenario = load_scenario("escort", overrides=[f"duration={ticks * 0.05!r}"])
    return fly(scenario, scenario.seed)[0]


def await_status(statuses: Any, wanted: Callable[[Status], bool]) -> Status:
    limit = time.monotonic() + 20.0
    while time.monotonic() < limit:
        letter = statuses.receive(0.5)
        if letter is not None and wanted(letter.message):
            return letter.message
    raise AssertionError("never came")


def operating(run: Any, work: Callable[[Any, Any], None]) -> Callable[[], None]:
    """Let an operator work while the run flies; to be called when it is over."""
    operator = run.client("operator")
    controls, statuses = operator.outbox(CONTROL), operator.inbox(STATUS)
    faults: list[BaseException] = []

    def body() -> None:
        try:
            wait_until(lambda: controls.wanted)
            work(controls.send, lambda wanted: await_status(statuses, wanted))
        except BaseException as error:  # noqa: BLE001 - told in the test's own thread
            faults.append(error)
            run.server.flight.stop()

    hand = threading.Thread(target=body)
    hand.start()

    def end() -> None:
        hand.join(60.0)
        if faults:
            raise faults[0]

    return end
