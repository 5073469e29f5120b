"""The channel in a run: what crosses it, when it arrives, and the same network in every environment."""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from bus.messages.control import Action, Control
from bus.messages.links import LinkKind, LinkSettings
from bus.messages.vehicle import RelativeInformation, Teleoperation, UavCommand, UgvCommand
from bus.profiles import PROFILES
from flights import degraded, escort
from outrider.envs.env_pilots import pilots
from outrider.envs.parallel import parallel_env
from outrider.running.flying import fly
from outrider.running.resolve import resolve
from refusals import SMALL, refusal
from sim.scenario.loading import load_scenario
from sim.scenario.resolved import as_toml, read_resolved
from sim.scenario.types import Detections, LinkTable
from sim.scenario.vehicle_types import Ugv
from sim.server.flight import Flight
from staging import stage


def moving(links: LinkTable, **fields: Any) -> Flight:
    ugv = Ugv(position=(20.0, 20.0), goals=((30.0, 20.0),))
    return Flight(escort(links=links, ugv=ugv, duration=20.0, **fields), 3)


def test_links_have_their_profile_and_the_changes_to_it(tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text(
        '[links]\nprofile = "lte"\n[links.commands]\nprofile = "wifi"\ndelay = 0.4\n'
        '[[links.only]]\nvehicle = "uav_0"\ncommands = { loss = 0.1 }\n' + SMALL
    )
    links = load_scenario(tmp_path / "own.toml", overrides=["links.radio.loss=0.5"]).links
    lte, with_ = PROFILES["lte"], msgspec.structs.replace
    assert links.detections == links.operator == links.of("uav_0", LinkKind.DETECTIONS) == lte
    assert links.radio == with_(lte, loss=0.5)
    commands = with_(PROFILES["wifi"], delay=0.4)
    assert links.commands == links.of("ugv_0", LinkKind.COMMANDS) == commands
    assert links.of("uav_0", LinkKind.COMMANDS) == with_(commands, loss=0.1)


RADIOS = "[profile.near]\ndelay = 0.01\n[profile.far]\ndelay = 0.2\nloss = 0.1\n"


def test_links_have_the_profile_of_a_file(tmp_path, monkeypatch) -> None:
    """The user names files relative to the current folder, a scenario relative to its own."""
    for folder in ("own", "here/sub"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "own" / "radios.toml").write_text(RADIOS)
    (tmp_path / "here" / "one.toml").write_text("[profile.slow]\ndelay = 0.3\n")
    own = '[links]\nprofile = "radios.toml:near"\n[links.radio]\nprofile = "radios.toml:far"\ndelay = 0.4\n'
    (tmp_path / "own" / "own.toml").write_text(own + SMALL)
    monkeypatch.chdir(tmp_path / "here")
    links = load_scenario("../own/own.toml", overrides=["links.commands.profile=one.toml"]).links
    assert links.detections == LinkSettings(delay=0.01)
    assert links.radio == LinkSettings(delay=0.4, loss=0.1)
    assert links.commands == LinkSettings(delay=0.3)
    resolved, _ = resolve("escort", network="../own/radios.toml:far")
    assert resolved.links.team == LinkSettings(delay=0.2, loss=0.1)
    again = tmp_path / "again.toml"
    again.write_text(as_toml(resolved))
    (tmp_path / "own" / "radios.toml").unlink()
    assert read_resolved(again) == resolved


@pytest.mark.parametrize(
    ("text", "given", "phrase"),
    [
        (RADIOS, "radios.toml", "several profiles; allowed: radios.toml:near, radios.toml:far"),
        (RADIOS, "radios.toml:fat", "no such profile in the file, did you mean 'far'?"),
        (RADIOS, "radio.toml", "cannot be read: No such file"),
        ("[profile.Far]", "radios.toml", "profile.Far: not a name"),
        ("[profile.far]\ndelya = 1.0", "radios.toml", "profile.far.delya = 1.0: unknown field, did you"),
        ("[profile.far]\nloss = 2.0", "radios.toml", "profile.far.loss = 2.0: out of bounds"),
        ("[profile.far]\nreorder = 0.1", "radios.toml", "profile.far.reorder_delay = 0.0: reordered"),
        ('[profile.far]\ntrace = "x.csv"', "radios.toml", "a profile cannot name a trace"),
        ("[profile]\nfar = 3", "radios.toml", "profile.far = 3: not a table"),
        ("profile = 3", "radios.toml", "profile = 3: no table of profiles"),
        ("[links]\ndelay = 1", "radios.toml", "profile: missing; allowed: tables [profile.NAME]"),
        (RADIOS + "[links]", "radios.toml:far", "links = {}: unknown field"),
        ("[profile", "radios.toml", "radios.toml: not TOML"),
    ],
)  # fmt: skip
def test_bad_file_of_profiles_is_refused(text, given, phrase, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "radios.toml").write_text(text)
    assert phrase in refusal(overrides=[("links.profile", given)])


def test_scenario_names_profiles_in_its_own_folder_only(tmp_path: Path) -> None:
    (tmp_path / "radios.toml").write_text(RADIOS)
    (tmp_path / "sub").mkdir()
    own = tmp_path / "sub" / "own.toml"
    own.write_text('links = { profile = "../radios.toml:far" }\n' + SMALL)
    assert "outside the scenario's folder" in refusal(own)


def test_a_detection_comes_late_and_says_when_it_was_taken() -> None:
    flight = moving(LinkTable(detections=LinkSettings(delay=0.5)), detections=Detections(noise=0.0))
    seen = []
    for _ in range(30):
        seen.append(flight.observations()["uav_0"])
        flight.apply({"ugv_0": UgvCommand(tick=flight.world.tick, acceleration=(0.1, 0.0))})
    assert not any(observation.detections for observation in seen[:10])
    for tick in range(10, 30):
        (detection,) = seen[tick].detections
        assert detection.time == (tick - 10) * 0.05


def test_vehicle_keeps_a_late_command_and_then_brakes() -> None:
    late = moving(LinkTable(commands=LinkSettings(delay=0.2)))
    applied = []
    for tick in range(12):
        late.apply({"uav_0": UavCommand(tick=tick, acceleration=(0.01 * (tick + 1), 0.0))})
        applied.append(late.world.acceleration[0, 0])
    assert applied == pytest.approx([0.0] * 4 + [0.01 * (k + 1) for k in range(8)])

    interrupted = moving(LinkTable(commands=LinkSettings(blackouts=((0.5, 5.0),))))
    speeds = []
    for tick in range(60):
        interrupted.apply({"uav_0": UavCommand(tick=tick, acceleration=(0.2, 0.0))})
        speeds.append(float(interrupted.world.velocity[0, 0]))
    last = 10 + 10 - 1  # ten ticks arrived; the last command counts for half a second more
    assert speeds[last] == pytest.approx(0.2 * 0.05 * (last + 1))
    assert speeds[last + 1] < speeds[last]
    assert speeds[-1] == 0.0
    assert interrupted.answers.missing["uav_0"] == 0  # its process was in time, the network was not
    assert interrupted.answers.first_missing == 0  # the UGV's process was not


def test_a_command_that_was_overtaken_is_not_flown_any_more() -> None:
    flight = moving(LinkTable(commands=LinkSettings(reorder=0.5, reorder_delay=0.3)))
    flown = []
    for tick in range(100):
        flight.apply({"uav_0": UavCommand(tick=tick, acceleration=(0.001 * (tick + 1), 0.0))})
        flown.append(float(flight.world.commands[0, 0]))
    assert flight.world.links.status()["uav_0/commands"].delivered > 90
    assert flown == sorted(flown)
    assert len(set(flown)) < 80  # many arrived too late to be flown


def test_operators_and_radio_come_late() -> None:
    flight = moving(LinkTable(operator=LinkSettings(delay=0.3), radio=LinkSettings(delay=0.2)))
    message = RelativeInformation(time=0.0, relative_position=(1.0, 0.0), coverage_error=1.0)
    flight.teleoperate("ugv_0", Teleoperation(operator="me"))
    operator, radio = [], []
    for tick in range(12):
        seen = flight.observations()["ugv_0"]
        operator.append(bool(seen.operator))
        radio.append(bool(seen.radio))
        fields = {"radio": (message,) if tick == 0 else ()}
        flight.apply({"uav_0": UavCommand(tick=tick, acceleration=(0.0, 0.0), **fields)})
    assert (operator.index(True), sum(operator)) == (6, 1)
    assert (radio.index(True), sum(radio)) == (5, 1)


def test_one_network_for_the_environment_one_process_and_three(tmp_path: Path) -> None:
    scenario = degraded(400)
    flight, summary = fly(scenario, 7)
    assert summary.links["uav_0/commands"].lost["burst"] > 10
    assert summary.links["uav_0/detections"].max_age > 0.1
    env = parallel_env(scenario, end_on_sight_lost=False)
    observations, _ = env.reset(seed=7)
    policies = pilots(env)
    while env.agents:
        observations, _, _, _, infos = env.step(
            {name: policies[name](observations[name]) for name in env.agents}
        )
        # the counters of sent messages would reveal future arrivals
        assert infos == {"uav_0": {}, "ugv_0": {"goals_reached": 0}}
    assert np.array_equal(env.world.position, flight.world.position)
    assert np.array_equal(env.world.velocity, flight.world.velocity)
    assert env.links()["uav_0/detections"].lost == summary.links["uav_0/detections"].lost
    with stage(tmp_path, 400, scenario=scenario) as run:
        run.start_both()
        over_bus = run.fly()
    assert over_bus.recorder.sha256() == summary.trajectory_sha256
    assert over_bus.world.links.status() == summary.links


def test_an_operator_degrades_a_link_while_it_flies(tmp_path: Path) -> None:
    with stage(tmp_path, 100_000) as run:
        run.start_both()

        def work(send: Any, status: Any) -> None:
            def degrade(kind: LinkKind, **more: Any) -> None:
                send(Control(action=Action.LINK, link=kind, **more))

            status(lambda s: s.tick > 50 and s.certified == {"uav_0": True} and not s.uncertified)
            degrade(LinkKind.DETECTIONS, settings=LinkSettings(loss=1.0))
            status(
                lambda s: (
                    s.certified == {"uav_0": False}
                    and s.uncertified["uav_0"] == "MEASUREMENT_TOO_OLD"
                )
            )
            status(lambda s: s.links["uav_0/detections"].lost["loss"] > 100)
            for phrase, kind, more in (
                ("has no link", LinkKind.RADIO, {"vehicle": "ugv_0", "settings": LinkSettings()}),
                ("bursts never end", LinkKind.RADIO, {"settings": LinkSettings(burst_length=1.0)}),
                ("both are required", LinkKind.DETECTIONS, {}),
            ):
                degrade(kind, **more)
                status(lambda s, phrase=phrase: any(phrase in one.reason for one in s.rejections))
            run.server.flight.stop()

        flight = run.fly(operator=work)
    assert [change.control.link for change in run.server.changes] == [LinkKind.DETECTIONS]
    assert flight.world.links.status()["uav_0/detections"].settings == LinkSettings(loss=1.0)
