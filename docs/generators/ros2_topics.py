"""Tables of the ROS 2 topics of a run."""

from structs import cell

from outrider_ros2.topics import PILOT_COMMANDS, PILOT_TOPICS, TOPICS, Each, TopicRow

_BEFORE = {
    Each.RUN: "",
    Each.VEHICLE: "<vehicle>/",
    Each.UAV: "<uav>/",
    Each.UGV: "<ugv>/",
    Each.TEAM_UAV: "<uav>/",
}


def _table(rows: tuple[TopicRow, ...]) -> str:
    lines = ["| topic | type | quality of service | description |", "|---|---|---|---|"]
    lines += [
        f"| `/{_BEFORE[row.each]}{row.name}` | `{row.interface}` | {row.qos.in_words()} | {cell(row.about)} |"
        for row in rows
    ]
    return "\n".join(lines)


def observed() -> str:
    """Return the table of the observers' topics."""
    return _table(TOPICS)


def own() -> str:
    """Return the table of the topics of a vehicle's own node."""
    return _table((*PILOT_TOPICS, *PILOT_COMMANDS))
