"""Table of metrics: label, unit, digits and meaning of each.

Summary, `--json`, console, sweep columns, the page's tiles and the reference are made from these rows. A metric is a
field of that name in `outrider.running.summary.Summary`, or in the message that its table names.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Literal

import msgspec

from bus.messages.links import LinkKind

Total = Literal["", "max", "min", "mean", "sum", "rms", "first", "all", "any"]
"""Rule that merges the values of several UAVs, UGVs or links; empty: a single value."""
Column = Literal["", "int64", "double", "bool", "string"]


class Metric(msgspec.Struct, frozen=True):
    """Metric of a table."""

    name: str
    label: str
    """Text for a table or a tile."""
    unit: str
    """SI unit; `%`: a share from 0 to 1, shown in per cent."""
    digits: int
    """Digits after the decimal point when shown."""
    meaning: str
    total: Total = ""
    goal: float | None = None
    """Desired value; None: no single value is desired."""
    guaranteed: bool = False
    """True if a value other than `goal` contradicts a guarantee; only such a value is shown."""
    column: Column = ""
    """Parquet type of its column in a sweep; empty: no column."""

    @property
    def heading(self) -> str:
        """Label with unit."""
        return f"{self.label} [{self.unit}]" if self.unit else self.label

    def number(self, value: float) -> str:
        """Return the value as shown, without unit."""
        return f"{100.0 * value if self.unit == '%' else value:,.{self.digits}f}"

    def text(self, value: object) -> str:
        """Return the value with unit; `-` for None."""
        if value is None:
            return "-"
        if isinstance(value, bool):
            return "yes" if value else "no"
        if isinstance(value, int | float):
            return f"{self.number(value)} {self.unit}".strip()
        return str(value)


def _table(*rows: Metric) -> dict[str, Metric]:
    return {row.name: row for row in rows}


# fmt: off
RUN = _table(
    Metric("ticks", "ticks", "", 0,
           "Simulated ticks.", column="int64"),
    Metric("ticks_per_second", "speed", "ticks/s", 0,
           "Ticks per second of wall time, from the first tick to the last."),
    Metric("realtime_factor", "real-time factor", "×", 2,
           "Simulated seconds per second of wall time."),
    Metric("late_ticks", "late ticks", "", 0,
           "Ticks that missed their wall-clock time; 0 in lockstep."),
    Metric("visibility_radius", "visibility radius r_v", "m", 2,
           "Distance from which on the UGV is out of sight, eq. (5); smaller at low altitudes.",
           column="double"),
    Metric("min_separation", "smallest separation", "m", 3,
           "Smallest distance between two UAVs; none with fewer than two.", column="double"),
    Metric("complete", "complete", "", 0,
           "The run reached the end of its scenario."),
    Metric("deterministic", "deterministic", "", 0,
           "Every command arrived in time and no operator changed the run: scenario, seed "
           "and secret determine the hash."),
    Metric("trajectory_sha256", "trajectory_sha256", "", 0,
           "SHA-256 of the states and applied commands of all vehicles at all ticks.",
           column="string"),
)
"""Metrics of a run."""

UAV = _table(
    Metric("max_distance", "largest distance", "m", 3,
           "Largest distance between the UAV and its UGV.", total="max", column="double"),
    Metric("mean_distance", "mean distance", "m", 3,
           "Mean distance between the UAV and its UGV.", total="mean", column="double"),
    Metric("min_margin", "smallest margin", "m", 3,
           "Smallest distance by which the UGV could still recede in sight; 0 behind a "
           "building, and not positive exactly if sight was lost.", total="min"),
    Metric("visibility_violations", "out of sight", "ticks", 0,
           "Ticks at a distance of r_v or more, eq. (5), at the UAV's altitude, or behind a "
           "building. Of a team: ticks in which none of its UAVs saw the UGV.",
           total="sum", goal=0.0, column="int64"),
    Metric("switching_radius", "switching radius r_s", "m", 3,
           "Distance beyond which the switching law only tracks, eq. (18); none if it is "
           "not finite.", total="first"),
    Metric("crossings", "crossings of r_s", "", 0,
           "Ticks at which the distance rose from below r_s to r_s or more.", total="sum"),
    Metric("initial_error", "initial coverage error", "m²", 1,
           "Coverage error e(t) at the start, eq. (4).", total="mean", column="double"),
    Metric("mean_error", "mean coverage error", "m²", 1,
           "Mean coverage error e(t), eq. (4).", total="mean", column="double"),
    Metric("final_error", "final coverage error", "m²", 1,
           "Coverage error e(t) at the end, eq. (4).", total="mean", column="double"),
    Metric("detections", "detections", "", 0,
           "Detections of the UGV by the UAV's detector.", total="sum"),
    Metric("estimate_rmse", "RMS error of the estimate", "m", 3,
           "Root mean square distance between the estimated and the true position of the UGV.",
           total="rms", column="double"),
    Metric("detection_rmse", "RMS error of the detections", "m", 3,
           "Root mean square error of the detections.", total="rms"),
)
"""Metrics of each UAV; the run's summary merges them by `total`."""

