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
    path = tmp_path / "trajectory.csv"
    flight.recorder.write(path)
    again = {"duration": 60.0, "ugv.0.driver": "script", "ugv.0.trajectory": str(path)}
    driven = fly(load_scenario("escort", overrides=again | {"ugv.0.goals": []}), 7)[0]
    recorded, repeated = (one.recorder.states[:, 1, :4] for one in (flight, driven))
    assert np.abs(repeated - recorded).max() < 1e-9
    assert np.abs(recorded[-1, :2] - recorded[0, :2]).max() > 5.0


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
