"""The loop that puts any pilot on the bus: a process of its own, which knows only what it is told."""

import gc
import time
from collections.abc import Callable
from typing import Any, Protocol

import msgspec

from agents.control.orbit import Path
from agents.control.weighting import Weighting
from agents.uav import UavPilot
from agents.ugv import UgvPilot
from bus.errors import PeerLost
from bus.keys import BRIEFING, COMMAND, OBSERVATION, SIMULATOR_NAME, Party, Role
from bus.messages import Command, Message, UavBriefing, UavObservation, UgvBriefing, UgvObservation
from bus.session import Inbox, open_session
from sim.compile import compiling


class Pilot(Protocol):
    """A pilot as the loop sees it; the key table says which messages it gets."""

    def act(self, observation: Any) -> Command:  # noqa: ANN401 - a UAV's or a UGV's observation
        """The command for this observation."""

    def prepare(self) -> None:
        """Work ahead once the command is on its way."""


MakePilot = Callable[[Any], Pilot]
"""Makes a pilot from its briefing."""


def uav_maker(*, weighting: Weighting | None = None, path: Path | None = None) -> MakePilot:
    """Makes UAV pilots.

    Args:
        weighting: A weighting of one's own, for the law `weighted`.
        path: A path of one's own, for the law `path`.
    """

    def make(briefing: UavBriefing) -> Pilot:
        return UavPilot(briefing, weighting=weighting, path=path)

    return make


_SOMEBODY = {
    "vehicle": "nobody",
    "dt": 0.05,
    "area": {"width": 10.0, "height": 10.0, "cell": 0.5},
    "limits": {"max_speed": 0.6, "max_acceleration": 0.3},
    "key": 1,
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
_UGV = _SOMEBODY | {"driver": "waypoints", "goals": [[1.0, 1.0], [9.0, 9.0]], "goal_tolerance": 0.05}


def warm_up(role: Role) -> None:
    """Let a pilot that nobody waits for answer a few times, so that all its code is compiled or loaded."""
    uav, ugv = UavPilot(msgspec.convert(_UAV, UavBriefing)), UgvPilot(msgspec.convert(_UGV, UgvBriefing))
    for tick in range(3):
        seen = {"tick": tick, "time": tick * 0.05, "position": [5.0, 5.0], "velocity": [0.0, 0.0]}
        if role is Role.UAV:
            look = {"time": seen["time"], "relative_position": [1.0, 0.0]}
            uav.act(msgspec.convert(seen | {"detections": [look]}, UavObservation))
            uav.prepare()
        else:
            ugv.act(msgspec.convert(seen, UgvObservation))


class _Presence:
    """Whether the simulator is there, as the bus tells it."""

    def __init__(self) -> None:
        self.present = False
        self.since = time.monotonic()

    def change(self, _name: str, present: bool) -> None:
        self.present = present
        self.since = time.monotonic()

    def absent_for(self) -> float:
        return 0.0 if self.present else time.monotonic() - self.since


def _await(inbox: Inbox, presence: _Presence, limit: float, what: str) -> Message:
    while True:
        letter = inbox.receive(1.0)
        if letter is not None:
            return letter.message
        if presence.absent_for() > limit:
            raise PeerLost(f"the simulator has been away for {limit:g} s while {what} was awaited")


def fly(party: Party, make_pilot: MakePilot, *, connect: str, run: str, join_timeout: float = 30.0) -> int:
    """Join a run, fly the vehicle until the run is over, and leave.

    Args:
        party: Which vehicle this process is.
        make_pilot: Makes the pilot from its briefing.
        connect: Endpoint of the router.
        run: Name of the run.
        join_timeout: How long to wait for a simulator that is not there [s].

    Returns:
        How many commands were sent.

    Raises:
        PeerLost: If the simulator does not come, or goes away for longer than that.
        BusError: If the router cannot be reached.
        ScenarioError: If the briefing asks for what the pilot cannot fly.
    """
    with compiling():
        warm_up(party.role)  # before the token: nobody must wait for a compiler
    presence = _Presence()
    with open_session(party, run, connect=connect) as session:
        briefings = session.inbox(BRIEFING[party.role], party.name)
        observations = session.inbox(OBSERVATION[party.role], party.name)
        commands = session.outbox(COMMAND[party.role], party.name)
        session.watch(SIMULATOR_NAME, presence.change)
        session.announce()
        pilot = make_pilot(_await(briefings, presence, join_timeout, "the briefing"))
        gc.freeze()  # what is here stays: the collector need not look at it again
        sent = 0
        while True:
            observation = _await(observations, presence, join_timeout, "an observation")
            if getattr(observation, "over", False):
                return sent
            commands.send(pilot.act(observation))
            pilot.prepare()
            sent += 1
