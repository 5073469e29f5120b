"""Age of the newest measurement up to which a tick is certified."""

from agents.safety.decision import decide
from agents.safety.handover import certificate
from agents.safety.memory import add_measurement, add_position, filter_memory
from bus.messages.decision import NotCertified
from bus.messages.scenario import SafetyParameters
from sim.compiling.records import choice
from sim.models.safety import safety_bounds
from sim.models.vehicles import State


def test_a_measurement_certifies_for_exactly_its_declared_age() -> None:
    """A resting UAV above its UGV: 20 ticks of 0.05 s are the declared second, the next is too old."""
    declared = SafetyParameters(max_measurement_error=0.1, max_measurement_age=1.0)
    vehicles = {"visibility_radius": 4.75, "v_a": 0.6, "u_a": 0.3, "v_g": 0.2}
    bounds = certificate(safety_bounds(declared, dt=0.05, **vehicles))
    memory, own = filter_memory(bounds.delay_ticks, depth=100), State(20.0, 20.0, 0.0, 0.0)
    reasons = []
    for tick in range(24):
        add_position(memory, tick, own.p_x, own.p_y)
        if tick == 0:
            add_measurement(bounds, memory, 0, (0.0, 0.0), tick, own)
        decide(bounds, memory, tick, own, 0.0, 0.0)
        reasons.append(choice(NotCertified, int(memory.decision[0]["reason"])))
    assert reasons == [None] * 21 + [NotCertified.MEASUREMENT_TOO_OLD] * 3
