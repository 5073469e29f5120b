"""Laws of single UAVs: briefing, options, checks, supervision and an operator's change."""

from typing import Any

import pytest

from bus.errors import ScenarioError
from bus.messages.scenario import Law
from outrider.closed_loop.closed_loop import ClosedLoop
from outrider.experiments.sweep.definition import Block, Sweep, checked
from outrider.experiments.sweep.plan import lay_out
from outrider.running.assumptions import assumption_warnings, how_certifiable
from outrider.running.flying import InProcess, fly, make_pilots
from outrider.running.resolve import resolve
from sim.engine.briefing import uav_briefing
from sim.scenario.laws import law_title
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario
from sim.server.flight import Flight

PAIR: dict[str, Any] = {
    "uav": [{"position": [7.0, 9.0]}, {"position": [8.2, 9.0]}],
    "area.cell": 0.5,
    "duration": 5.0,
    "law.name": "logarithmic",
}


def pair(**changes: Any) -> Scenario:
    given = {key.replace("__", "."): value for key, value in changes.items()}
    return load_scenario("escort", overrides=PAIR | given)


def test_each_uav_is_briefed_on_its_own_law() -> None:
    own = pair(
        law__name="circle",
        law__parameters={"circle_rate": 0.05, "a_c": -3.5},
        uav__1__law={"name": "coverage", "parameters": {"a_c": -4.0}},
    )
    briefed = [uav_briefing(own, uav.name, 0).law for uav in own.uav]
    common = {"circle_rate": 0.05, "a_c": -3.5}
    assert briefed[0] == Law(name="circle", parameters=common)
    assert briefed[1] == Law(name="coverage", parameters=common | {"a_c": -4.0})
    assert law_title(own) == "circle, uav_1 coverage"
    only = pair(uav__1__law={"parameters": {"speed_gain": 5.0}})
    assert law_title(only) == "logarithmic"
    assert only.law_of(only.uav[1]).parameters == only.law.parameters | {"speed_gain": 5.0}


def test_an_own_law_equal_to_the_scenario_s_flies_the_same_bits() -> None:
    named = {f"uav.{k}.law.name": "switching" for k in range(2)}
    first = fly(pair(law__name="switching"), 3)[1]
    again = fly(load_scenario("escort", overrides=PAIR | named), 3)[1]
    assert again.trajectory_sha256 == first.trajectory_sha256
    assert again.law == "uav_0 switching, uav_1 switching"
    mixed = fly(pair(law__name="switching", uav__1__law__name="tracking"), 3)[1]
    assert mixed.trajectory_sha256 != first.trajectory_sha256
    assert mixed.law == "switching, uav_1 tracking"


def test_the_option_law_replaces_the_laws_of_all_uavs() -> None:
    changes = ["uav.1.law.name=circle", "uav.1.law.parameters.circle_rate=0.05"]
    uavs = "uav=[{position=[7, 9]}, {position=[8.2, 9]}]"
    kept, _ = resolve("escort", changes=[uavs, *changes])
    assert [kept.law_of(uav).name for uav in kept.uav] == ["certified", "circle"]
    replaced, _ = resolve("escort", changes=[uavs, *changes], law="switching")
    assert {replaced.law_of(uav).name for uav in replaced.uav} == {"switching"}
    missing, _ = resolve("escort", changes=[uavs, "uav.0.law.name=path"], law="certified")
    assert law_title(missing) == "certified"
    learned, _ = resolve("escort", changes=[uavs, *changes], uav_policy="outrider:run")
    assert law_title(learned) == "certified, uav_1 circle"
    no_policy = [uavs, *changes, "law.name=switching"]
    assert (
        law_title(resolve("escort", changes=no_policy, uav_policy="outrider:run")[0]) == "certified"
    )


def test_a_sweep_flies_own_laws_unless_it_names_laws() -> None:
    changed = {"uav": PAIR["uav"], "uav.1.law.name": "tracking", "duration": 5.0}
    own = lay_out(checked(Sweep(scenario="escort", set=changed), file="sweep"))
    assert [point.law for point in own.points] == ["certified, uav_1 tracking"]
    given = Sweep(scenario="escort", set=changed, laws=("circle", "linear"))
    assert [p.law for p in lay_out(checked(given, file="sweep")).points] == ["circle", "linear"]
    varied = Sweep(
        scenario="escort", laws=("circle",), block=(Block(vary={"uav.0.law.name": ["linear"]}),)
    )
    with pytest.raises(ScenarioError, match=r"either laws or uav\.0\.law\.name"):
        checked(varied, file="sweep")


def test_each_uav_is_judged_with_its_own_law() -> None:
    mixed = pair(law__name="switching", uav__1__law__name="certified", detections__noise=0.1)
    assert how_certifiable(mixed) == "always"
    late = pair(uav__1__law__name="certified", links__detections__delay=2.0)
    assert how_certifiable(late) == "never"
    assert {line.partition(":")[0] for line in assumption_warnings(late)} == {"uav_1"}
    assert how_certifiable(pair(uav__1__law__name="switching")) is None
    flight, summary = fly(mixed, 3)
    assert summary.uavs["uav_0"].certified_share is None
    assert summary.uavs["uav_1"].certified_share == 1.0
    certificates = flight.answers.assurance.status()
    assert certificates is not None
    assert certificates.ticks == mixed.ticks
    assert not flight.answers.external


def test_an_operator_s_law_replaces_the_laws_of_all_uavs() -> None:
    flight = Flight(pair(uav__1__law__name="certified"), 3)
    exchange = InProcess(make_pilots(flight.scenario, flight.seed))
    for _ in range(20):
        flight.fly_tick(exchange)
    assert (flight.status().law, flight.status().laws) == ("logarithmic", {"uav_1": "certified"})
    assert set(flight.answers.reasons()) == {"uav_1"}
    assert flight.flown is flight.scenario
    flight.order(Law(name="switching"))
    for _ in range(5):
        flight.fly_tick(exchange)
    assert (flight.status().law, flight.status().laws) == ("switching", {})
    assert not flight.answers.reasons()
    assert law_title(flight.flown) == "switching"


def test_batches_fly_own_laws() -> None:
    mixed = pair(law__name="switching", uav__1__law__name="certified")
    loop = ClosedLoop(mixed, 2)
    assert loop.pilots is not None
    assert loop.pilots.tables.filtered.tolist() == [0, 1]