CERTIFICATE = _table(
    Metric("certified_share", "visibility certified", "%", 2,
           "Share of the monitored ticks that were certified; none for a law without "
           "safety filter.", goal=1.0, column="double"),
    Metric("overridden_share", "filter overrides", "%", 1,
           "Share of the monitored ticks at which the safety filter overrode the law.",
           column="double"),
    Metric("certified_while_lost", "certified while lost", "ticks", 0,
           "Certified ticks at which the UGV was out of sight.",
           goal=0.0, guaranteed=True, column="int64"),
    Metric("lost_without_clearance", "out of sight, explained by the driver", "ticks", 0,
           "Ticks that a UAV certified with the UGV out of sight, while the UGV kept no distance "
           "from buildings; none unless a certificate was revoked for this reason.",
           column="int64"),
    Metric("certificate_broken", "certificate broken", "ticks", 0,
           "Uncertified ticks after a certified one, although all assumptions held.",
           goal=0.0, guaranteed=True, column="int64"),
    Metric("longest_command_interval", "longest command interval", "s", 2,
           "Longest time from the start of one backup trajectory to the start of the next."),
    Metric("max_command_interval", "declared command interval", "s", 2,
           "Declared bound of `longest_command_interval`; none if commands carry no backup "
           "trajectories."),
    Metric("largest_tracking_error", "largest tracking error", "m", 3,
           "Largest distance between reference and true position of a UAV; none "
           "without disturbance."),
    Metric("max_tracking_error", "declared tracking error", "m", 3,
           "Declared bound of `largest_tracking_error`."),
    Metric("tracking_exceeded", "tracking error beyond its bound", "ticks", 0,
           "Ticks in which a UAV was farther from its reference than `max_tracking_error`; none "
           "without disturbance.", goal=0.0),
)
"""Metrics of the safety filters of all UAVs."""

TEAM = _table(
    Metric("team_certified_share", "a guard certified", "%", 2,
           "Share of the ticks in which at least one guard of a team was certified.",
           goal=1.0, column="double"),
    Metric("team_out_of_sight", "out of the team's sight", "ticks", 0,
           "Ticks in which no UAV of a team saw its UGV.", goal=0.0, column="int64"),
    Metric("team_certified_while_lost", "team certified while lost", "ticks", 0,
           "Ticks with a certified guard in which no UAV of the team saw the UGV.",
           goal=0.0, guaranteed=True, column="int64"),
    Metric("team_certificate_broken", "team certificate broken", "ticks", 0,
           "Ticks in which a UAV with one of the largest stored numbers did not guard.",
           goal=0.0, guaranteed=True, column="int64"),
    Metric("handovers", "hand-overs", "", 0,
           "Changes of the UAV with the largest number.", column="int64"),
    Metric("extra_guard_share", "more guards than wanted", "%", 1,
           "Share of the ticks with more than `guards` guards, as during a hand-over.",
           column="double"),
    Metric("left_without_relief", "left without relief", "", 0,
           "Times that a guard left for its base before another UAV had taken over.",
           goal=0.0, column="int64"),
    Metric("separation_violations", "UAVs too near", "ticks", 0,
           "Ticks in which two UAVs with an altitude, of any team, were nearer than `team.separation`.",
           goal=0.0, guaranteed=True, column="int64"),
    Metric("refused_messages", "refused messages", "", 0,
           "Messages to a team that the simulator did not send: their receivers rely on what it checks.",
           goal=0.0, column="int64"),
    Metric("team_traffic", "messages to the team", "B/s", 0,
           "Mean size of the messages that each UAV sends to its team.", column="double"),
)
"""Metrics of all teams, as in the message `TeamStatus`."""

