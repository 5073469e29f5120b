"""Policies that drive the UGV: functions and objects of the user."""

import logging
import math
import re
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import outrider
from agents.drivers.policy import Policy, PolicyDriver, UgvRows
from bus.errors import ScenarioError
from bus.messages.vehicle import Command, UgvObservation
from bus.observations import UGV, names
from flights import DT, U_G, V_G, Piloted, ugv_briefing
from outrider.envs.env_pilots import pilots
from outrider.running import user_modules
from outrider.running.flying import make_pilots
from outrider.running.user_code import load_function, load_policy
from refusals import refused
from sim.models.vehicles import norm
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario
from sim.server.flight import Flight
from worlds import equal


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the working folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


FAST = load_scenario(
    "escort",
    overrides={
        "duration": 60.0,
        "ugv.0.max_speed": 0.5,
        "ugv.0.max_acceleration": 0.2,
        "ugv.0.goals": [[10.4, 8.0], [9.0, 9.0]],
    },
)
"""A UGV that is fast enough to pass its goals."""


def _seen(
    tick: int = 0, x: float = 10.0, y: float = 10.0, velocity: tuple[float, float] = (0.1, -0.1)
) -> UgvObservation:
    return UgvObservation(tick=tick, time=tick * DT, position=(x, y), velocity=velocity)


def _function(answer: Callable[[], object]) -> Policy:
    return lambda observation, briefing: answer()


def _model(answer: Callable[[], object]) -> Policy:
    """Return an object with a method `predict`, as written by a user."""
    return SimpleNamespace(predict=lambda row: answer())


def _acceleration_for(
    answer: object,
    kind: Callable[[Callable[[], object]], Policy] = _function,
    velocity: tuple[float, float] = (0.0, 0.0),
) -> tuple[float, float]:
    """Return the acceleration of a UGV whose policy returns this answer."""
    driver = PolicyDriver(ugv_briefing(), policy=kind(lambda: answer), name="mine:drive")
    return driver.drive(_seen(12, velocity=velocity))


@pytest.mark.parametrize(
    "answer",
    [(0.03, -0.01), [0.03, -0.01], np.array([0.03, -0.01]), (np.float64(0.03), -0.01)],
    ids=lambda a: type(a).__name__,
)
def test_a_functions_answer_within_the_bounds_is_taken_as_it_is(answer: object) -> None:
    assert _acceleration_for(answer) == (0.03, -0.01)


@pytest.mark.parametrize(
    "answer", [(1, 1), (1e308, 1e308), np.array([3, 3]), np.array([5.0, 5.0], dtype=np.float32)]
)
def test_a_functions_answer_beyond_the_bound_is_shortened(answer: object) -> None:
    assert _acceleration_for(answer) == pytest.approx([U_G / math.sqrt(2.0)] * 2, rel=1e-12)


def test_a_function_cannot_drive_beyond_the_largest_speed() -> None:
    u_x, u_y = _acceleration_for((0.1, 0.0), velocity=(V_G, 0.0))
    assert (u_x, u_y) == pytest.approx((0.0, 0.0), abs=1e-12)
    u_x, u_y = _acceleration_for((0.0, 0.1), velocity=(V_G, 0.0))
    assert norm(V_G + u_x * DT, u_y * DT) <= V_G * (1.0 + 1e-12)
    assert u_y > 0.09


def test_a_function_is_given_the_observation_and_the_briefing() -> None:
    briefing, given = ugv_briefing(), []
    driver = PolicyDriver(briefing, policy=lambda *seen: given.append(seen) or (0, 0), name="m:f")
    driver.drive(_seen(4))
    assert given == [(_seen(4), briefing)]


@pytest.mark.parametrize(
    "answer",
    [(0.3, -4.0), np.array([0.3, -4.0]), ((0.3, -4.0), None), (np.array([0.3, -4.0]), (1.0, 2.0))],
)
def test_prediction_is_passed_on_with_or_without_state(answer: object) -> None:
    assert _acceleration_for(answer, _model) == (0.3, -4.0)


