"""The loop that puts any pilot on the bus: a process of its own, which knows only what it is told."""

import copy
import logging
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

import msgspec

from agents.control.orbit import Path
from agents.control.weighting import Weighting
from agents.drivers.policy import Policy
from bus.credentials import Credential
from bus.errors import BusError, PeerLost, ScenarioError
from bus.joining import open_session
from bus.keys import BRIEFING, COMMAND, OBSERVATION, SIMULATOR_NAME, Party, Role
from bus.messages.vehicle import Command, UavBriefing, UavObservation, UgvBriefing, UgvObservation
from bus.presence import Presence
from bus.registry import DEFAULT_DRIVER, TELEOP
from bus.session import Envelope, Outbox, Session

if TYPE_CHECKING:
    from agents.laws.policy import UavPolicy
    from agents.uav import Inner

_ROOM = 1024
"""Observations that wait for a pilot that is slower than the clock; the oldest make room."""


class Pilot(Protocol):
    """A pilot as the loop sees it; the key table says which messages it gets.

    It may have four methods more: `prepare()`, called once its command is on its way, to work ahead while nobody
    waits; `perceive(observation)`, called with what it was too slow to answer; `forget_commands()`, called when answers
    of its own were not sent, or may not have been: those that it gave to its past when its process has joined again;
    and `attend(waits)`, called once all of its past has been acted on, with a function that tells whether the answer to
    the newest observation is still awaited, for a pilot that must wait for somebody itself.
    """

    def act(self, observation: Any) -> Command | None:  # noqa: ANN401 - a UAV's or a UGV's observation
        """The command for this observation; None: there is none in time."""


MakePilot = Callable[[Any], Pilot]
"""Makes a pilot from its briefing."""


def uav_maker(
    *,
    weighting: Weighting | None = None,
    path: Path | None = None,
    policy: "UavPolicy | None" = None,
    policy_name: str = "policy",
    inner: "Inner | None" = None,
) -> MakePilot:
    """Makes UAV pilots.

    Args:
        weighting: A weighting of one's own, for the law `weighted`.
        path: A path of one's own, for the law `path`.
        policy: A policy of one's own, for the laws `policy` and `certified`; each pilot has a copy.
        policy_name: Of it, in errors.
        inner: A control of one's own inside the safety filter.
    """
    from agents.uav import UavPilot  # noqa: PLC0415 - with its filter, most of a start, which a UGV can do without

    def make(briefing: UavBriefing) -> Pilot:
        own = copy.deepcopy(policy)  # it remembers a flight
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
    """Makes UGV pilots.

    Args:
        policy: A policy of one's own, for the driver `policy`.
        policy_name: What it is called in errors.
    """
    from agents.ugv import UgvPilot  # noqa: PLC0415 - likewise

    return partial(UgvPilot, policy=policy, policy_name=policy_name)


_SOMEBODY = {
    "vehicle": "nobody",
    "dt": 0.05,
    "area": {"width": 10.0, "height": 10.0, "cell": 0.5},
    "limits": {"max_speed": 0.6, "max_acceleration": 0.3},
    "key": "1" * 32,
}
_UAV = _SOMEBODY | {
    "target_limits": {"max_speed": 0.2, "max_acceleration": 0.1},
    "visibility_radius": 4.75,
    "sensor": {},
    "desired_coverage": 2.0,
    "law": {},
    "detector": {"noise": 0.1, "period": 0.05},
    "estimator": {},
}
_WATCHED = {
    "law": {"name": "certified"},
    "safety": {"max_measurement_error": 0.3, "max_measurement_age": 1.0},
}
_UGV = _SOMEBODY | {
    "driver": "waypoints",
    "goals": [[1.0, 1.0], [9.0, 9.0]],
    "goal_tolerance": 0.05,
}

_SOMEONE = {"operator": "nobody"}
_WORDS: tuple[list[dict[str, Any]], ...] = (
    [],
    [_SOMEONE | {"velocity": [0.1, 0.0]}],
    [_SOMEONE | {"goal": [1.0, 1.0]}],
)


