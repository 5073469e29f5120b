"""What an operator can switch on is compiled or loaded before the first tick: no tick of a live flight waits for it."""

import pytest
from processes import python

PREPARE = """
import msgspec
import numba
import numba.core.event as events
from agents.process import warm_up as warm_up_pilot
from bus.keys import Role
from bus.messages import Law, LinkKind, LinkSettings
from bus.registry import DRIVERS, LAWS
from outrider.running.flying import fly
from outrider.running.promise import promise_warnings
from sim.kernels.compile import compiling
from sim.scenario.loading import load_scenario
from sim.server.flight import warm_up

scenario = load_scenario("escort", overrides={"duration": 12.0})
promise_warnings(scenario)  # as the simulator's process does before it listens
with compiling():
    warm_up(scenario)
    for role in (Role.UAV, Role.UGV):
        warm_up_pilot(role)

class Heard(events.Listener):
    def __init__(self):
        self.names = []
    def on_start(self, event):
        self.names.append(str(event.data["dispatcher"]))
    def on_end(self, event):
        pass
"""
FLY = """
SETTINGS = (
    LinkSettings(delay=0.4, jitter=0.3, loss=0.2, duplicates=0.1, reorder=0.1, reorder_delay=0.1),
    LinkSettings(blackouts=((1.0, 5.0),), bandwidth=5.0, queue=2, burst_length=0.3, burst_interval=2.0),
    LinkSettings(),
)
steps = [
    lambda flight, kind=kind, settings=settings: flight.degrade(kind, None, settings)
    for kind in LinkKind for settings in SETTINGS
]
steps += [
    lambda flight, law=law: flight.order(Law(name=law.name)) for law in LAWS.values() if not law.own
]
steps += [
    lambda flight, name=row.name: flight.assign_driver("ugv_0", name)
    for row in DRIVERS.values() if not (row.own or row.outside or row.needs)
]

def control(flight):
    if flight.world.tick % 5 == 0 and steps:
        steps.pop(0)(flight)
        promise_warnings(flight.scenario)

heard = Heard()
with events.install_listener("numba:compile", heard):
    flight, _ = fly(scenario, 7, on_tick=control)
    late = numba.njit(lambda x: x + 1)
    before = len(heard.names)
    late(1)
print(not steps, flight.world.tick, heard.names[:before], len(heard.names) - before)
"""


@pytest.mark.timeout(300)
def test_no_control_of_an_operator_makes_anybody_compile():
    run = python(PREPARE + FLY, check=False)
    assert run.stdout.split() == ["True", "240", "[]", "1"], run.stdout + run.stderr
