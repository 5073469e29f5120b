"""Message loop of a vehicle's process: connects any pilot to the bus."""

import copy
import logging
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

import msgspec

from agents.control.orbit import Path
from agents.control.weighting import Weighting
from agents.drivers.policy import Policy
from agents.warming import exercise, warm_up
from bus.credentials import Credential
from bus.errors import BusError, PeerLost, ScenarioError
from bus.joining import open_session
from bus.keys import BRIEFING, COMMAND, OBSERVATION, SIMULATOR_NAME, Party
from bus.messages.vehicle import (
    Command,
    UavBriefing,
)
from bus.presence import Presence
from bus.session import Envelope, Outbox, Session

if TYPE_CHECKING:
    from agents.laws.policy import UavPolicy
    from agents.uav import Inner

_QUEUE_LENGTH = 1024
"""Capacity of the observation queue; if a pilot is slower than the clock, the oldest observations are dropped."""


class Pilot(Protocol):
    """Interface of a pilot; the key table defines which messages it receives.

    A pilot may define four optional methods:

    - `prepare()` is called after its command has been sent, to work ahead.
    - `perceive(observation)` receives observations that the pilot was too slow to answer.
    - `forget_commands()` is called when earlier answers were not sent, or may not have been, for example the answers
      to its past after its process has rejoined.
    - `attend(waits)` is called after the pilot has processed its past. `waits()` returns whether the simulator still
      waits for the answer to the newest observation. It serves pilots that wait for another program themselves.
    """

    def act(self, observation: Any) -> Command | None:  # noqa: ANN401 - a UAV's or a UGV's observation
        """Return the command for this observation; None if the pilot has none in time."""


MakePilot = Callable[[Any], Pilot]
"""Function that creates a pilot from its briefing."""


def uav_maker(
    *,
    weighting: Weighting | None = None,
    path: Path | None = None,
    policy: "UavPolicy | None" = None,
    policy_name: str = "policy",
    inner: "Inner | None" = None,
) -> MakePilot:
    """Return a function that creates UAV pilots.

    Args:
        weighting: User's weighting for the law `weighted`.
        path: User's path for the law `path`.
        policy: User's policy for the laws `policy` and `certified`; each pilot gets a copy.
        policy_name: Name of the policy in errors.
        inner: User's control inside the safety filter.
    """
    from agents.uav import UavPilot  # noqa: PLC0415 - slow to import, and a UGV does not need it

    def make(briefing: UavBriefing) -> Pilot:
        if briefing.team is not None:
            exercise(briefing)
        own = copy.deepcopy(policy)  # a policy may keep state of its flight
        return UavPilot(
            briefing,
            weighting=weighting,
            path=path,
            policy=own,
            policy_name=policy_name,
            inner=inner,
        )

    return make


def ugv_maker(*, policy: Policy | None = None, policy_name: str = "policy") -> MakePilot:
    """Return a function that creates UGV pilots.

    Args:
        policy: User's policy for the driver `policy`.
        policy_name: Name of the policy in errors.
    """
    from agents.ugv import UgvPilot  # noqa: PLC0415 - a UAV does not need it

    return partial(UgvPilot, policy=policy, policy_name=policy_name)


_LOG = logging.getLogger("outrider.agents")
_BRIEFING_WARNING = 5
"""Time after which a vehicle warns that it still waits for a briefing, although a simulator is present [s]."""
_MISSING_CHECKS = 2
"""Consecutive checks, one second apart, that find no slot for the vehicle before it gives up.

A single check may meet a simulator that is shutting down.
"""


