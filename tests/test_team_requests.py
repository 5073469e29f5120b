"""Requests of an operator to the UAVs of a team: come and guard, and be relieved."""

import json
from pathlib import Path
from typing import Any

import msgspec
import pytest

from agents.uav import UavPilot
from bus.errors import ScenarioError
from bus.keys import CONTROL
from bus.keys import Role as PartyRole
from bus.messages.control import Action, Change, Control
from bus.messages.team import Request, Role, TeamMessage
from bus.messages.telemetry import Status
from bus.messages.vehicle import UavObservation
from outrider.recording.reader import flight_of
from outrider.recording.refly import refly
from outrider.recording.writer import FlightRecorder
from outrider.running.flying import InProcess, fly, make_pilots
from processes import await_status, family, joined, kind_of, started, wait_until
from sim.engine.briefing import briefing
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario
from sim.server.flight import Flight

COARSE = {"area.cell": 0.5}


def team(name: str = "scouts", duration: float = 30.0, **changes: Any) -> Scenario:
    given = {key.replace("__", "."): value for key, value in changes.items()}
    return load_scenario(name, overrides=COARSE | {"duration": duration} | given)


def fly_with(
    scenario: Scenario, requests: dict[int, tuple[str, Request]]
) -> tuple[Flight, dict[str, list[Role | None]]]:
    """Fly with requests at fixed ticks; return also the role of each UAV in each tick."""
    roles: dict[str, list[Role | None]] = {uav.name: [] for uav in scenario.uav}

    def on_tick(flight: Flight) -> None:
        for name, seen in roles.items():
            seen.append(flight.answers.roles().get(name))
        if flight.world.tick in requests:
            flight.request(*requests[flight.world.tick])

    return fly(scenario, 7, on_tick=on_tick)[0], roles


def assert_never_unguarded(flight: Flight) -> None:
    status = flight.answers.teams.status()
    assert status is not None
    assert status.team_certified_share == 1.0
    assert status.team_certified_while_lost == status.team_certificate_broken == 0
    assert (status.team_out_of_sight, status.left_without_relief) == (0, 0)


@pytest.mark.parametrize(("name", "free"), [("scouts", Role.SCOUT), ("relay", Role.AWAY)])
def test_a_guard_is_relieved_at_request_and_guards_until_then(name: str, free: Role) -> None:
    flight, roles = fly_with(team(name), {200: ("uav_0", Request.RELIEF)})
    assert_never_unguarded(flight)
    ended = roles["uav_0"].index(free, 100)
    assert ended > 200
    assert set(roles["uav_0"][100:ended]) == {Role.GUARD}
    assert Role.GUARD in {roles[mate][ended - 1] for mate in ("uav_1", "uav_2")}
    assert set(roles["uav_0"][ended:]) == {free}  # the request is not repeated


@pytest.mark.parametrize("name", ["scouts", "relay"])
def test_a_called_uav_takes_over(name: str) -> None:
    flight, roles = fly_with(team(name), {200: ("uav_2", Request.GUARD)})
    assert_never_unguarded(flight)
    assert roles["uav_2"][199] is Role.SCOUT
    assert roles["uav_2"][201] is Role.RELIEF
    assert roles["uav_2"][-1] is Role.GUARD
    assert roles["uav_0"][-1] is not Role.GUARD


def test_requests_over_a_dead_link_only_add_a_guard() -> None:
    scenario = team(links__team__loss=1.0, duration=20.0)
    flight, roles = fly_with(scenario, {200: ("uav_0", Request.RELIEF)})
    assert_never_unguarded(flight)
    assert all(set(one[150:]) == {Role.GUARD} for one in roles.values())


def test_a_called_uav_that_charges_waits_for_a_sufficient_charge() -> None:
    scenario = team("relay")
    pilot = UavPilot(briefing(scenario, "uav_1", 7))  # type: ignore[arg-type] - of a UAV
    base = next(uav.base for uav in scenario.uav if uav.name == "uav_1")
    assert base is not None
    assert pilot.team is not None
    roles = []
    for tick, charge in enumerate((299.0, 299.0, 5.0, 5.0, 299.0)):
        guard = TeamMessage(
            sender="uav_0",
            tick=tick,
            number=31,
            role=Role.GUARD,
            certified=True,
            position=(10.0, 10.0),
            measured=tick,
            measurement=(10.0, 10.0),
        )
        pilot.act(
            UavObservation(
                tick=tick,
                time=tick * 0.05,
                position=(base[0] + 2.0, base[1]),
                velocity=(0.0, 0.0),
                team=(guard,),
                charge=charge,
                request=Request.GUARD if tick == 3 else None,
            )
        )
        roles.append(pilot.team.role)
    assert roles == [Role.AWAY, Role.AWAY, Role.AWAY, Role.AWAY, Role.RELIEF]