MISSION = _table(
    Metric("arrived", "at the goals", "", 0,
           "Every UGV with goals has reached all of them.", total="all", goal=1.0, column="bool"),
    Metric("mission_time", "mission time", "s", 1,
           "Time at which the last UGV reached its last goal; none if one did not.",
           total="max", column="double"),
    Metric("hazards_hit", "hazards hit", "", 0,
           "Blocking hazards touched, counted once per UGV.",
           total="sum", goal=0.0, column="int64"),
    Metric("near_misses", "near misses", "", 0,
           "Blocking hazards passed within 0.2 m without contact.",
           total="sum", column="int64"),
    Metric("hazards_on_path", "hazards on the path", "", 0,
           "Hazards that a UGV passed within 2 m.", total="sum", column="int64"),
    Metric("warned", "hazards known in time", "", 0,
           "Hazards on the path that the UGV knew before it came within 2 m.",
           total="sum", column="int64"),
    Metric("mean_warning_time", "mean warning time", "s", 1,
           "Mean time from learning of such a hazard to coming within 2 m of it.",
           total="mean", column="double"),
    Metric("reported_share", "path reported ahead", "%", 0,
           "Share of the path on tiles reported by radio before the UGV entered them.",
           total="mean", column="double"),
    Metric("ground_certified_share", "known ground certified", "%", 1,
           "Share of the ticks at which cautious UGVs were certified to stay on known "
           "tiles.", total="mean", column="double"),
    Metric("entered_unknown_tile", "unknown tiles entered", "ticks", 0,
           "Ticks on a tile that the UGV did not know to be drivable.",
           total="sum", column="int64"),
    Metric("ground_certificate_broken", "ground certificate broken", "ticks", 0,
           "Certified ticks after which a cautious UGV lost the certificate or left known "
           "tiles, although all assumptions held.",
           total="sum", goal=0.0, guaranteed=True, column="int64"),
    Metric("near_building", "too near to a building", "ticks", 0,
           "Ticks in which a UGV came nearer to a building than its `building_clearance`, "
           "between ticks too; none if no UGV declares one.", total="sum", goal=0.0, column="int64"),
    Metric("near_building_excused", "of these, explained by the driver", "ticks", 0,
           "Ticks of `near_building` under a driver that guarantees no distance, such as an operator.",
           total="sum", column="int64"),
    Metric("stationary_time", "standstill", "s", 1,
           "Time for which UGVs stood still before arrival.",
           total="sum", column="double"),
    Metric("finds", "objects to find", "", 0,
           "Number of objects to find.", column="int64"),
    Metric("found", "objects found", "", 0,
           "Objects detected by a vehicle's sensor.", total="sum", column="int64"),
)
"""Metrics of all UGVs in a scenario with hazards, as in the message `MissionResult`."""

LINK = _table(
    Metric("delivery_ratio", "delivered", "%", 1,
           "Share of messages delivered, among those delivered or lost.",
           total="mean", column="double"),
    Metric("age", "age", "s", 2,
           "Age of the newest information delivered."),
    Metric("mean_age", "mean age", "s", 2,
           "Mean age of information since the first message.", total="mean", column="double"),
    Metric("max_age", "largest age", "s", 2,
           "Largest age of information since the first message.", total="max", column="double"),
    Metric("sent", "sent", "", 0,
           "Messages sent.", total="sum"),
    Metric("delivered", "delivered", "", 0,
           "Messages delivered, duplicates included."),
    Metric("duplicated", "duplicated", "", 0,
           "Duplicates made by the link."),
    Metric("queued", "queued", "", 0,
           "Messages waiting at the sender."),
    Metric("in_transit", "in transit", "", 0,
           "Messages on the link."),
    Metric("lost", "lost", "", 0,
           "Messages lost, by cause."),
)
"""Metrics of each link, as in the message `LinkStatus`."""