class _Connection:
    """Connection of one vehicle's process to the simulator.

    The simulator sends a new briefing whenever it has restarted or lost contact with this process. A briefing contains
    all of the vehicle's past, so it supersedes every earlier message.

    Args:
        session: Session of the vehicle.
        make_pilot: Creates the pilot from its briefing.
        limit: Longest absence of the simulator before giving up [s].
    """

    def __init__(self, session: Session, make_pilot: MakePilot, limit: float) -> None:
        party = session.party
        self._session, self._make_pilot, self._limit = session, make_pilot, limit
        self._briefings = session.inbox(BRIEFING[party.role], party.name)
        self._observations = session.inbox(
            OBSERVATION[party.role], party.name, newest=_QUEUE_LENGTH
        )
        self._flight: tuple[object, int] = (None, 0)  # session and episode of the last briefing
        self._first = 0  # first tick not yet received
        self._missing_checks = 0  # consecutive checks with a simulator but no slot
        self._simulator = Presence(session, SIMULATOR_NAME)
        session.announce()
        self.pilot = self._receive_briefing()

    def _check_simulator(self, what: str) -> None:
        """Raise an error if the simulator stays absent, or if its scenario has no such vehicle."""
        party = self._session.party
        missing = self._simulator.there and not self._session.is_offered()
        self._missing_checks = self._missing_checks + 1 if missing else 0
        if self._missing_checks >= _MISSING_CHECKS:
            raise ScenarioError(
                f"--name {party.name}: no such {party.role.upper()} in the scenario of the run "
                f"{self._session.run}; allowed: the name of one of its {party.role.upper()}s"
            )
        if self._simulator.absent_for() > self._limit:
            who = "simulator" if self._session.connected else "router"
            raise PeerLost(
                f"the {who} has been absent for {self._limit:g} s while {party.name} waited for {what}"
            )

    def _receive_briefing(self) -> Pilot:
        """Wait for a complete briefing and return a pilot in the state that it implies.

        The pilot processes all of its past, and its answers to it are not sent. An interrupted briefing starts over.
        """
        pilot: Pilot | None = None
        waited = 0
        while True:
            envelope = self._briefings.receive(1.0)
            if envelope is None:
                self._check_simulator("its briefing")
                waited = waited + 1 if self._simulator.there else 0
                if waited == _BRIEFING_WARNING:
                    _LOG.warning(
                        "no briefing in %d s%s",
                        _BRIEFING_WARNING,
                        f": another session of {self._session.party.name} joined first and keeps the slot"
                        if self._session.number
                        else "",
                    )
                continue
            briefing: Any = envelope.message
            begins = not briefing.past or briefing.past[0].tick == 0
            if begins:
                pilot, self._first = self._make_pilot(msgspec.structs.replace(briefing, past=())), 0
            if pilot is None:
                continue  # the start of this briefing went to another process
            for observation in briefing.past:
                pilot.act(observation)
                self._first = observation.tick + 1
            if not briefing.more:
                if self._first > 0:
                    _call_if_there(pilot, "forget_commands")
                _call_if_there(pilot, "attend", self._awaits)
                self._flight = (envelope.session, briefing.episode)
                return pilot

    def _awaits(self) -> bool:
        """Return whether the simulator is present and the newest observation is still unanswered."""
        newer = self._observations.holds_any() or self._briefings.holds_any()
        return not newer and self._simulator.there

    def receive(self) -> list[Any]:
        """Wait for observations and return all that have arrived, oldest first.

        Briefings are processed first; each replaces the pilot.

        Raises:
            PeerLost: If the simulator stays absent.
        """
        while True:
            envelope = self._observations.receive(1.0)
            while self._briefings.holds_any():
                self.pilot = self._receive_briefing()
            if envelope is None:
                self._check_simulator("an observation")
                continue
            observations = []
            while envelope is not None:
                if self._is_new(envelope):
                    observations.append(envelope.message)
                envelope = self._observations.next_waiting()
            return observations

    def _is_new(self, envelope: Envelope) -> bool:
        """Return whether an observation belongs to the current episode and has not been processed."""
        observation: Any = envelope.message
        if (envelope.session, observation.episode) != self._flight:
            return False
        if observation.over:
            return True  # an aborted episode ends at a tick that was already received
        if observation.tick < self._first:
            return False
        self._first = observation.tick + 1
        return True


def _call_if_there(pilot: Pilot, method: str, *arguments: Any) -> None:  # noqa: ANN401 - the method's
    """Call an optional method of a pilot, if it exists."""
    if hasattr(pilot, method):
        getattr(pilot, method)(*arguments)


def _answer(pilot: Pilot, observations: list[Any], commands: Outbox, name: str) -> bool:
    """Send the answer to the newest observation; only process the earlier ones.

    The pilot acts on a single missed observation without sending the answer, so its state stays the same: in lockstep,
    a process that rejoins may find the next tick already waiting. A pilot that missed more is slower than the clock
    and only perceives them.

    Returns:
        True if the pilot had an answer.

    Raises:
        BusError: If the pilot's command is invalid.
    """
    if len(observations) > 1:
        missed = observations[:-1]
        # A pilot with `attend` waits for another program, whose answer would come too late.
        act = len(missed) == 1 and not hasattr(pilot, "attend")
        take = pilot.act if act else getattr(pilot, "perceive", None)
        if take is not None:
            for observation in missed:
                take(observation)
        _call_if_there(pilot, "forget_commands")
    command = pilot.act(observations[-1])
    if command is None:
        return False
    try:
        commands.send(command)
    except ValueError as error:
        raise BusError(
            f"{name}: the pilot's command for tick {observations[-1].tick} cannot be sent: {error}"
        ) from error
    _call_if_there(pilot, "prepare")
    return True


def fly(
    party: Party,
    make_pilot: MakePilot,
    *,
    connect: str,
    run: str,
    credential: Credential | None = None,
    join_timeout: float = 30.0,
) -> int:
    """Join a run, fly the vehicle until the run ends, and leave.

    Args:
        party: Vehicle of this process.
        make_pilot: Creates the pilot from its briefing.
        connect: Endpoint of the router.
        run: Name of the run.
        credential: Credential of the vehicle; the router checks it.
        join_timeout: Longest wait for a missing router or simulator [s].

    Returns:
        The number of commands sent.

    Raises:
        PeerLost: If no simulator appears within `join_timeout`, or it is absent for longer.
        BusError: If the router cannot be reached, or the pilot's command is invalid.
        AccessDenied: If the router rejects the credential.
        ScenarioError: If the endpoint is invalid, the scenario has no such vehicle, or the pilot cannot fly the
            briefing.
    """
    warm_up(party.role)  # before joining: the simulator must not wait for the compiler
    with open_session(
        party, run, connect=connect, credential=credential, join_timeout=join_timeout
    ) as session:
        commands = session.outbox(COMMAND[party.role], party.name)
        connection = _Connection(session, make_pilot, join_timeout)
        sent = 0
        while True:
            observations = connection.receive()
            if not observations:
                continue
            if observations[-1].over:
                return sent
            sent += _answer(connection.pilot, observations, commands, party.name)
