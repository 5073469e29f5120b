"""Saved policies that drive the UGV: over the bus they see and do the same as in the environment.

The libraries need not be installed: stand-ins with the same interface are on the path.
"""

import importlib
import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

import outrider
from agents.drivers.policy import PolicyDriver, UgvRows
from bus.errors import ScenarioError
from bus.messages.vehicle import UgvObservation
from bus.policies import policy_kinds
from bus.registry import resolve
from flights import DT, ugv_briefing
from outrider.envs.env_pilots import pilots
from outrider.running.flying import fly
from outrider.running.user_code import load_function, load_policy
from processes import loaded_by
from refusals import refused
from sim.scenario.loading import load_scenario
from sim.scenario.types import Custom, Scenario
from tabular import rows, words

LIBRARIES = ("stable_baselines3", "sb3_contrib", "torch", "onnxruntime")

STAND_INS = {
    "stable_baselines3": """
import json
from types import SimpleNamespace
import numpy as np

class PPO:
    def __init__(self, saved):
        row = SimpleNamespace(shape=tuple(saved["row"]), dtype=np.dtype(saved["dtype"]), low=np.array(saved["low"]))
        parts = {name: SimpleNamespace(shape=tuple(shape)) for name, shape in saved["pictures"].items()}
        self.observation_space = SimpleNamespace(spaces={"row": row} | parts) if parts else row
        self.action_space = SimpleNamespace(shape=tuple(saved["action"]))
        self.weights, self.seen, self.asked = np.array(saved["weights"]), [], []

    @classmethod
    def load(cls, path, device="auto"):
        assert device == "cpu"
        with open(path) as file:
            return cls(json.load(file))

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        self.seen.append(observation)
        self.asked.append((state, bool(episode_start[0]), deterministic))
        return np.tanh(observation @ self.weights), (state or 0) + 1
""",
    "torch": """
import json
from contextlib import nullcontext
from types import SimpleNamespace
import numpy as np

float32, no_grad, as_tensor = np.float32, nullcontext, np.asarray
threads = [8]

def set_num_threads(count):
    threads.append(count)

class _Module:
    def __init__(self, weights):
        self.weights, self.ready = np.array(weights, dtype=np.float32), False

    def eval(self):
        self.ready = True

    def __call__(self, tensor):
        assert self.ready and tensor.dtype == np.float32 and tensor.shape == (8,)
        return np.tanh(tensor @ self.weights)

def _load(path, map_location):
    assert map_location == "cpu"
    with open(path) as file:
        return _Module(json.load(file)["weights"])

jit = SimpleNamespace(load=_load)
""",
    "onnxruntime": """
import json
from types import SimpleNamespace
import numpy as np

SessionOptions = SimpleNamespace

class InferenceSession:
    def __init__(self, path, options, providers):
        assert providers == ["CPUExecutionProvider"] and options.intra_op_num_threads == 1
        with open(path) as file:
            self.saved = json.load(file)

    def get_inputs(self):
        shape = (*self.saved["batch"], *self.saved["row"])
        return [SimpleNamespace(name="x", type=self.saved["type"], shape=list(shape))] * self.saved["inputs"]

    def run(self, outputs, given):
        assert outputs is None and given["x"].dtype == np.float64
        return [np.tanh(given["x"] @ np.array(self.saved["weights"]))]
""",
}
WEIGHTS = [
    *([0.0, 0.0], [0.1, -0.02], [-0.1, 0.03], [0.5, 0.1]),
    *([0.1, -0.7], [0.2, 0.2], [0.01, 0.0], [0.0, -0.02]),
]
LOW = [0.0, 0.0, 0.0, -0.5, -0.5, 0.0, 0.0, 0.0]
SEEN = {"row": [8], "low": LOW, "pictures": {}, "dtype": "float64"}
INPUT = {"batch": [], "inputs": 1, "type": "tensor(double)"}
SAVED = SEEN | INPUT | {"action": [2], "weights": WEIGHTS}