def _seen(tick: int) -> dict[str, Any]:
    return {"tick": tick, "time": tick * 0.05, "position": [5.0, 5.0], "velocity": [0.0, 0.0]}


def warm_up(role: Role, *, inner: "Inner | None" = None) -> None:
    """Let a pilot that nobody waits for answer a few times, so that all its code is compiled or loaded.

    Args:
        role: The kind of vehicle.
        inner: A UAV's control of one's own.
    """
    if role is Role.UGV:
        for driver in (DEFAULT_DRIVER, TELEOP):  # an operator may take the wheel of any
            ugv = ugv_maker()(msgspec.convert(_UGV | {"driver": driver}, UgvBriefing))
            for tick, words in enumerate(_WORDS):
                ugv.act(msgspec.convert(_seen(tick) | {"operator": words}, UgvObservation))
        return
    for own in ({}, _WATCHED):
        uav: Any = uav_maker(inner=inner)(msgspec.convert(_UAV | own, UavBriefing))
        for tick in range(3):
            look = {"time": tick * 0.05, "relative_position": [1.0, 0.0]}
            uav.act(msgspec.convert(_seen(tick) | {"detections": [look]}, UavObservation))


_LOG = logging.getLogger("outrider.agents")
_LONG = 5
"""Seconds with a simulator and without a briefing, after which a vehicle says that it waits."""
_LOOKS = 2
"""Looks for the vehicle's slot in a row, a second apart, after which there is none: one may meet a simulator that ends.
"""


class _Slot:
    """A vehicle's place in the run as its own process sees it: it waits for messages, but not for ever.

    A simulator that has lost sight of this process briefs it anew, and so does one that has been started anew. A
    briefing tells all of the vehicle's past, so whatever is older than it counts no more.

    Args:
        session: The vehicle's session.
        make_pilot: Makes the pilot from its briefing.
        limit: How long the simulator may be away [s].
    """

    def __init__(self, session: Session, make_pilot: MakePilot, limit: float) -> None:
        party = session.party
        self._session, self._make_pilot, self._limit = session, make_pilot, limit
        self._briefings = session.inbox(BRIEFING[party.role], party.name)
        self._observations = session.inbox(OBSERVATION[party.role], party.name, newest=_ROOM)
        self._flight: tuple[object, int] = (None, 0)  # who has briefed it for which flight
        self._first = 0  # the first tick of it that is still to be seen
        self._without_slot = 0  # looks in a row that found a simulator and no slot
        self._simulator = Presence(session, SIMULATOR_NAME)
        session.announce()
        self.pilot = self._take_over()

    def _check_simulator(self, what: str) -> None:
        """Give up waiting for a simulator that stays away, or whose scenario has no such vehicle."""
        party = self._session.party
        missing = self._simulator.there and not self._session.is_offered()
        self._without_slot = self._without_slot + 1 if missing else 0
        if self._without_slot >= _LOOKS:
            raise ScenarioError(
                f"--name {party.name}: the scenario of the run {self._session.run} has no {party.role.upper()} of "
                "this name; allowed: one that it has"
            )
        if self._simulator.absent_for() > self._limit:
            who = "simulator" if self._session.connected else "router"
            raise PeerLost(
                f"the {who} has been away for {self._limit:g} s while {party.name} awaited {what}"
            )

    def _take_over(self) -> Pilot:
        """Wait for a briefing: a pilot as it would be now if it had flown from the start.

        It acts on all of its past, and none of its answers is sent. A briefing that is interrupted begins anew.
        """
        pilot: Pilot | None = None
        waited = 0
        while True:
            envelope = self._briefings.receive(1.0)
            if envelope is None:
                self._check_simulator("its briefing")
                waited = waited + 1 if self._simulator.there else 0
                if waited == _LONG:
                    _LOG.warning(
                        "no briefing in %d s%s",
                        _LONG,
                        f": another session of {self._session.party.name} came first and keeps the slot"
                        if self._session.place
                        else "",
                    )
                continue
            told: Any = envelope.message
            begins = not told.past or told.past[0].tick == 0
            if begins:
                pilot, self._first = self._make_pilot(msgspec.structs.replace(told, past=())), 0
            if pilot is None:
                continue  # the rest of one whose beginning was for somebody else
            for seen in told.past:
                pilot.act(seen)
                self._first = seen.tick + 1
            if not told.more:
                if self._first > 0:
                    _call_if_there(pilot, "forget_commands")
                _call_if_there(pilot, "attend", self._awaits)
                self._flight = (envelope.session, told.episode)
                return pilot

    def _awaits(self) -> bool:
        """True while nothing newer has come than what the pilot answers, and the simulator is there."""
        newer = self._observations.holds_any() or self._briefings.holds_any()
        return not newer and self._simulator.there

    def look(self) -> list[Any]:
        """Wait for observations: those that have arrived since, the oldest first.

        A briefing makes a new pilot before them.

        Raises:
            PeerLost: If the simulator stays away.
        """
        while True:
            envelope = self._observations.receive(1.0)
            while self._briefings.holds_any():
                self.pilot = self._take_over()
            if envelope is None:
                self._check_simulator("an observation")
                continue
            seen = []
            while envelope is not None:
                if self._is_new(envelope):
                    seen.append(envelope.message)
                envelope = self._observations.next_waiting()
            return seen

    def _is_new(self, envelope: Envelope) -> bool:
        """True if an observation is of the flight it was briefed for and neither past nor seen before."""
        observation: Any = envelope.message
        if (envelope.session, observation.episode) != self._flight:
            return False
        if observation.over:
            return True  # a flight that is stopped ends at a tick that has been seen
        if observation.tick < self._first:
            return False
        self._first = observation.tick + 1
        return True


