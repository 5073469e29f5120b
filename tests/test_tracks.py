"""A recorded trajectory of a UGV, driven again."""

from pathlib import Path

import numpy as np
import pytest

from bus.errors import ScenarioError
from outrider.running.flying import fly
from refusals import refused
from sim.scenario.loading import load_scenario


def test_a_recorded_track_is_driven_again(tmp_path: Path) -> None:
    flight = fly(load_scenario("escort", overrides=["duration=60.0"]), 7)[0]
    flight.recorder.write(tmp_path / "trajectory.csv")
    again = {
        "duration": 60.0,
        "ugv.0.driver": "script",
        "ugv.0.trajectory": str(tmp_path / "trajectory.csv"),
        "ugv.0.goals": [],
    }
    driven = fly(load_scenario("escort", overrides=again), 7)[0]
    ugv = flight.world.names.index("ugv_0")
    assert (
        np.abs(driven.recorder.states[:, ugv, :4] - flight.recorder.states[:, ugv, :4]).max() < 1e-9
    )
    assert (
        np.abs(flight.recorder.states[-1, ugv, :2] - flight.recorder.states[0, ugv, :2]).max() > 5.0
    )


@pytest.mark.parametrize(
    ("content", "phrase"),
    [
        (None, "cannot be read"),
        ("a,b\n1,2\n", "has no column"),
        ("time [s],ugv_0.vx [m/s],ugv_0.vy [m/s]\n0,x,0\n", "not a trajectory"),
        ("time [s],ugv_0.vx [m/s],ugv_0.vy [m/s]\n0,0,0\n", "too short"),
        ("time [s],ugv_0.vx [m/s],ugv_0.vy [m/s]\n0,0,0\n0,0,0\n0,0,0\n", "increasing times"),
    ],
)
def test_a_track_that_is_none_is_refused_in_one_line(content, phrase, tmp_path):
    path = tmp_path / "track.csv"
    if content is not None:
        path.write_text(content, encoding="utf-8")
    with refused(ScenarioError, phrase):
        load_scenario("escort", overrides={"ugv.0.driver": "script", "ugv.0.trajectory": str(path)})
