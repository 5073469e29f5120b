"""Messages of a UAV to its team-mates: written by compiled code, and converted to and from the bus."""

from collections.abc import Sequence

import numpy as np

from agents.team.coverage import choose_blocks
from agents.team.records import TeamMemory, TeamParameters
from agents.uav_inputs import TeamInputs, TeamPacket
from bus.messages.base import or_infinite, or_none
from bus.messages.scenario import Area
from bus.messages.team import BLOCK_CELLS, CoverageBlock, Role, TeamMessage
from bus.messages.vehicle import UavBriefing, UavObservation
from bus.ticks import NO_TICK
from sim.compiling.compile import FloatArray, compiled
from sim.compiling.records import RecordArray, choice, code, record_type
from sim.models.vehicles import State


@compiled
def is_due(parameters: TeamParameters, tick: int) -> bool:
    """Return whether a UAV sends a message in this tick; its team-mates send theirs in other ticks."""
    return parameters.mates > 1 and (tick + parameters.row) % parameters.period == 0


@compiled
def write_message(
    parameters: TeamParameters,
    memory: TeamMemory,
    coverage: FloatArray,
    desired: float,
    state: State,
    tick: int,
    message: TeamPacket,
) -> None:
    """Write the message of a tick, and record its coverage blocks as sent.

    Args:
        parameters: Constants of the UAV.
        memory: Memory of the UAV, changed in place.
        coverage: Its own map. Shape (rows, columns).
        desired: Desired coverage C*.
        state: Its state.
        tick: Current tick.
        message: Written.
    """
    own = memory.own[0]
    message.sender, message.tick = parameters.row, tick
    message.number, message.role, message.certified = own.number, own.role, own.certified
    message.charge, message.asks = own.charge, own.asks
    message.x, message.y = state.p_x, state.p_y
    message.measured, message.g_x, message.g_y = own.own_tick, own.own_x, own.own_y
    choose_blocks(memory, coverage, desired, tick, message.blocks)
    _copy_blocks(memory, message)


@compiled
def _copy_blocks(memory: TeamMemory, message: TeamPacket) -> None:
    """Copy the cells of a message's blocks, as sent; cells beyond the map are 0."""
    (rows, columns), across = memory.sent.shape, memory.sent_tick.shape[1]
    message.cells[:] = 0
    for n in range(message.blocks.shape[0]):
        block = message.blocks[n]
        if block < 0:
            continue
        row, column = block // across * BLOCK_CELLS, block % across * BLOCK_CELLS
        for k in range(BLOCK_CELLS * BLOCK_CELLS):
            r, c = row + k // BLOCK_CELLS, column + k % BLOCK_CELLS
            if r < rows and c < columns:
                message.cells[n, k] = memory.sent[r, c]


def _blocks_across(area: Area) -> int:
    """Return the number of coverage blocks in a row."""
    return -(-round(area.width / area.cell) // BLOCK_CELLS)


def to_bus(packet: RecordArray, mates: Sequence[str], area: Area) -> TeamMessage:
    """Return a written message for the bus.

    Args:
        packet: `TeamPacket`. Shape (1,).
        mates: Names of the UAVs of the team, in the order of their rows.
        area: Area Q.
    """
    one, across = packet[0], _blocks_across(area)
    measured, asks = int(one["measured"]), int(one["asks"])
    blocks = [
        CoverageBlock(int(block) % across, int(block) // across, cells.tobytes())
        for block, cells in zip(one["blocks"], one["cells"], strict=True)
        if block >= 0
    ]
    return TeamMessage(
        sender=mates[int(one["sender"])],
        tick=int(one["tick"]),
        number=int(one["number"]),
        role=choice(Role, int(one["role"])) or Role.RELIEF,
        certified=bool(one["certified"]),
        position=(float(one["x"]), float(one["y"])),
        measured=None if measured == NO_TICK else measured,
        measurement=(float(one["g_x"]), float(one["g_y"])),
        charge=or_none(float(one["charge"])),
        asks=None if asks < 0 else mates[asks],
        blocks=tuple(blocks),
    )


def team_inputs(
    briefing: UavBriefing, observation: UavObservation, request: int = 0
) -> TeamInputs | None:
    """Convert the number and the team-mates' messages of a tick; None: the UAV has no team.

    Args:
        briefing, observation: Messages of the UAV.
        request: Request of the UAV's own policy, which an operator's replaces, see `TeamInputs`.
    """
    if briefing.team is None:
        return None
    messages, mates, across = observation.team, briefing.mates, _blocks_across(briefing.area)
    rows = np.zeros(len(messages), record_type(TeamPacket))
    for row, message in zip(rows, messages, strict=True):
        row["sender"], row["tick"] = mates.index(message.sender), message.tick
        row["number"], row["certified"] = message.number, message.certified
        row["role"], row["charge"] = code(message.role), or_infinite(message.charge)
        row["asks"] = -1 if message.asks is None else mates.index(message.asks)
        row["x"], row["y"] = message.position
        row["measured"] = NO_TICK if message.measured is None else message.measured
        row["g_x"], row["g_y"] = message.measurement
        row["blocks"] = -1
        for k, block in enumerate(message.blocks):
            row["blocks"][k] = block.row * across + block.column
            row["cells"][k] = np.frombuffer(block.cells, np.uint8)
    return TeamInputs(
        number=observation.number,
        charge=or_infinite(observation.charge),
        messages=rows,
        request=code(observation.request) if observation.request else request,
    )