def _call_if_there(pilot: Pilot, method: str, *arguments: Any) -> None:  # noqa: ANN401 - the method's
    """Call one of the methods that a pilot may have, if it has it."""
    if hasattr(pilot, method):
        getattr(pilot, method)(*arguments)


def _answer(pilot: Pilot, seen: list[Any], commands: Outbox, name: str) -> bool:
    """Answer the newest observation; those that came before it are too late to be answered, but not to be seen.

    One that is missed is acted on without an answer, so that the pilot stays as it would be: in lockstep a process
    that joins again may find the next tick there already. A pilot that has missed more is slower than the clock, and
    only perceives them.

    Returns:
        Whether the pilot had an answer.

    Raises:
        BusError: If the pilot's command is nonsense.
    """
    if len(seen) > 1:
        missed = seen[:-1]
        # One that attends waits for somebody else, whose answer to it would come too late.
        act = len(missed) == 1 and not hasattr(pilot, "attend")
        take = pilot.act if act else getattr(pilot, "perceive", None)
        if take is not None:
            for observation in missed:
                take(observation)
        _call_if_there(pilot, "forget_commands")
    command = pilot.act(seen[-1])
    if command is None:
        return False
    try:
        commands.send(command)
    except ValueError as error:
        raise BusError(
            f"{name}: the pilot's answer to tick {seen[-1].tick} cannot be sent: {error}"
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
    """Join a run, fly the vehicle until the run is over, and leave.

    Args:
        party: Which vehicle this process is.
        make_pilot: Makes the pilot from its briefing.
        connect: Endpoint of the router.
        run: Name of the run.
        credential: By what the router knows the vehicle.
        join_timeout: How long to wait for a router or a simulator that is not there [s].

    Returns:
        How many commands were sent.

    Raises:
        PeerLost: If the simulator does not come, or goes away for longer than that.
        BusError: If the router cannot be reached, or the pilot's command is nonsense.
        AccessDenied: If the router does not know the credential.
        ScenarioError: If the endpoint is not one, the scenario has no such vehicle, or the briefing asks for what the
            pilot cannot fly.
    """
    warm_up(party.role)  # before the token: the simulator must not wait for a compiler
    with open_session(
        party, run, connect=connect, credential=credential, join_timeout=join_timeout
    ) as session:
        commands = session.outbox(COMMAND[party.role], party.name)
        slot = _Slot(session, make_pilot, join_timeout)
        sent = 0
        while True:
            seen = slot.look()
            if not seen:
                continue
            if seen[-1].over:
                return sent
            sent += _answer(slot.pilot, seen, commands, party.name)
