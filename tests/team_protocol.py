"""Random teams, links and deaths against the rules of a team, compiled, for the tests of the hand-over.

A safety filter is replaced by its theorem: it certifies after a time that the adversary chooses, and then at every tick
while its UAV guards or relieves and its process lives. The simulator is replaced by an array of stored numbers, and
endurance by an adversary that exhausts charges.
"""

import math
from enum import IntEnum
from typing import NamedTuple

import msgspec
import numpy as np

from agents.team.records import (
    AWAY,
    CALL,
    GUARD,
    RELIEF,
    RELIEVE,
    SCOUT,
    TeamMemory,
    team_memory,
    team_parameters,
)
from agents.team.roles import accept, ask, change_role, hear, receive_request
from agents.uav_inputs import TeamPacket
from bus.messages.team import MOST_UAVS, Endurance
from bus.ticks import NO_TICK
from flights import briefing_of
from sim.compiling.compile import FloatArray, IntArray, compiled
from sim.compiling.records import RecordArray, record_type
from sim.scenario.loading import load_scenario

TICKS, MOST, LATEST = 120, 4, 40
"""Ticks of a run; UAVs of the largest team; longest delay of a message [ticks]."""
_SLOTS, _WAITING = LATEST + 1, 2 * LATEST * MOST * (MOST - 1)
_ENDURANCE = 9.0  # s
_PATIENCE = 20  # ticks after which a guard resigns, by a wrong rule


class Protocol(IntEnum):
    """The product's protocol, and the same with one wrong rule."""

    PRODUCT = 0
    RELEASE_ON_OFFER = 1
    EQUAL_NUMBERS_RELEASE = 2
    NUMBER_LOST_WITH_PROCESS = 3
    ACCEPT_UNCERTIFIED = 4
    RESIGN_ON_TIMEOUT = 5
    COUNT_MESSAGES = 6


_ON_OFFER, _EQUAL, _VOLATILE, _UNCERTIFIED, _RESIGN, _COUNT = map(int, list(Protocol)[1:])


class Counts(NamedTuple):
    """Sums over several runs."""

    certified: int
    """Ticks with a certified guard."""
    broken: int
    """Ticks in which a UAV with one of the g largest numbers does not guard, or has lost its certificate."""
    dark: int
    """Ticks without a certified guard, after one with g of them and before g losses."""
    disordered: int
    """Acceptances with a number that is not above all that the UAV has heard, or not above its own."""
    handovers: int
    """Stored numbers, apart from the first g of each run."""
    losses: int
    """Deaths of processes, and exhausted charges."""
    caught: int
    """Runs with broken or dark ticks."""


class _Adversary(NamedTuple):
    """Choices of the adversary for one run; a float is a probability, for each tick, command or message."""

    protocol: int
    guards: int
    losses: int
    """Largest number of deaths and exhausted charges."""
    endures: bool
    """All charges are unlimited."""
    mortal: float
    wish: float
    """A scout returns, whatever it has heard."""
    settle: float
    """A filter begins to certify."""
    sees: float
    rests: float
    """A UAV is at rest at its base; fully charged with the same probability."""
    talks: float
    unstored: float
    """A command is lost, and with it number and message."""
    forgets: float
    """A process does not know whether its last commands were sent."""
    asks: float
    """A message asks its receiver for relief, whatever its sender says."""
    requests: float
    """An operator requests a UAV to come or to be relieved."""
    late: int
    """Largest delay of a command [ticks]."""
    delay: int
    """Largest delay of a message [ticks]."""
    twice: float


class _Uav:
    """What is true of a UAV, and what the simulator knows of it."""

    stored: int
    """Its stored number."""
    newest: int
    """Tick of the newest command that has arrived."""
    lag: int
    """Delay of its commands now [ticks]."""
    alive: bool
    exhausted: bool
    """Its charge does not last any longer, until it leaves."""
    excused: bool
    """It left exhausted, and has not been a certified guard since."""
    wished: bool
    certified: bool
    """Its filter certifies sight."""
    owed: bool
    """It was certified when it accepted or later; its process has lived and its charge lasted since."""
    largest: int
    """Largest number that its process has heard."""
    heard: int
    """Greater numbers heard since it accepted, for a wrong rule."""
    since: int
    """Tick in which it accepted, for a wrong rule."""


