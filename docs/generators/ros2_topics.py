"""The topics that a run has in ROS 2, from the table of them."""

from structs import cell

from outrider_ros2.topics import PILOT_COMMANDS, PILOT_TOPICS, TOPICS, Each, TopicRow

_BEFORE = {Each.RUN: "", Each.VEHICLE: "<vehicle>/", Each.UAV: "<uav>/", Each.UGV: "<ugv>/"}


def _table(rows: tuple[TopicRow, ...]) -> str:
    lines = ["| topic | type | quality of service | |", "|---|---|---|---|"]
    lines += [
        f"| `/{_BEFORE[row.each]}{row.name}` | `{row.interface}` | {row.qos.in_words()} | {cell(row.about)} |"
        for row in rows
    ]
    return "\n".join(lines)


def observed() -> str:
    """Table of the topics of observers."""
    return _table(TOPICS)


def own() -> str:
    """Table of the topics of a vehicle's own node, and of its answers."""
    return _table((*PILOT_TOPICS, *PILOT_COMMANDS))
