"""The filter from the literature that ours is compared with.

It flies, keeps sight, and changes no more than it has to.
"""

import importlib
import math
from pathlib import Path
from types import ModuleType

import msgspec
import pytest

from flights import uav_sees
from sim.engine.briefing import briefing

EVADED = {"network": "undegraded", "inner": "outward", "driver": "evade", "seed": 7}
FOLDER = Path(__file__).resolve().parent.parent / "benchmarks" / "filters"
if not FOLDER.is_dir():
    pytest.skip("a copy of the core alone has no benchmarks", allow_module_level=True)


@pytest.fixture
def compare(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(FOLDER))
    return importlib.import_module("compare")


def test_the_peer_keeps_sight_where_the_inner_control_alone_loses_it(compare: ModuleType) -> None:
    flown = {
        name: compare.fly(compare.Case(filter=name, duration=20.0, **EVADED))
        for name in ("none", "ours", "backup, γ = 1")
    }
    assert flown["none"].lost
    for name in ("ours", "backup, γ = 1"):
        result = flown[name]
        assert not result.lost
        assert result.known == result.ticks
        assert result.known_while_lost == 0
        assert result.interventions > 100
        assert result.max_distance > 4.7  # it leaves the inner control what there is
    lines = list(compare.rows(list(flown.values())))
    assert [line[3] for line in lines] == ["1 of 1", "0 of 1", "0 of 1"]
    assert compare.table(lines).count("\n") == 5


def test_the_peer_takes_the_nearest_input_that_keeps_its_barrier(compare: ModuleType) -> None:
    case = compare.Case(filter="ours", duration=30.0, **EVADED)
    told = briefing(compare.scenario_of(case), "uav_0", 7)
    peer = importlib.import_module("backup_filter")

    def answer(distance: float, speed: float, wanted: tuple[float, float], gamma: float = 1.0):
        watch = peer.BackupFilter(told, gamma=gamma)
        there = {"position": (20.0 + distance, 20.0), "velocity": (speed, 0.0)}
        seen = uav_sees(0, (0.0, (distance, 0.0)), **there)
        watch.see(seen)
        return watch.filter(seen, wanted)

    assert answer(1.0, 0.0, (0.3, 0.0)).acceleration == (0.3, 0.0)
    assert not answer(1.0, 0.0, (0.3, 0.0)).overridden
    bounded = answer(3.77, 0.55, (0.3, 0.0))
    assert bounded.overridden
    assert bounded.certified
    assert -0.3 < bounded.acceleration[0] < 0.3
    assert math.hypot(*bounded.acceleration) <= 0.3 + 1e-9
    assert answer(3.5, 0.55, (0.3, 0.0)).acceleration == (0.3, 0.0)
    assert answer(3.5, 0.55, (0.3, 0.0), gamma=0.1).acceleration[0] < 0.3
    lost = answer(4.7, 0.6, (0.3, 0.0))
    assert not lost.certified
    assert lost.acceleration[0] == pytest.approx(-0.3)  # the backup policy


def test_every_case_of_the_comparison_can_be_flown(compare: ModuleType) -> None:
    cases = list(compare.cases(1, 20.0))
    assert len(cases) == len(compare.NETWORKS) * len(compare.DRIVERS) * (
        2 * len(compare.FILTERS) - 1
    )
    for case in cases:
        assert compare.scenario_of(case).duration == 20.0
    assert msgspec.to_builtins(cases[0])["network"] == "undegraded"