class _Team(NamedTuple):
    """A team and its links."""

    uavs: RecordArray
    """`_Uav`. Shape (UAVs,)."""
    parameters: RecordArray
    memory: TeamMemory
    """Memories of all UAVs; the rules do not use the maps. Shape of `mates`: (UAVs, UAVs)."""
    commands: IntArray
    """Number, certified, tick of the measurement, role, and UAV asked by each command. Shape (UAVs, ticks, 5)."""
    loss: FloatArray
    """Probability of loss, by receiver and sender. Shape (UAVs, UAVs)."""


class _Air(NamedTuple):
    """Messages in transit."""

    rows: IntArray
    """Receiver, sender, tick, number, certified, tick of the measurement, UAV asked, role.

    Shape (slots, messages, 8).
    """
    waiting: IntArray
    """Number of messages by slot: that of a tick of arrival, modulo the slots. Shape (slots,)."""
    message: RecordArray
    """Message that is received now. Shape (1,)."""


def _first_memory() -> tuple[RecordArray, TeamMemory]:
    """Return the constants of all UAVs of the largest team, and the memory of a new process."""
    mates = tuple(f"uav_{row}" for row in range(MOST))
    endurance = Endurance(endurance=_ENDURANCE, charge_time=1.0, base=(0.0, 0.0))
    one = msgspec.structs.replace(
        briefing_of(load_scenario("scouts")), mates=mates, endurance=endurance
    )
    each = [team_parameters(msgspec.structs.replace(one, vehicle=name)) for name in mates]
    memory = team_memory(one, np.zeros((1, 1)))
    assert memory is not None
    return np.concatenate([row for row in each if row is not None]), memory


_PARAMETERS, _NEW = _first_memory()
_OWN, _MATE = _NEW.own.dtype, _NEW.mates.dtype
_UAV, _MESSAGE = record_type(_Uav), record_type(TeamPacket)


@compiled
def _memory(team: _Team, i: int) -> TeamMemory:
    """Return the memory of one UAV."""
    m = team.memory
    own, mates = m.own[i : i + 1], m.mates[i]
    return TeamMemory(own, mates, m.track, m.heard, m.sent, m.sent_tick, m.repeats, m.coverage)


@compiled
def _start_process(team: _Team, new: TeamMemory, i: int) -> None:
    """Start a process of a UAV with a new memory."""
    uav = team.uavs[i]
    team.memory.own[i] = new.own[0]
    for k in range(team.uavs.shape[0]):
        team.memory.mates[i, k] = new.mates[k]
    uav.wished, uav.largest, uav.heard = False, 0, 0


@compiled
def _make_team(
    adversary: _Adversary, parameters: RecordArray, new: TeamMemory, rng: np.random.Generator
) -> _Team:
    guards = adversary.guards
    n, silence = rng.integers(max(2, guards), MOST + 1), rng.integers(1, 2 * LATEST)
    own, mates = np.zeros(n, _OWN), np.zeros((n, n), _MATE)
    maps = new.track, new.heard, new.sent, new.sent_tick, new.repeats, new.coverage
    memory = TeamMemory(own, mates, *maps)
    loss = 0.98 * rng.random((n, n)) ** (3.0 * rng.random())
    commands = np.zeros((n, TICKS, 5), np.int64)
    team = _Team(np.zeros(n, _UAV), parameters, memory, commands, loss)
    for i in range(n):
        _start_process(team, new, i)
        team.uavs[i].alive, team.uavs[i].newest = True, NO_TICK
        parameters[i].guards, parameters[i].silence_ticks = guards, silence
    return team


@compiled
def _lose_and_return(
    adversary: _Adversary,
    team: _Team,
    new: TeamMemory,
    lost: int,
    tick: int,
    rng: np.random.Generator,
) -> int:
    """Let processes die and rejoin, and charges be exhausted; return the number of losses so far."""
    for i in range(team.uavs.shape[0]):
        uav = team.uavs[i]
        if uav.alive and lost < adversary.losses and rng.random() < adversary.mortal:
            lost += 1
            if not adversary.endures and rng.random() < 0.5:
                uav.exhausted = True
                continue
            uav.alive = uav.certified = uav.owed = False
            if adversary.protocol == _VOLATILE:
                uav.stored = 0
        elif not uav.alive and rng.random() < 0.1:
            uav.alive, uav.newest = True, tick - 1
            _start_process(team, new, i)
    return lost


@compiled
def _receive(team: _Team, air: _Air, tick: int) -> None:
    slot = tick % _SLOTS
    for k in range(air.waiting[slot]):
        i, sender, sent, number, certified, measured, asks, role = air.rows[slot, k]
        uav, message = team.uavs[i], air.message[0]
        if uav.alive:
            message.sender, message.tick, message.number = sender, sent, number
            message.certified, message.measured, message.asks = certified != 0, measured, asks
            message.role, message.charge = role, 1.0
            hear(_memory(team, i), i, message)
            uav.largest = max(uav.largest, number)
            uav.heard += 1 if number > uav.stored else 0
    air.waiting[slot] = 0