PROCESS = _table(
    Metric("missing_commands", "no new command", "", 0,
           "Ticks without a new command."),
    Metric("stale_commands", "late command used", "", 0,
           "Commands applied after the tick that they answer."),
    Metric("shortened_commands", "command beyond its bound", "", 0,
           "Accelerations with a component beyond the vehicle's bound, which are shortened."),
    Metric("unreported_ticks", "no state of its robot", "ticks", 0,
           "Ticks without a valid state of the UAV's robot, with the body `reported`."),
    Metric("lost", "lost", "", 0,
           "Disconnections of the process."),
    Metric("rejoined", "joined again", "", 0,
           "Reconnections of the process."),
    Metric("rejected", "rejected", "", 0,
           "Messages and sessions rejected, by cause."),
)
"""Metrics of each vehicle's process, as in the message `VehicleStatus`."""

NOW = _table(
    Metric("time", "time", "s", 1,
           "Simulated time."),
    Metric("distance", "distance", "m", 2,
           "Distance between the UAV and its UGV.", total="max"),
    Metric("margin", "margin to r_v", "m", 2,
           "Distance by which the UGV may still recede in sight, at the UAV's altitude: at 0 or "
           "below it is out of sight; 0 if the UGV is hidden.", total="min"),
    Metric("coverage_error", "coverage error e(t)", "m²", 1,
           "Coverage missing on the ground around the UGV, eq. (4).", total="max"),
    Metric("estimate_error", "estimate error", "m", 3,
           "Distance between the estimated and the true position of the UGV.", total="max"),
    RUN["realtime_factor"],
)
"""Current metrics, which the page shows during a run."""

SWEEP = _table(
    Metric("margin", "margin", "m", 3,
           "`min_margin` of the run; sight was lost if it is not positive.", column="double"),
    Metric("violated", "out of sight", "", 0,
           "The UGV was out of sight at some tick.", column="bool"),
    Metric("seconds", "wall time", "s", 0,
           "Wall time of the run.", column="double"),
    Metric("error", "error", "", 0,
           "Error message of a failed run.", column="string"),
)
"""Additional columns of a sweep."""
# fmt: on

LINK_COLUMNS = (LinkKind.DETECTIONS, LinkKind.COMMANDS)
"""Link kinds whose metrics are columns of a sweep, such as `detections_mean_age`."""

TABLES = {
    "Run": RUN,
    "UAV": UAV,
    "Safety filter": CERTIFICATE,
    "Team": TEAM,
    "Mission": MISSION,
    "Link": LINK,
    "Process": PROCESS,
    "Now": NOW,
    "Sweep": SWEEP,
}
"""All tables by the heading of their section in the reference."""

SUMMARY = RUN | UAV | CERTIFICATE | TEAM | MISSION
"""Metrics of a run's summary; metrics of teams and missions are fields of `Summary.team` and `Summary.mission`."""


def columns() -> dict[str, Column]:
    """Return the columns of a sweep's table with their Parquet types."""
    found: dict[str, Column] = {row.name: row.column for row in SUMMARY.values() if row.column}
    for kind in LINK_COLUMNS:
        found |= {f"{kind}_{row.name}": row.column for row in LINK.values() if row.column}
    found |= {row.name: row.column for row in SWEEP.values()}
    return found


def numbers(table: dict[str, Metric], struct: msgspec.Struct) -> dict[str, float]:
    """Return a table's metrics by name, read from a struct; NaN for None."""
    values = {name: getattr(struct, name) for name in table}
    return {name: math.nan if value is None else value for name, value in values.items()}


def total(metric: Metric, values: Iterable[float | None]) -> float | None:
    """Merge the values that are not None by the metric's rule; None without any."""
    known: Sequence[float] = [value for value in values if value is not None]
    if not known:
        return None
    match metric.total:
        case "max":
            return max(known)
        case "min":
            return min(known)
        case "mean":
            return sum(known) / len(known)
        case "sum":
            return sum(known)
    raise ValueError(f"{metric.name}: no rule merges several values; allowed: max, min, mean, sum")
