"""The table of metrics: label, unit, digits and meaning of every number by which a run is judged.

Summary, `--json`, console, sweep columns, the page's tiles and the reference are made from these rows. A metric is a
field of that name in `outrider.running.summary.Summary`, or in the message that its table names.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Literal

import msgspec

from bus.messages.links import LinkKind

Total = Literal["", "max", "min", "mean", "sum", "rms", "first", "all", "any"]
"""Rule that merges the numbers of several UAVs, UGVs or links; empty: a single number."""
Column = Literal["", "int64", "double", "bool", "string"]


class Metric(msgspec.Struct, frozen=True):
    """One metric."""

    name: str
    label: str
    """Words for a table or a tile."""
    unit: str
    """SI; `%`: a share, shown in per cent."""
    digits: int
    """Digits after the point where it is shown."""
    meaning: str
    total: Total = ""
    goal: float | None = None
    """The value that is as it should be; None: there is none."""
    guaranteed: bool = False
    """True: any other value than `goal` contradicts what is guaranteed, and is shown for that alone."""
    column: Column = ""
    """Parquet type of its column in a sweep; empty: it has none."""

    @property
    def heading(self) -> str:
        """The label with its unit."""
        return f"{self.label} [{self.unit}]" if self.unit else self.label

    def number(self, value: float) -> str:
        """Return the value as it is shown, without its unit."""
        return f"{100.0 * value if self.unit == '%' else value:,.{self.digits}f}"

    def text(self, value: object) -> str:
        """Return a value with its unit; `-` where there is none."""
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
           "Ticks that missed the wall clock; 0 in lockstep."),
    Metric("visibility_radius", "visibility radius r_v", "m", 2,
           "The UGV is out of sight at this distance or beyond, eq. (5).", column="double"),
    Metric("complete", "complete", "", 0,
           "The run reached the end of its scenario."),
    Metric("deterministic", "deterministic", "", 0,
           "Every command came in time, and no operator changed the run: scenario, seed "
           "and secret give the hash."),
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
    Metric("visibility_violations", "out of sight", "ticks", 0,
           "Ticks with a distance of r_v or more, eq. (5).",
           total="sum", goal=0.0, column="int64"),
    Metric("switching_radius", "switching radius r_s", "m", 3,
           "Distance beyond which the switching law only tracks, eq. (18); none where it "
           "has no finite value.", total="first"),
    Metric("crossings", "crossings of r_s", "", 0,
           "Ticks at which the distance rose to r_s or beyond.", total="sum"),
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
"""Metrics of each UAV; in the summary of all of them, each number made by `total`."""

CERTIFICATE = _table(
    Metric("certified_share", "visibility certified", "%", 2,
           "Share of the monitored ticks that were certified; none for a law without a "
           "safety filter.", goal=1.0, column="double"),
    Metric("overridden_share", "filter intervened", "%", 1,
           "Share of the monitored ticks at which the safety filter overrode the law.",
           column="double"),
    Metric("certified_while_lost", "certified while lost", "ticks", 0,
           "Ticks that were certified although the UGV was out of sight.",
           goal=0.0, guaranteed=True, column="int64"),
    Metric("certificate_broken", "certificate broken", "ticks", 0,
           "Ticks that were not certified although the tick before was and all assumptions held.",
           goal=0.0, guaranteed=True, column="int64"),
    Metric("longest_command_interval", "longest command gap", "s", 2,
           "Longest time from the start of one backup plan to the start of the next; "
           "declared: `max_command_interval`."),
    Metric("max_command_interval", "declared command gap", "s", 2,
           "Declared bound of `longest_command_interval`; none where commands carry no plans."),
    Metric("largest_tracking_error", "largest tracking error", "m", 3,
           "Largest distance between the reference and the true position of a UAV; none "
           "without a disturbance."),
    Metric("max_tracking_error", "declared tracking error", "m", 3,
           "Declared bound of `largest_tracking_error`."),
)
"""Metrics of the UAVs' safety filters, over all UAVs."""

MISSION = _table(
    Metric("arrived", "at the goals", "", 0,
           "Every UGV with goals has reached all of them.", total="all", goal=1.0, column="bool"),
    Metric("mission_time", "mission time", "s", 1,
           "Time at which the last UGV reached its last goal; none before.",
           total="max", column="double"),
    Metric("hazards_hit", "hazards hit", "", 0,
           "Blocking hazards that were touched, each once by each UGV.",
           total="sum", goal=0.0, column="int64"),
    Metric("near_misses", "near misses", "", 0,
           "Blocking hazards that a UGV passed within 0.2 m without touching them.",
           total="sum", column="int64"),
    Metric("hazards_on_path", "hazards on the way", "", 0,
           "Hazards that a UGV passed within 2 m.", total="sum", column="int64"),
    Metric("warned", "hazards known in time", "", 0,
           "Those hazards on the way that the UGV knew before it came within 2 m.",
           total="sum", column="int64"),
    Metric("mean_warning_time", "mean warning time", "s", 1,
           "Mean time between knowing such a hazard and coming within 2 m of it.",
           total="mean", column="double"),
    Metric("reported_share", "way seen ahead", "%", 0,
           "Share of the way over tiles that had come by radio before.",
           total="mean", column="double"),
    Metric("ground_certified_share", "known ground certified", "%", 1,
           "Share of the ticks at which cautious UGVs were certified to stay on tiles "
           "that they know.", total="mean", column="double"),
    Metric("entered_unknown_tile", "unknown tiles entered", "ticks", 0,
           "Ticks in which a UGV drove over a tile that it did not know to be drivable.",
           total="sum", column="int64"),
    Metric("ground_certificate_broken", "ground certificate broken", "ticks", 0,
           "Certified ticks after which a cautious UGV was not certified to stay on known "
           "tiles, or left them, although all assumptions held.",
           total="sum", goal=0.0, guaranteed=True, column="int64"),
    Metric("stationary_time", "standstill", "s", 1,
           "Time at which UGVs stood still before they had arrived.",
           total="sum", column="double"),
    Metric("finds", "objects to find", "", 0,
           "Objects to be found.", column="int64"),
    Metric("found", "objects found", "", 0,
           "Objects that a vehicle's sensor has detected.", total="sum", column="int64"),
)
"""Metrics of all UGVs where there are hazards, as in the message `MissionResult`."""

