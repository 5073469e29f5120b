"""A server and its vehicles as threads of this process, with real sessions, for the tests.

The vehicles run the real loop with the real pilots, or programs of the test. Raw sessions show what a router lets
through.
"""

import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from typing import Any

import msgspec
import zenoh

from agents import process
from agents.uav import UavPilot
from agents.ugv import UgvPilot
from bus import joining
from bus.access import client_settings
from bus.credentials import Credential, CredentialSet, new_credentials
from bus.joining import open_session
from bus.keys import BRIEFING, COMMAND, CONTROL, OBSERVATION, STATUS
from bus.session import Session
from outrider.running.flying import fly
from processes import status_in, wait_until
from sim.scenario.loading import load_scenario
from sim.scenario.types import Run, Scenario
from sim.server.flight import Flight
from sim.server.serving import Server

GIVEN = new_credentials("run", ["uav_0"], ["ugv_0"])
PILOT = {"uav_0": UavPilot, "ugv_0": UgvPilot}


def hosted(
    endpoint: str, given: CredentialSet = GIVEN, name: str = "simulator"
) -> AbstractContextManager[Session]:
    """Open a router as this party that admits clients with credentials."""
    return open_session(given.of(name).party, given.run, listen=(endpoint,), given=given)


def client_of(endpoint: str, credential: Credential) -> AbstractContextManager[Session]:
    """Open a client with its credentials."""
    return open_session(credential.party, "run", connect=endpoint, credential=credential)


class Vanished(Exception):
    """Raised to end a vehicle's process without notice."""


class _Threaded:
    """A thread that runs from its construction on."""

    def __init__(self, run: Callable[[], None]) -> None:
        self._thread = threading.Thread(target=run, daemon=True)
        self._thread.start()

    def join(self) -> None:
        self._thread.join(60.0)
        assert not self._thread.is_alive()


class Program(_Threaded):
    """A program of the test that flies a vehicle.

    Args:
        session: The vehicle's session.
        answer: Called with the outbox of its commands and the tick of each observation.
    """

    def __init__(self, session: Session, answer: Callable[[Any, int], None]) -> None:
        role, name = session.party.role, session.party.name
        self.session = session
        self.observations = session.inbox(OBSERVATION[role], name)
        self._briefings = session.inbox(BRIEFING[role], name)
        self._commands, self._answer = session.outbox(COMMAND[role], name), answer
        session.announce()
        super().__init__(self._run)

    def _run(self) -> None:
        assert self._briefings.receive(20.0) is not None
        while (
            envelope := self.observations.receive(20.0)
        ) is not None and not envelope.message.over:
            self._answer(self._commands, envelope.message.tick)


class Vehicle(_Threaded):
    """A vehicle's process as a thread: the real loop and the real pilot, watched.

    Args:
        endpoint: Endpoint of the router.
        name: The vehicle.
        is_open: The router needs no credentials.
        until: The last tick that it answers.
        successor: Called when it has ended.
        on_tick: Called with each tick before it acts.
    """

    def __init__(
        self,
        endpoint: str,
        name: str,
        *,
        is_open: bool = False,
        until: int | None = None,
        successor: Callable[[], None] = lambda: None,
        on_tick: Callable[[int], object] = lambda _tick: None,
    ) -> None:
        self.name = name
        self._party, self._credential = GIVEN.of(name).party, None if is_open else GIVEN.of(name)
        self.seen: list[Any] = []
        """All observations, its past first."""
        self._endpoint, self._until = endpoint, until
        self._on_tick, self._successor = on_tick, successor
        super().__init__(self._run)

    def _run(self) -> None:
        bus: dict[str, Any] = {"connect": self._endpoint, "credential": self._credential}
        try:
            process.fly(self._party, self._make, run="run", **bus)
        except Vanished:
            self._successor()

    def _make(self, briefing: Any) -> "Vehicle":
        self._pilot = PILOT[self.name](briefing)
        self.seen.clear()
        return self

    def act(self, observation: Any) -> Any:
        self._on_tick(observation.tick)
        if self._until is not None and observation.tick > self._until:
            raise Vanished
        self.seen.append(observation)
        return self._pilot.act(observation)