NONSENSE = [
    *(None, 0.1, (), (0.1,), (0.1, 0.2, 0.3), [[0.1, 0.2]], [[0.1], [0.2]], (math.nan, 0.0)),
    *((0.0, -math.inf), ("0.1", "0.2"), (True, False), (0.1j, 0.2), ([0.1], [0.1, 0.2])),
    *({"x": 0.1, "y": 0.2}, (10**400, 0), "a\nb", np.zeros((50, 50)), (None, None), ((0.1,), None)),
]


@pytest.mark.parametrize(
    ("kind", "answer"),
    [
        *((kind, answer) for kind in (_function, _model) for answer in NONSENSE),
        (_model, (2e6, 0.0)),
    ],
)
def test_invalid_answer_is_named_in_one_line(kind: Any, answer: object) -> None:
    with refused(
        ScenarioError, r"^policy = 'mine:drive': tick 12: returned .+; allowed: two finite numbers"
    ) as caught:
        _acceleration_for(answer, kind)
    assert len(str(caught.value)) < 250
    if isinstance(answer, tuple) and len(answer) == 3:
        assert "(0.1, 0.2, 0.3)" in str(caught.value)


@pytest.mark.parametrize("kind", [_function, _model])
def test_a_policy_that_raises_is_named_in_one_line(kind: Any) -> None:
    def broken() -> object:
        raise RuntimeError("no\nsuch weights")

    driver = PolicyDriver(ugv_briefing(), policy=kind(broken), name="mine:broken")
    with refused(
        ScenarioError, r"^policy = 'mine:broken': tick 3: raised RuntimeError: no such weights"
    ) as caught:
        driver.drive(_seen(3))
    assert isinstance(caught.value.__cause__, RuntimeError)


@pytest.mark.parametrize(
    "scenario", [FAST, load_scenario("escort", overrides={"duration": 20.0})], ids=["fast", "slow"]
)
def test_pilot_and_environment_have_the_same_observation_bits(scenario: Scenario) -> None:
    env = outrider.parallel_env(scenario, end_on_sight_lost=False)
    policies = pilots(env)
    observations, _ = env.reset(seed=4)
    theirs = []
    while env.agents:
        theirs.append(observations["ugv_0"])
        actions = {name: policies[name](observations[name]) for name in env.agents}
        observations, *_ = env.step(actions)
    flying, rows, ours = make_pilots(scenario, 4), UgvRows(env.briefing("ugv_0")), []

    def act(seen: UgvObservation) -> Command:
        ours.append(rows.row(seen))
        return flying["ugv_0"].act(seen)

    Flight(scenario, 4).fly(Piloted(flying, "ugv_0", act))
    assert equal(tuple(ours), tuple(theirs))
    underway = [row[names(UGV).index("underway")] for row in ours]
    assert underway[0] == 1.0
    assert underway[-1] == (0.0 if scenario is FAST else 1.0)


def test_ugvs_that_share_a_policy_reach_goals_of_their_own() -> None:
    goals = []
    model = SimpleNamespace(predict=lambda row: goals.append(tuple(row[6:8])) or (0.0, 0.0))
    first, other = (PolicyDriver(ugv_briefing(), policy=model, name="x") for _ in range(2))
    first.drive(_seen(0, 3.0, 4.0))
    other.drive(_seen(0))
    assert goals == [(18.0, 1.0), (3.0, 4.0)]