@compiled
def _stops_wrongly(
    adversary: _Adversary, team: _Team, i: int, tick: int, rng: np.random.Generator
) -> bool:
    """Return whether a guard stops by the wrong rule."""
    uav, own, protocol, equal = team.uavs[i], team.memory.own[i], adversary.protocol, 0
    if own.role != GUARD or own.number != uav.stored:
        return False
    if protocol == _ON_OFFER:
        return rng.random() < adversary.wish
    if protocol == _RESIGN:
        return bool(own.certified and tick - uav.since > _PATIENCE and rng.random() < 0.05)
    if protocol == _COUNT:
        return bool(uav.heard >= adversary.guards)
    for k in range(team.uavs.shape[0]):
        number = team.memory.mates[i, k].number
        equal += 1 if number > 0 and number // MOST_UAVS >= own.number // MOST_UAVS else 0
    return protocol == _EQUAL and equal >= adversary.guards


@compiled
def _act(adversary: _Adversary, team: _Team, i: int, tick: int, rng: np.random.Generator) -> bool:
    """Change the role of a UAV, as its process does in a tick; return False if it accepts with a wrong number."""
    uav, own, memory, parameters = (
        team.uavs[i],
        team.memory.own[i],
        _memory(team, i),
        team.parameters[i],
    )
    if rng.random() < adversary.sees:
        own.own_tick = own.known_tick = tick
    own.unsent = rng.random() < adversary.forgets
    own.charge = own.spare = math.inf
    if not adversary.endures:
        own.home, own.spare = rng.random() < adversary.rests, -1.0 if uav.exhausted else 1.0
        own.charge = _ENDURANCE if rng.random() < adversary.rests else 1.0
    if adversary.protocol and _stops_wrongly(adversary, team, i, tick, rng):
        own.role = SCOUT
    request = 0
    if rng.random() < adversary.requests:
        request = CALL if rng.random() < 0.5 else RELIEVE
    receive_request(memory, request, tick)
    change_role(parameters, memory, uav.stored, tick)
    ask(parameters, memory)
    if own.role == AWAY and uav.exhausted:
        uav.exhausted, uav.excused, uav.owed = False, True, False
    uav.wished = uav.wished or rng.random() < adversary.wish
    if own.role == SCOUT and uav.wished:
        own.role = RELIEF
    filtered = own.role == RELIEF or own.role == GUARD
    uav.certified = filtered and (uav.certified or rng.random() < adversary.settle)
    role, number = own.role, own.number
    accept(parameters, memory, uav.certified or adversary.protocol == _UNCERTIFIED)
    own.certified = own.certified and uav.certified  # no UAV sends a false certificate
    accepts = own.role != role
    if accepts:
        uav.wished, uav.heard, uav.since = False, 0, tick
    command = team.commands[i, tick]
    command[0], command[1], command[2] = own.number, own.certified, own.own_tick
    command[3] = 0 if rng.random() < adversary.unstored else own.role
    command[4] = own.asks
    return not accepts or own.number > max(number, uav.largest)


@compiled
def _send(
    adversary: _Adversary, team: _Team, i: int, air: _Air, tick: int, rng: np.random.Generator
) -> bool:
    """Store the number of a command that arrives, then send its message; return True if the number is new."""
    uav = team.uavs[i]
    if rng.random() < 0.2:
        uav.lag = rng.integers(0, adversary.late + 1)
    answered = tick - uav.lag
    if answered <= uav.newest:
        return False
    uav.newest = answered
    number, certified, measured, role, asks = team.commands[i, answered]
    if role == 0:
        return False
    new = bool(number > uav.stored)
    if new and number % MOST_UAVS != MOST_UAVS - 1 - i:
        return False
    if new:
        uav.stored, uav.owed = number, not uav.excused
    if role != GUARD and rng.random() >= adversary.talks:
        return new
    for j in range(team.uavs.shape[0]):
        if j == i or rng.random() < team.loss[j, i]:
            continue
        for _ in range(2 if rng.random() < adversary.twice else 1):
            slot = (tick + rng.integers(1, adversary.delay + 1)) % _SLOTS
            row = air.rows[slot, air.waiting[slot]]
            row[0], row[1], row[2] = j, i, answered
            row[3], row[4], row[5] = number, certified, measured
            row[6], row[7] = j if rng.random() < adversary.asks else asks, role
            air.waiting[slot] += 1
    return new


