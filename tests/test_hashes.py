"""Stored hashes of flights: a change of the code must not alter results without meaning to."""

import json

import pytest

from hashes import BATCHES, FILE, batch, made_with, trajectory
from sim.scenario.loading import scenario_names

STORED = json.loads(FILE.read_text("utf-8"))
pytestmark = pytest.mark.skipif(
    STORED["made_with"] != made_with(), reason="hashes.json was made with other versions"
)
QUICK = ("escort", "circle")


@pytest.mark.parametrize(
    "name",
    [n if n in QUICK else pytest.param(n, marks=pytest.mark.long) for n in scenario_names()],
)
def test_shipped_scenario_flies_as_before(name: str) -> None:
    assert trajectory(name) == STORED["trajectories"][name]


@pytest.mark.parametrize(
    "name", [n if n == "plane" else pytest.param(n, marks=pytest.mark.long) for n in BATCHES]
)
def test_batch_flies_as_before(name: str) -> None:
    assert batch(name) == STORED["batches"][name]