def test_slow_policy_is_reported_once_after_its_first_answer(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = iter([0.0, 9.0, 10.0, 10.04, 20.0, 20.3, 30.0, 30.3])
    monkeypatch.setattr(time, "perf_counter", lambda: next(clock))
    driver = PolicyDriver(ugv_briefing(), policy=_model(lambda: (0.0, 0.0)), name="mine:slow")
    with caplog.at_level(logging.WARNING, logger="outrider.policy"):
        for tick in range(4):
            driver.drive(_seen(tick))
    (line,) = [record.getMessage() for record in caplog.records]
    assert line.startswith(
        "policy = 'mine:slow': tick 2: took 0.30 s to answer, longer than the tick of 0.05 s"
    )


def refusal(name: str) -> str:
    with refused(ScenarioError, r"^custom\.policy = ") as caught:
        load_function(name, what="custom.policy")
    line = str(caught.value)
    assert repr(name) in line
    assert len(line) < 400
    return line


def test_predicting_object_is_accepted_and_a_class_refused(here: Path) -> None:
    (here / "mine_models.py").write_text(
        "class Model:\n    def predict(self, row):\n        return row[3:5]\nmodel = Model()\nnumber = 3\n"
    )
    model = load_function("mine_models:model", what="policy")
    assert PolicyDriver(ugv_briefing(), policy=model, name="x").drive(_seen()) == (0.1, -0.1)
    for name in ("mine_models:Model", "mine_models:number"):
        assert "not a policy; allowed: a function, or an object with a method predict" in refusal(
            name
        )


@pytest.mark.parametrize(
    ("name", "phrase"),
    [
        ("queue:wheel", r"queue\.py in this folder is hidden by .*queue"),
        ("sys:wheel", "sys.* has no 'wheel'"),
        ("json:dmups", r"json/__init__\.py has no 'dmups', did you mean 'dumps'\?"),
        ("my_drivers:whel", r"my_drivers\.py has no 'whel', did you mean 'wheel'\?"),
        ("my_driver.py:wheel", "no module 'my_driver' .*, did you mean 'my_drivers'\\?"),
        ("needy:wheel", "No module named 'nowhere_at_all'"),
        ("broken:wheel", "cannot be imported: ValueError: no weights"),
    ],
)
def test_an_object_that_cannot_be_loaded_is_reported(name, phrase, here, monkeypatch):
    monkeypatch.setattr(sys, "path", sys.path.copy())
    for file in ("queue", "my_drivers"):
        (here / f"{file}.py").write_text("def wheel(observation, briefing):\n    return 0.1, 0.0\n")
    (here / "needy.py").write_text("import nowhere_at_all\n")
    (here / "broken.py").write_text("raise ValueError('no\\nweights')\n")
    assert re.search(phrase, refusal(name))


def test_a_function_may_be_named_by_its_file(here: Path, monkeypatch) -> None:
    monkeypatch.setattr(sys, "path", sys.path.copy())
    (here / "my_wheels.py").write_text("def wheel(observation, briefing):\n    return 0.1, 0.0\n")
    assert load_policy("my_wheels.py:wheel", "ugv")(None, None) == (0.1, 0.0)
    assert load_scenario(overrides={"custom.weighting": "my_wheels.py:wheel"})


def test_module_search_order_is_library_folder_clone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A function tried in the clone, as in the README, is not loaded from elsewhere."""
    clone, library, here = (tmp_path / name for name in ("clone", "library", "here"))
    for folder, modules in ((clone, "tried kept"), (library, "known"), (here, "tried known")):
        folder.mkdir()
        text = f"def policy(observation, briefing):\n    return {folder.name!r}\n"
        for name in modules.split():
            (folder / f"{name}_{tmp_path.name}.py").write_text(text, encoding="utf-8")
    (clone / "pyproject.toml").touch()
    linked = tmp_path / "linked"
    linked.symlink_to(clone)
    monkeypatch.setattr(sys, "path", [str(linked), *sys.path, str(clone), str(library)])
    monkeypatch.setattr(user_modules, "_HOME", clone.resolve())
    monkeypatch.chdir(here)
    for module, folder in (("tried", here), ("known", library), ("kept", clone)):
        assert load_policy(f"{module}_{tmp_path.name}:policy", "ugv")(None, None) == folder.name