@compiled
def _judge(guards: int, team: _Team) -> tuple[int, int, bool]:
    """Judge a tick.

    Returns:
        Number of certified guards, number of these whose number is stored, and True if lemma or theorem do not hold.
    """
    watching, settled, broken = 0, 0, False
    for i in range(team.uavs.shape[0]):
        uav, own, greater = team.uavs[i], team.memory.own[i], 0
        if not uav.alive or uav.stored == 0:
            continue
        # its process learns in the next tick of a late number; as a relief it passes the filter until then
        guarding = own.role == GUARD or (own.role == RELIEF and uav.stored > own.number)
        if guarding and uav.certified:
            uav.excused = False
            watching += 1
            settled += 1 if own.number == uav.stored else 0
            uav.owed = True
        for k in range(team.uavs.shape[0]):
            greater += 1 if team.uavs[k].stored > uav.stored else 0
        if greater < guards and not uav.excused:
            broken = broken or not guarding or (uav.owed and not uav.certified)
    return watching, settled, broken


@compiled
def _run(
    adversary: _Adversary,
    parameters: RecordArray,
    new: TeamMemory,
    air: _Air,
    sums: IntArray,
    rng: np.random.Generator,
) -> None:
    """Add the counts of one run."""
    guards, team = adversary.guards, _make_team(adversary, parameters, new, rng)
    air.waiting[:] = 0
    broken, dark, stored, lost, complete = 0, 0, 0, 0, False
    for tick in range(TICKS):
        lost = _lose_and_return(adversary, team, new, lost, tick, rng)
        _receive(team, air, tick)
        for i in range(team.uavs.shape[0]):
            if team.uavs[i].alive:
                sums[3] += 0 if _act(adversary, team, i, tick, rng) else 1
                stored += 1 if _send(adversary, team, i, air, tick, rng) else 0
        watching, settled, wrong = _judge(guards, team)
        complete = complete or settled >= guards
        sums[0] += 1 if watching > 0 else 0
        broken += 1 if wrong else 0
        dark += 1 if complete and watching == 0 and lost < guards else 0
    sums[1] += broken
    sums[2] += dark
    sums[4] += max(0, stored - guards)
    sums[5] += lost
    sums[6] += 1 if broken + dark > 0 else 0


@compiled
def _runs(
    total: int,
    rng: np.random.Generator,
    parameters: RecordArray,
    new: TeamMemory,
    protocol: int,
    guards: int,
    losses: int,
    late: int,
    forgets: bool,
) -> IntArray:
    rows, waiting = np.zeros((_SLOTS, _WAITING, 8), np.int64), np.zeros(_SLOTS, np.int64)
    air, sums = _Air(rows, waiting, np.zeros(1, _MESSAGE)), np.zeros(7, np.int64)
    for _ in range(total):
        adversary = _Adversary(
            protocol,
            guards,
            losses,
            rng.random() < 0.5,  # endures
            0.05 * rng.random(),  # mortal
            0.3 * rng.random() ** 2,  # wish
            0.02 + 0.3 * rng.random(),  # settle
            rng.random(),  # sees
            rng.random(),  # rests
            rng.random(),  # talks
            0.3 * max(0.0, 2.0 * rng.random() - 1.0),  # unstored
            0.3 * max(0.0, 2.0 * rng.random() - 1.0) if forgets else 0.0,
            0.2 * max(0.0, 2.0 * rng.random() - 1.0),  # asks
            0.2 * max(0.0, 2.0 * rng.random() - 1.0),  # requests
            late,
            int(rng.integers(1, LATEST + 1)),  # delay
            0.5 * rng.random(),  # twice
        )
        _run(adversary, parameters, new, air, sums, rng)
    return sums


def counts(
    total: int,
    *,
    guards: int,
    losses: int,
    protocol: Protocol = Protocol.PRODUCT,
    late: int = 0,
    forgets: bool = True,
    seed: int = 1,
) -> Counts:
    """Return the counts of random runs.

    Args:
        total: Number of runs.
        guards: Number of guards g.
        losses: Largest number of deaths and exhausted charges in a run.
        protocol: The protocol.
        late: Largest delay of a UAV's command to the simulator [ticks], as in real time.
        forgets: True if a process may not know at times whether its last commands were sent.
        seed: Seed of the adversary.
    """
    rng = np.random.default_rng(seed)
    given = int(protocol), guards, losses, late, forgets
    return Counts(*_runs(total, rng, _PARAMETERS.copy(), _NEW, *given).tolist())