LINK = _table(
    Metric("delivery_ratio", "delivered", "%", 1,
           "Share of the messages that got through, of those whose fate is known.",
           total="mean", column="double"),
    Metric("age", "age", "s", 2,
           "Age of the newest information that got through."),
    Metric("mean_age", "mean age", "s", 2,
           "Mean age of information since the first message.", total="mean", column="double"),
    Metric("max_age", "largest age", "s", 2,
           "Largest age of information since the first message.", total="max", column="double"),
    Metric("sent", "sent", "", 0,
           "Messages sent.", total="sum"),
    Metric("delivered", "delivered", "", 0,
           "Messages delivered, with copies."),
    Metric("duplicated", "duplicated", "", 0,
           "Copies made by the link."),
    Metric("queued", "queued", "", 0,
           "Messages that wait at the sender."),
    Metric("in_transit", "in flight", "", 0,
           "Messages on the way."),
    Metric("lost", "lost", "", 0,
           "Messages lost, by cause."),
)
"""Metrics of each link, as in the message `LinkStatus`."""

PROCESS = _table(
    Metric("missing_commands", "no new command", "", 0,
           "Ticks for which the vehicle had no new command."),
    Metric("stale_commands", "late command used", "", 0,
           "Commands that were used after the tick that they answer."),
    Metric("shortened_commands", "command beyond its bound", "", 0,
           "Commands that were longer than the vehicle's bound."),
    Metric("lost", "lost", "", 0,
           "Times that the process disconnected."),
    Metric("rejoined", "joined again", "", 0,
           "Times that the process reconnected."),
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
           "Visibility radius minus distance: below 0 the UGV is out of sight.", total="min"),
    Metric("coverage_error", "coverage error e(t)", "m²", 1,
           "Coverage that the ground around the UGV lacks, eq. (4).", total="max"),
    Metric("estimate_error", "estimate error", "m", 3,
           "Distance between the estimated and the true position of the UGV.", total="max"),
    RUN["realtime_factor"],
)
"""Metrics of this moment, which the page shows while the run lasts."""

SWEEP = _table(
    Metric("margin", "margin", "m", 3,
           "r_v minus the largest distance of the run; visibility was lost where it is "
           "not positive.", column="double"),
    Metric("violated", "out of sight", "", 0,
           "The UGV was out of sight at some tick.", column="bool"),
    Metric("seconds", "wall time", "s", 0,
           "Wall time of the run.", column="double"),
    Metric("error", "error", "", 0,
           "Why the run failed; none for a run that did not.", column="string"),
)
"""Columns that only a sweep has."""
# fmt: on

LINK_COLUMNS = (LinkKind.DETECTIONS, LinkKind.COMMANDS)
"""Kinds of links whose metrics are columns of a sweep, such as `detections_mean_age`."""

TABLES = {
    "Run": RUN,
    "UAV": UAV,
    "Safety filter": CERTIFICATE,
    "Mission": MISSION,
    "Link": LINK,
    "Process": PROCESS,
    "Now": NOW,
    "Sweep": SWEEP,
}
"""All tables, by the heading of their section in the reference."""

SUMMARY = RUN | UAV | CERTIFICATE | MISSION
"""Metrics of a run's summary; those of the mission are fields of `Summary.mission`."""


def columns() -> dict[str, Column]:
    """Return the columns that a run of a sweep fills, with their Parquet types."""
    found: dict[str, Column] = {row.name: row.column for row in SUMMARY.values() if row.column}
    for kind in LINK_COLUMNS:
        found |= {f"{kind}_{row.name}": row.column for row in LINK.values() if row.column}
    found |= {row.name: row.column for row in SWEEP.values()}
    return found


def numbers(table: dict[str, Metric], struct: msgspec.Struct) -> dict[str, float]:
    """Return the metrics of a table by name, from the struct that has them; NaN for None."""
    values = {name: getattr(struct, name) for name in table}
    return {name: math.nan if value is None else value for name, value in values.items()}


def total(metric: Metric, values: Iterable[float | None]) -> float | None:
    """Return the one number of several, of those that exist; None where none does."""
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
    raise ValueError(f"{metric.name}: no total of several; allowed: max, min, mean, sum")
