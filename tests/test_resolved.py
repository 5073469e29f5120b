"""A scenario with all options applied: the file for the simulator, and its readers."""

import json
from pathlib import Path
from typing import Any
from unittest.mock import create_autospec

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bus.errors import BusError, ScenarioError
from bus.profiles import PROFILES
from outrider.running import launch
from outrider.running.parent import Start
from outrider.running.resolve import resolve
from processes import SHORT, launched
from sim.scenario.loading import load_scenario, scenario_names
from sim.scenario.resolved import as_toml, read_resolved
from sim.scenario.types import Scenario
from test_scenario_refusals import ODD, PATHS

TRACE = "sent [s],delay [s]\n5.0,0.1\n5.2,lost\n5.3,0\n"


def assert_written_and_read_the_same(scenario: Scenario, file: Path) -> None:
    file.write_text(as_toml(scenario, ["two\nlines"]), encoding="utf-8")
    for again in (read_resolved(file), load_scenario(file)):
        assert msgspec.json.encode(again) == msgspec.json.encode(scenario)


@pytest.mark.parametrize("name", scenario_names())
@pytest.mark.parametrize("network", ["", "wifi-poor"])
def test_a_shipped_scenario_is_written_and_read_the_same(
    name: str, network: str, tmp_path: Path
) -> None:
    scenario, _ = resolve(name, network=network, changes=["run.realtime=2", "wind.gust=0.01"])
    assert_written_and_read_the_same(scenario, tmp_path / "any.toml")


@settings(
    max_examples=300,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(
    st.dictionaries(st.sampled_from(PATHS), ODD, max_size=2),
    st.dictionaries(
        st.sampled_from(["name", "title", "ugv.0.trajectory", "custom.path"]), st.text()
    ),
    st.fixed_dictionaries(
        {}, optional={"detections.noise": st.floats(0.0, 1.0), "seed": st.integers(0, 2**53 - 1)}
    ),
)
def test_a_scenario_that_loads_is_written_and_read_the_same(
    tmp_path: Path, odd: dict[str, Any], texts: dict[str, str], numbers: dict[str, Any]
) -> None:
    texts |= {"ugv.0.script": [{"time": 0.0, "velocity": [0.1, 0.0]}]}  # instead of the trajectory
    try:
        scenario = load_scenario("escort", overrides=odd | texts | numbers)
    except ScenarioError:
        return
    assert_written_and_read_the_same(scenario, tmp_path / "any.toml")


def test_recorded_links_and_tracks_keep_their_content(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("link.csv").write_text(TRACE, encoding="utf-8")
    rows = "".join(f"{0.05 * n},0.1,0.0\n" for n in range(4))
    Path("track.csv").write_text(
        f"time [s],ugv_0.vx [m/s],ugv_0.vy [m/s]\n{rows}", encoding="utf-8"
    )
    changes = [
        "links.detections.trace=link.csv",
        "ugv.0.driver=script",
        "ugv.0.trajectory=track.csv",
    ]
    only = 'links.only=[{vehicle = "uav_0", commands = {profile = "lte"}}]'
    scenario = load_scenario("escort", overrides=[*changes, only])
    for file in ("link.csv", "track.csv"):
        Path(file).unlink()
    assert scenario.links.only[0].commands.delay == PROFILES["lte"].delay
    assert_written_and_read_the_same(scenario, tmp_path / "any.toml")


def test_every_vehicle_can_be_changed_at_once() -> None:
    scenario = load_scenario("escort", overrides={"uav.*.max_speed": 0.5, "ugv.*.max_speed": 0.1})
    assert (scenario.uav[0].max_speed, scenario.ugv[0].max_speed) == (0.5, 0.1)
    with pytest.raises(ScenarioError, match="uav has no entries"):
        load_scenario("minefield", overrides=["uav=[]", "uav.*.max_speed=0.5"])


def test_a_run_leaves_a_file_that_flies_the_same_run_again(here: Path, command: Any) -> None:
    """The user's own function flies in the vehicle's process."""
    (here / "careful_weighting.py").write_text(
        "def careful(distance, r_s):\n    share = min(distance / r_s, 1.0)\n    return share, 1.0 - share\n",
        encoding="utf-8",
    )
    own = ("--set", "detections.noise=0.1", "--set", "custom.weighting=careful_weighting:careful")
    options = ("--law", "weighted", "--duration", "2", "--seed", "5", "--network", "wifi-poor")
    again = ("--in-process", "--allow-code", "--no-files", "--json")
    flown = [
        command("run", "escort", *own, *options, "--no-picture", "--out", "first", "--json"),
        command("run", "first/scenario.toml", *again),
    ]
    assert [run.returncode for run in flown] == [0, 0], flown[-1].stderr
    hashes = {json.loads(run.stdout)["trajectory_sha256"] for run in flown}
    assert len(hashes) == 1


def test_the_simulator_alone_reads_the_scenario(monkeypatch: pytest.MonkeyPatch) -> None:
    """A vehicle receives endpoint, credential and its own code; goals and seed reach no other process."""
    child, started_with = launch.Child, dict[str, tuple[list[str], Start]]()

    def recorded_child(name: str, arguments: list[str], start: Start, **_: Any) -> launch.Child:
        started_with[name] = (arguments, start)
        if name == "ugv_0":
            raise BusError("all have been started")
        return create_autospec(child, instance=True)

    monkeypatch.setattr(launch, "Child", recorded_child)
    code = msgspec.structs.replace(SHORT.custom, weighting="mine:weighting", policy="mine:policy")
    with pytest.raises(BusError, match="all have been started"):
        launched(scenario=msgspec.structs.replace(SHORT, custom=code))
    (file,) = (word for word in started_with["simulator"][0] if word.endswith(".toml"))
    for name, own in (("uav_0", "weighting"), ("ugv_0", "policy")):
        arguments, start = started_with[name]
        assert file not in " ".join(arguments)
        assert {field: value for field, value in start.code.items() if value} == {
            own: f"mine:{own}"
        }
        plain = msgspec.structs.replace(start, credential=None, code={})
        assert plain == Start(join_timeout=SHORT.run.join_timeout)
    assert started_with["simulator"][1].code == {}