class Stage:
    """A server and its events; an open router admits every client."""

    def __init__(
        self, stack: ExitStack, folder: Path, scenario: Scenario, *, is_open: bool, **options: Any
    ) -> None:
        self.endpoint = f"unixsock-stream/{folder / 'bus.sock'}"
        self.events: list[str] = []
        self._is_open = is_open
        simulator, given = GIVEN.of("simulator").party, None if is_open else GIVEN
        self.server_session = stack.enter_context(
            open_session(simulator, "run", listen=(self.endpoint,), given=given)
        )
        run = Run(**{key: options.pop(key) for key in set(options) & {*Run.__struct_fields__}})
        scenario = msgspec.structs.replace(scenario, run=run)
        options["on_event"] = self.events.append
        self.server = Server(self.server_session, scenario, scenario.seed, **options)
        self.vehicles: list[Any] = []
        self._stack = stack

    def start(self, name: str, *, again: bool = False, **options: Any) -> Vehicle:
        """Start a vehicle; with `again`, another one replaces it when it has ended."""
        if again:
            options["successor"] = lambda: self.start(name)
        self.vehicles.append(Vehicle(self.endpoint, name, **options))
        return self.vehicles[-1]

    def start_both(self) -> list[Vehicle]:
        return [self.start("uav_0"), self.start("ugv_0")]

    def program(self, name: str, answer: Callable[[Any, int], None]) -> Program:
        """Start a program of the test as a vehicle."""
        self.vehicles.append(Program(self.client(name), answer))
        return self.vehicles[-1]

    def client(self, name: str) -> Session:
        party, credential = GIVEN.of(name).party, None if self._is_open else GIVEN.of(name)
        return self._stack.enter_context(
            open_session(party, "run", connect=self.endpoint, credential=credential)
        )

    def fly(
        self,
        on_tick: Callable[[], None] | None = None,
        *,
        operator: Callable[[Any, Any], None] | None = None,
    ) -> Flight:
        """Fly to the end; meanwhile an operator may send controls and await a status."""
        with ThreadPoolExecutor(1) as threads:
            work = operator and threads.submit(self._operate, self.client("operator"), operator)
            flight = self.server.fly(on_tick=on_tick)
            for vehicle in self.vehicles:
                vehicle.join()
        if work:
            work.result()
        return flight

    def _operate(self, operator: Session, work: Callable[[Any, Any], None]) -> None:
        controls, statuses = operator.outbox(CONTROL), operator.inbox(STATUS)
        try:
            wait_until(lambda: controls.wanted)
            work(controls.send, lambda wanted: status_in(statuses, wanted, 20.0))
        except BaseException:
            self.server.flight.stop()
            raise


@contextmanager
def stage(folder, ticks, *, scenario=None, is_open=False, **options):
    scenario = scenario or load_scenario("escort", overrides=[f"duration={ticks * 0.05!r}"])
    with ExitStack() as stack:
        yield Stage(stack, folder, scenario, is_open=is_open, **options)


def raw_session(endpoint: str, credential: Credential | None, **settings: Any) -> zenoh.Session:
    """Open a session without the checks of our API."""
    own = {name.replace("__", "/"): value for name, value in settings.items()}
    known = joining._COMMON | joining._CLIENT | client_settings(credential)
    return zenoh.open(joining._config(known | {"connect/endpoints": [endpoint]} | own))


def zenoh_of(session: Session) -> zenoh.Session:
    """Return the raw session below ours, without its checks."""
    return session.below


@contextmanager
def raw_sessions(
    endpoint: str, given: CredentialSet, names: Iterable[str], router: str = "simulator"
) -> Iterator[dict[str, zenoh.Session]]:
    """Open a router, and a raw session for each of these parties."""
    with ExitStack() as stack:
        stack.enter_context(hosted(endpoint, given, router))
        yield {name: stack.enter_context(raw_session(endpoint, given.of(name))) for name in names}


Received = set[tuple[str, str, str]]
"""Reader, key and message."""


def subscribed(
    opened: zenoh.Session, name: str, expressions: Iterable[str], received: Received
) -> list[object]:
    """Record what a party receives by these keys, until the returned subscribers are dropped."""

    def record_sample(sample: zenoh.Sample) -> None:
        received.add((name, str(sample.key_expr), sample.payload.to_string()))

    return [opened.declare_subscriber(expression, record_sample) for expression in expressions]


def await_exactly(
    wanted: set[Any], found: set[Any], step: Callable[[], object] = lambda: None
) -> None:
    """Repeat a step until everything expected has arrived, and a little longer for anything unexpected."""
    limit = time.monotonic() + 20.0
    while not found >= wanted and time.monotonic() < limit:
        step()
        time.sleep(0.02)
    rest = time.monotonic() + 0.3
    while time.monotonic() < rest:
        step()
        time.sleep(0.02)


def local_flight(ticks: int) -> Flight:
    scenario = load_scenario("escort", overrides=[f"duration={ticks * 0.05!r}"])
    return fly(scenario, scenario.seed)[0]
