"""The table of metrics: it explains every number of a run, its summary and its views."""

import math
from typing import Any

import msgspec
import numpy as np
import pytest

from bus.messages.links import LinkStatus
from bus.messages.telemetry import MissionResult, TeamStatus, VehicleStatus
from outrider.cli.summary_table import print_summary
from outrider.envs.env_pilots import pilots
from outrider.envs.parallel import parallel_env
from outrider.experiments.sweep.columns import RESULTS, row_of
from outrider.running.flying import fly
from outrider.running.metrics import LINK, MISSION, PROCESS, SUMMARY, TEAM, UAV, total
from outrider.running.summary import Summary
from outrider_falsify.description import describe
from sim.scenario.checks import scenario_warnings
from sim.scenario.loading import load_scenario

NO_METRICS = {"seed", "dt", "realtime", "first_missing_tick", "lost_chance"}
"""Numbers of a summary that are settings or other bounds."""
PAIRS = {
    "uav": [{"position": [7.0, 8.0]}, {"position": [7.0, 28.0], "escorts": "ugv_1"}],
    "ugv": [{"position": [7.0, 7.0]}, {"position": [7.0, 27.0]}],
    "detections.dropout": 0.3,
    "detections.noise": 0.1,
    "duration": 20.0,
}


def _numbers(struct: type[msgspec.Struct]) -> set[str]:
    """Return the fields that contain a number or a truth value."""
    kinds = (msgspec.inspect.IntType, msgspec.inspect.FloatType, msgspec.inspect.BoolType)
    found = msgspec.inspect.type_info(struct)
    assert isinstance(found, msgspec.inspect.StructType)
    return {
        field.name
        for field in found.fields
        if any(isinstance(kind, kinds) for kind in getattr(field.type, "types", (field.type,)))
    }


def test_summary_numbers_and_metric_rows_correspond() -> None:
    of_a_run = set(SUMMARY) - set(MISSION) - set(TEAM)
    assert _numbers(Summary) - NO_METRICS == of_a_run - {"trajectory_sha256"}
    assert of_a_run <= set(Summary.__struct_fields__)
    for table, struct, other in (
        (MISSION, MissionResult, {"guarantees"}),
        (TEAM, TeamStatus, {"numbers", "charges"}),
        (LINK, LinkStatus, {"degraded", "settings"}),
        (PROCESS, VehicleStatus, {"present", "last_fault"}),
    ):
        assert set(struct.__struct_fields__) ^ set(table) <= other


@pytest.fixture(scope="module")
def pairs() -> Summary:
    return fly(load_scenario("escort", overrides=PAIRS), 3)[1]


def test_the_summary_has_each_uav_and_the_total_of_all(pairs: Summary) -> None:
    assert list(pairs.uavs) == ["uav_0", "uav_1"]
    one, other = pairs.uavs.values()
    assert one != other
    for name, metric in UAV.items():
        values = [getattr(one, name), getattr(other, name)]
        wanted: Any = values[0]
        if metric.total == "rms":
            weights = (one.detections, other.detections) if "detection" in name else (1, 1)
            squares = sum(w * value**2 for w, value in zip(weights, values, strict=True))
            wanted = math.sqrt(squares / sum(weights))
        elif metric.total != "first":
            wanted = total(metric, values)
        # one may have an estimate some ticks before the other
        rel = 0.02 if name == "estimate_rmse" else 1e-9
        assert getattr(pairs, name) == pytest.approx(wanted, rel=rel), name
    assert one.detections != other.detections
    shares = [uav.certified_share for uav in pairs.uavs.values()]
    assert pairs.certified_share == pytest.approx(sum(share or 0.0 for share in shares) / 2.0)


def test_the_console_has_a_row_for_each_of_several_uavs(pairs: Summary, capsys: Any) -> None:
    print_summary(pairs, [])
    lines = capsys.readouterr().out.splitlines()
    for name, of_uav in pairs.uavs.items():
        (row,) = (line.split() for line in lines if line.startswith(name))
        assert row[1] == UAV["max_distance"].number(of_uav.max_distance or 0.0)
    alone = msgspec.structs.replace(pairs, uavs={"uav_0": pairs.uavs["uav_0"]})
    print_summary(alone, [])
    assert "\nuav_0" not in capsys.readouterr().out


def test_a_row_of_a_sweep_has_the_columns_types(pairs: Summary) -> None:
    types: dict[str, Any] = {"int64": int, "double": (int, float), "bool": bool, "string": str}
    row = row_of(pairs, 1.5)
    assert list(row) == list(RESULTS)
    for name, value in row.items():
        assert value is None or isinstance(value, types[RESULTS[name]]), name
    assert row["margin"] == pytest.approx(pairs.visibility_radius - (pairs.max_distance or 0.0))
    assert row["violated"] is False
    lost = row_of(msgspec.structs.replace(pairs, visibility_violations=2), 1.5)
    assert (lost["violated"], lost["visibility_violations"]) == (True, 2)
    ages = [one.max_age for name, one in pairs.links.items() if name.endswith("detections")]
    assert row["detections_max_age"] == max(age for age in ages if age is not None)


def test_sight_at_low_altitude_depends_on_visibility_there() -> None:
    changes = {"uav.0.initial_altitude": 4.0, "law.name": "coverage", "duration": 25.0}
    scenario = load_scenario("escort", overrides=changes)
    flight, summary = fly(scenario, scenario.seed)
    within_r_v = flight.recorder.lost[:, 0] & (flight.recorder.escorts[:, 0, 0] < 4.75)
    assert within_r_v.any()
    row = row_of(summary, 1.0)
    assert row["violated"]
    assert row["margin"] <= 0.0
    first = int(flight.recorder.lost[:, 0].argmax()) * scenario.dt
    assert f"At {first:.2f} s the UGV is lost." in " ".join(describe(scenario, flight))
    env = parallel_env(scenario, end_on_sight_lost=False)
    own = pilots(env)
    observations, _ = env.reset(seed=scenario.seed)
    for tick in range(1, scenario.ticks):
        observations, *_ = env.step({name: act(observations[name]) for name, act in own.items()})
        assert (env.metrics()["uav_0"]["margin"] <= 0.0) == flight.recorder.lost[tick, 0]


def test_separation_of_several_uavs_is_measured_and_warned_of() -> None:
    near = [{"position": [7.0, 8.0]}, {"position": [7.2, 8.0]}]
    scenario = load_scenario("escort", overrides=PAIRS | {"uav": near, "duration": 5.0})
    flight, summary = fly(scenario, 1)
    rows = flight.world.escorts[:, 0]
    first, second = (flight.recorder.states[:, row, :2] for row in rows)
    assert summary.min_separation == np.linalg.norm(first - second, axis=1).min()
    (line,) = (line for line in scenario_warnings(scenario) if "apart" in line)
    assert "uav_0, uav_1" in line
    assert "min_separation" in line
    alone = msgspec.structs.replace(scenario, uav=scenario.uav[:1])
    assert fly(alone, 1)[1].min_separation is None
    assert not any("apart" in line for line in scenario_warnings(alone))