@pytest.mark.parametrize(
    ("scenario", "uav", "request_", "said"),
    [
        ("scouts", "uav_9", Request.GUARD, "vehicle = 'uav_9': unknown"),
        ("scouts", "ugv_0", Request.GUARD, "vehicle = 'ugv_0': not a UAV; allowed: uav_0, uav_1"),
        ("escort", "uav_0", Request.GUARD, "it has no team; allowed: scenarios with [team]"),
        ("scouts", "uav_0", Request.GUARD, "uav_0 is already a guard; allowed: RELIEF"),
        ("scouts", "uav_1", Request.RELIEF, "uav_1 is no guard, its role is SCOUT"),
        ("three", "uav_1", Request.RELIEF, "all 3 guard (team.guards = 3)"),
    ],
)
def test_impossible_request_raises(scenario: str, uav: str, request_: Request, said: str) -> None:
    guards = {"team.guards": 3} if scenario == "three" else {}
    name = "scouts" if scenario == "three" else scenario
    given = load_scenario(name, overrides=COARSE | {"duration": 5.0} | guards)
    raised: list[str] = []

    def on_tick(flight: Flight) -> None:
        if flight.world.tick == 90:
            with pytest.raises(ScenarioError) as error:
                flight.request(uav, request_)
            raised.append(str(error.value))

    fly(given, 7, on_tick=on_tick)
    (text,) = raised
    assert said in text
    assert "\n" not in text


class Requested(InProcess):
    """Pilots of a flight with one request, before the observations of its tick."""

    def __init__(self, flight: Flight, at: int, uav: str, request: Request) -> None:
        super().__init__(make_pilots(flight.scenario, flight.seed))
        self._flight, self._at, self._given = flight, at, (uav, request)

    def begin(self, tick: int) -> None:
        if tick == self._at:
            self._flight.request(*self._given)


def test_recording_contains_requests_and_flies_again(tmp_path: Path) -> None:
    scenario, path = team(duration=10.0), tmp_path / "run.mcap"
    flight, recorder = Flight(scenario, 7), FlightRecorder(path, scenario, 7)
    exchange = Requested(flight, 100, "uav_0", Request.RELIEF)
    flight.fly(exchange, on_tick=lambda: recorder.tick(flight))
    recorder.close()
    recording = flight_of(path)
    control = Control(action=Action.REQUEST, vehicle="uav_0", request=Request.RELIEF)
    assert recording.changes == [Change(tick=100, control=control)]
    again = refly(recording)
    assert again.difference is None
    assert (
        again.trajectory_sha256 == flight.recorder.sha256() != fly(scenario, 7)[0].recorder.sha256()
    )


@pytest.mark.usefixtures("nothing_left_behind")
def test_operator_requests_a_hand_over_from_separate_processes() -> None:
    """Over real sessions: both requests are certified throughout, and the run flies again to the last bit."""
    scenario = load_scenario("scouts", overrides={"duration": 30.0})
    relief = Control(action=Action.REQUEST, vehicle="uav_0", request=Request.RELIEF)
    call = Control(action=Action.REQUEST, vehicle="uav_2", request=Request.GUARD)
    with started("run", "scouts", "--duration", "30", "--no-files", "--json") as run:
        wait_until(lambda: "simulator" in map(kind_of, family(run.pid)))
        with joined(run, PartyRole.OPERATOR) as operator:
            controls = operator.outbox(CONTROL)
            wait_until(lambda: controls.wanted, 180.0)  # compiling from an empty cache

            def step(tick: int) -> Status:
                controls.send(Control(action=Action.STEP, ticks=100))
                return await_status(operator, lambda s: s.paused and s.tick >= tick, 180.0)

            assert step(100).roles["uav_0"] is Role.GUARD
            controls.send(relief)
            assert step(200).roles["uav_0"] is Role.SCOUT
            controls.send(call)
            controls.send(Control(action=Action.RESUME))
            out, err = run.communicate(timeout=120)
    assert run.returncode == 0, err
    summary = json.loads(out)
    found = summary["team"]
    assert found["team_certified_share"] == 1.0
    assert found["team_certified_while_lost"] == found["team_certificate_broken"] == 0
    assert found["handovers"] >= 2
    changes = [msgspec.convert(one, Change) for one in summary["changes"]]
    asked = {c.tick: c.control for c in changes if c.control.action is Action.REQUEST}
    assert [*asked.values()] == [relief, call]

    def on_tick(flight: Flight) -> None:
        if (control := asked.get(flight.world.tick)) and control.vehicle and control.request:
            flight.request(control.vehicle, control.request)

    again = fly(scenario, scenario.seed, on_tick=on_tick)[1]
    assert summary["trajectory_sha256"] == again.trajectory_sha256