@pytest.fixture
def _no_libraries(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Hide the libraries, and remove those that a test installs."""
    for name in LIBRARIES:
        monkeypatch.setitem(sys.modules, name, None)
    yield
    importlib.invalidate_caches()


@pytest.fixture
def here(_no_libraries: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the working folder, with the stand-ins and a policy for each."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    for name, body in STAND_INS.items():
        (tmp_path / f"{name}.py").write_text(body)
        monkeypatch.delitem(sys.modules, name)
        monkeypatch.setitem(sys.modules, name, importlib.import_module(name))
    for file in ("model.zip", "model.pt", "model.onnx"):
        (tmp_path / file).write_text(json.dumps(SAVED))
    return tmp_path


def rewrite(folder: Path, file: str, **changes: Any) -> None:
    (folder / file).write_text(json.dumps(SAVED | changes))


def _scenario(policy: str = "") -> Scenario:
    """Return a UGV that is fast enough to pass its goals."""
    changes = {
        "duration": 60.0,
        "ugv.0.max_speed": 0.5,
        "ugv.0.max_acceleration": 0.2,
        "ugv.0.goals": [[10.4, 8.0], [9.0, 9.0]],
    }
    scenario = load_scenario("escort", overrides=changes)
    if not policy:
        return scenario
    driven = tuple(msgspec.structs.replace(ugv, driver="policy") for ugv in scenario.ugv)
    return msgspec.structs.replace(scenario, ugv=driven, custom=Custom(policy=policy))


def _seen(
    tick: int = 0, x: float = 10.0, y: float = 10.0, velocity: tuple[float, float] = (0.1, -0.1)
) -> UgvObservation:
    return UgvObservation(tick=tick, time=tick * DT, position=(x, y), velocity=velocity)


@pytest.mark.parametrize(
    "name", ["sb3:ppo:model.zip", "sb3:PPO:model.zip", "torch:model.pt", "onnx:model.onnx"]
)
def test_saved_policy_flies_the_bits_of_the_environment(here: Path, name: str) -> None:
    scenario = _scenario(name)
    flight, _ = fly(scenario, 3)
    model, env = (
        load_policy(name, "ugv"),
        outrider.parallel_env(_scenario(), end_on_sight_lost=False),
    )
    fleet = pilots(env)
    observations, _ = env.reset(seed=3)
    k, state = 0, None
    while env.agents:
        assert np.array_equal(env.world.position, flight.recorder.states[k, :, :2])
        assert np.array_equal(env.world.velocity, flight.recorder.states[k, :, 2:4])
        row = observations["ugv_0"]
        if name.startswith("sb3"):
            action, state = model.predict(row, state=state, episode_start=[False])
        else:
            action = model.predict(row)
        theirs = fleet["uav_0"](observations["uav_0"])
        observations, *_ = env.step({"uav_0": theirs, "ugv_0": action})
        k += 1
    assert k == flight.recorder.ticks == scenario.ticks
    pace = np.hypot(*flight.recorder.states[:, 1, 2:4].T)
    # the bounds of the world were reached, and nothing else changed the action
    assert pace.max() == pytest.approx(0.5)


@pytest.mark.parametrize("name", ["sb3:ppo:model.zip", "torch:model.pt"])
def test_loaded_policy_uses_one_thread_of_torch(here: Path, name: str) -> None:
    load_policy(name, "ugv")
    assert importlib.import_module("torch").threads[-1] == 1


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_what_an_sb3_policy_is_asked(here: Path, dtype: str) -> None:
    rewrite(here, "model.zip", dtype=dtype)
    model = load_policy("sb3:ppo:model.zip", "ugv")
    driver = PolicyDriver(ugv_briefing(), policy=model, name="x")
    for tick in range(3):
        driver.drive(_seen(tick))
    assert model.asked == [(None, True, True), (1, False, True), (2, False, True)]
    assert {row.dtype for row in model.seen} == {np.dtype(dtype)}
    other = PolicyDriver(ugv_briefing(), policy=model, name="x")  # another UGV of the same process
    other.drive(_seen(0))
    assert model.asked[-1] == (None, True, True)


def refusal(name: str) -> str:
    with refused(ScenarioError, r"^custom\.policy = ") as caught:
        load_function(name, what="custom.policy")
    line = str(caught.value)
    assert repr(name) in line
    assert len(line) < 400
    return line


@pytest.mark.usefixtures("_no_libraries")
@pytest.mark.parametrize(
    ("name", "package"),
    [
        ("sb3:ppo:m.zip", "stable-baselines3"),
        ("torch:m.zip", "torch"),
        ("onnx:m.zip", "onnxruntime"),
    ],
)
def test_missing_library_is_named_with_its_install_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, package: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("m.zip").write_bytes(b"")
    assert f"pip install {package}" in refusal(name)


@pytest.mark.parametrize(
    "content", [b"", b"hello", json.dumps(SAVED).encode()[:-9], b"\xff\x00"], ids=range(4)
)
@pytest.mark.parametrize("name", ["sb3:ppo:bad.zip", "torch:bad.zip", "onnx:bad.zip"])
def test_a_damaged_file_is_named_in_one_line(here: Path, name: str, content: bytes) -> None:
    (here / "bad.zip").write_bytes(content)
    assert "cannot be loaded" in refusal(name)


@pytest.mark.parametrize(
    ("names", "phrase"),
    rows("""
sb3:ppo:none.zip sb3:ppo: torch:none.pt torch: onnx:none.onnx onnx:. | no such file
model.zip model.pt folder/model.onnx sb3:model.zip | sb3:ALGORITHM:FILE.zip
sb3:ddq:model.zip | unknown algorithm 'ddq'; installed: ppo
"""),
)
def test_missing_file_library_or_algorithm_is_one_line(here, names, phrase):
    assert all(phrase in refusal(name) for name in words(names))


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("sb3:ppo:model.zip", {"row": [9]}),
        ("sb3:ppo:model.zip", {"action": [4]}),
        ("sb3:ppo:model.zip", {"pictures": {"coverage": [21, 21]}}),
        ("sb3:ppo:model.zip", {"pictures": {"tiles": [3, 21, 21]}}),
        ("sb3:ppo:model.zip", {"pictures": {"tiles": [20, 20]}}),
        ("onnx:model.onnx", {"row": [9]}),
        ("onnx:model.onnx", {"inputs": 2}),
        ("onnx:model.onnx", {"batch": [2]}),
        ("onnx:model.onnx", {"batch": [1, 1]}),
        ("onnx:model.onnx", {"type": "tensor(float16)"}),
    ],
)
def test_a_policy_of_another_agent_is_refused_before_it_flies(here, name, changes):
    rewrite(here, name.rpartition(":")[2], **changes)
    assert "allowed: " in refusal(name)


@pytest.mark.parametrize("pictures", [{}, {"tiles": [21, 21]}], ids=str)
def test_saved_policy_with_normalized_rows_is_refused_on_load(
    here: Path, pictures: dict[str, Any]
) -> None:
    for low in (LOW, [-math.inf] * 8):
        rewrite(here, "model.zip", low=low, pictures=pictures)
        assert load_policy("sb3:ppo:model.zip", "ugv")
    for low in ([-1.0] * 8, [0.0] * 8):  # as scaled by `normalized` and by SuperSuit
        rewrite(here, "model.zip", low=low, pictures=pictures)
        assert "not rows in SI units" in refusal("sb3:ppo:model.zip")


@pytest.mark.parametrize("batch", [[], [1], ["batch"]], ids=str)
def test_an_onnx_graph_may_want_a_batch(here: Path, batch: list[Any]) -> None:
    rewrite(here, "model.onnx", batch=batch)
    row = UgvRows(ugv_briefing()).row(_seen())
    found = PolicyDriver(
        ugv_briefing(), policy=load_policy("onnx:model.onnx", "ugv"), name="x"
    ).drive(_seen())
    assert found == tuple(np.tanh(row @ np.array(WEIGHTS)))


def test_only_what_is_flown_is_imported() -> None:
    loaded = loaded_by(
        "outrider.running.user_code, outrider.running.flying, outrider_learning.learned"
    )
    assert loaded.isdisjoint({*LIBRARIES, "fmpy"})
    assert set(policy_kinds("ugv")) == {"sb3", "torch", "onnx", "fmu"}
    assert set(policy_kinds("uav")) == {"sb3", "npz"}


@pytest.mark.parametrize("vehicle", ["uav", "ugv"])
def test_every_kind_names_a_loader_that_is_there(vehicle: Any) -> None:
    assert all(callable(resolve(getattr(k, vehicle))) for k in policy_kinds(vehicle).values())
