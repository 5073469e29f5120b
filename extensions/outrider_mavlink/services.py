"""Negative replies for MAVLink's mission, log and file services, which a run does not offer."""

from collections.abc import Callable, Mapping

from outrider_mavlink.dialect import MavMessage, mavlink
from outrider_mavlink.udp import Peer

_ACK, _NAK, _UNKNOWN_COMMAND = 128, 129, 7
_FILE_BYTES = 251


def _no_mission(peer: Peer, message: MavMessage) -> MavMessage:
    plan = getattr(message, "mission_type", 0)
    unsupported = mavlink.MAV_MISSION_UNSUPPORTED
    return mavlink.MAVLink_mission_ack_message(peer.system, peer.component, unsupported, plan)


def _no_items(peer: Peer, message: MavMessage) -> MavMessage:
    return mavlink.MAVLink_mission_count_message(
        peer.system, peer.component, 0, message.mission_type
    )


def _no_logs(_peer: Peer, _message: MavMessage) -> MavMessage:
    return mavlink.MAVLink_log_entry_message(0, 0, 0, 0, 0)


def _no_log_data(_peer: Peer, message: MavMessage) -> MavMessage:
    return mavlink.MAVLink_log_data_message(message.id, message.ofs, 0, [0] * 90)


def _no_erasure(_peer: Peer, _message: MavMessage) -> MavMessage:
    """Return a status text, since the protocol has no negative reply."""
    return mavlink.MAVLink_statustext_message(
        mavlink.MAV_SEVERITY_WARNING, b"rejected: there are no logs to erase"
    )


def _no_files(peer: Peer, message: MavMessage) -> MavMessage | None:
    """Return the NAK of the file transfer protocol: sequence number, session, opcode, size, request, error."""
    asked = bytes(message.payload)
    if asked[3] in (_ACK, _NAK):
        return None  # it is a reply itself
    number = (int.from_bytes(asked[:2], "little") + 1) % (1 << 16)
    head = number.to_bytes(2, "little") + bytes((asked[2], _NAK, 1, asked[3], 0, 0)) + asked[8:12]
    payload = head + bytes((_UNKNOWN_COMMAND,))
    return mavlink.MAVLink_file_transfer_protocol_message(
        0, peer.system, peer.component, list(payload.ljust(_FILE_BYTES, b"\0"))
    )


Answer = Callable[[Peer, MavMessage], MavMessage | None]
NEGATIVE_REPLIES: Mapping[str, Answer] = {
    "MISSION_REQUEST_LIST": _no_items,
    "MISSION_REQUEST": _no_mission,
    "MISSION_REQUEST_INT": _no_mission,
    "MISSION_REQUEST_PARTIAL_LIST": _no_mission,
    "MISSION_WRITE_PARTIAL_LIST": _no_mission,
    "MISSION_COUNT": _no_mission,
    "MISSION_ITEM": _no_mission,
    "MISSION_ITEM_INT": _no_mission,
    "MISSION_SET_CURRENT": _no_mission,
    "MISSION_CLEAR_ALL": _no_mission,
    "LOG_REQUEST_LIST": _no_logs,
    "LOG_REQUEST_DATA": _no_log_data,
    "LOG_ERASE": _no_erasure,
    "LOG_REQUEST_END": lambda _peer, _message: None,
    "FILE_TRANSFER_PROTOCOL": _no_files,
}
"""Function for the reply to each request, by name; it returns None if the protocol has no reply."""
