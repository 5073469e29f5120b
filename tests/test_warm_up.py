"""All that an operator can switch on is compiled or loaded before the first tick: no tick of a flight waits for it."""

import json
import signal
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from bus.keys import CONTROL, Role
from bus.messages.control import Action, Control
from bus.messages.links import LinkKind, LinkSettings
from bus.messages.scenario import Law
from bus.registry import DEFAULT_DRIVER, DEFAULT_LAW, TELEOP
from processes import (
    await_status,
    child_of,
    command_line,
    family,
    joined,
    kind_of,
    python,
    started,
    wait_until,
)

PREPARE = """
import sys
import msgspec
from agents.process import warm_up as warm_up_pilot
from bus.keys import Role
from bus.messages.control import Action, Control
from outrider.running.flying import fly
from outrider.running.assumptions import assumption_warnings
from sim.models.vehicles import clip_norm
from sim.scenario.loading import load_scenario
from sim.server.flight import warm_up

scenario = load_scenario("escort", overrides={"duration": 12.0})
assumption_warnings(scenario)  # as the simulator's process does before it listens
warm_up(scenario)
for role in (Role.UAV, Role.UGV):
    warm_up_pilot(role)

def compiled():
    # the signatures of each function
    functions = {
        id(one): one
        for module in tuple(sys.modules.values())
        if module.__name__.partition(".")[0] in ("sim", "agents", "outrider")
        for one in vars(module).values()
        if hasattr(one, "signatures")
    }
    return {(one.__module__, one.__name__, str(types)) for one in functions.values() for types in one.signatures}
"""
FLY = """
controls = msgspec.json.decode(sys.argv[1], type=list[Control])

def control(flight):
    if flight.world.tick % 5 == 0 and controls:
        asked = controls.pop(0)
        if asked.action is Action.LINK:
            flight.degrade(asked.link, None, asked.settings)
        elif asked.action is Action.LAW:
            flight.order(asked.law)
        elif asked.action is Action.DRIVER:
            flight.assign_driver("ugv_0", asked.driver)
        assumption_warnings(flight.flown, flight.world.link_table)  # as observers are told

before = compiled()
flight, _ = fly(scenario, 7, on_tick=control)
late = compiled()
clip_norm(1, 0, 1)  # of whole numbers, as nobody else asks for
print(not controls, flight.world.tick, sorted(late - before), len(compiled()) > len(late))
"""


def every_control() -> Iterator[Control]:
    """Each control that an operator has, once: links, laws, drivers, and the clock.

    Other laws and drivers are compiled when they are flown first.
    """
    for kind in LinkKind:
        for settings in (
            LinkSettings(
                delay=0.4, jitter=0.3, loss=0.2, duplicates=0.1, reorder=0.1, reorder_delay=0.1
            ),
            LinkSettings(
                blackouts=((1.0, 5.0),),
                bandwidth=5.0,
                queue=2,
                burst_length=0.3,
                burst_interval=2.0,
            ),
            LinkSettings(blackouts=((0.0, 1e4),)),
            LinkSettings(),
        ):
            yield Control(action=Action.LINK, link=kind, settings=settings)
    for law in ("certified", DEFAULT_LAW):
        yield Control(action=Action.LAW, law=Law(name=law))
    for driver in (TELEOP, DEFAULT_DRIVER):
        yield Control(action=Action.DRIVER, driver=driver)
    yield Control(action=Action.PAUSE)
    yield Control(action=Action.STEP, ticks=3)
    yield Control(action=Action.RESUME)
    yield Control(action=Action.SPEED, factor=2.0)


@pytest.mark.timeout(300)
def test_no_control_of_an_operator_makes_anybody_compile_or_load():
    controls = msgspec.json.encode([*every_control()]).decode()
    run = python(PREPARE + FLY, controls, check=False)
    assert run.stdout.split() == ["True", "240", "[]", "True"], run.stdout + run.stderr


@pytest.mark.long
@pytest.mark.timeout(900)
def test_no_control_makes_a_tick_late_in_real_time_on_a_cold_cache(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("OUTRIDER_CACHE", str(tmp_path / "cache"))
    words = ("escort", "--realtime", "1", "--duration", "20000", "--no-files", "--json")
    with started("run", *words) as run:
        wait_until(lambda: "simulator" in map(kind_of, family(run.pid)), 300.0)
        words_of = command_line(child_of(run, "simulator")).split()
        socket = words_of[words_of.index("--listen") + 1].removeprefix("unixsock-stream/")
        wait_until(lambda: Path(socket).exists(), 300.0)  # it compiles before it listens
        with joined(run, Role.OPERATOR) as operator:
            await_status(operator, lambda status: status.tick > 5, 300.0)
            controls = operator.outbox(CONTROL)
            for control in every_control():
                controls.send(control)
                await_status(
                    operator, lambda s, c=control: bool(s.changes) and s.changes[-1].control == c
                )
            controls.send(Control(action=Action.RESET, seed=3))
            await_status(operator, lambda status: status.seed == 3 and 20 < status.tick < 400)
        run.send_signal(signal.SIGINT)
        told, warned = run.communicate(timeout=60.0)
    steered = warned.partition("an operator:")[2]  # a start may wait for a busy machine
    assert "behind" not in steered, warned  # a clock that is late by more than a second says so
    assert json.loads(told)["seed"] == 3
