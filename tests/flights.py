"""Scenarios for the tests of laws and worlds, and the law of a UAV without its pilot."""

import hashlib
from collections.abc import Callable, Mapping
from importlib import import_module
from types import ModuleType
from typing import Any, NamedTuple

import msgspec
import numpy as np

from agents.laws.inputs import LawInputs
from agents.process import Pilot
from agents.safety.handover import certificate
from agents.uav_parameters import Target, UavParameters, uav_parameters
from bus.law_parameters import law_parameters
from bus.messages.scenario import Area, Law, Limits, SafetyParameters
from bus.messages.vehicle import (
    Command,
    Detection,
    Observation,
    UavBriefing,
    UavObservation,
    UgvBriefing,
)
from bus.profiles import PROFILES
from bus.registry import BODIES, DEFAULT_BODY, LAWS
from outrider.envs.env_pilots import pilots
from outrider.envs.parallel import parallel_env
from outrider.running.flying import InProcess, fly, make_pilots
from outrider.running.summary import Summary
from seeded import key_text
from sim.compiling.compile import FloatArray
from sim.compiling.records import fresh, records
from sim.engine.briefing import uav_briefing
from sim.models.safety import SafetyBounds, safety_bounds
from sim.scenario.loading import load_scenario
from sim.scenario.types import LinkTable, Scenario
from sim.scenario.vehicle_types import Uav, Ugv
from sim.server.flight import Flight

V_A, U_A, V_G, U_G = 0.6, 0.3, 0.2, 0.1  # the paper's vehicles: speeds [m/s], accelerations [m/s²]
R, R_V, DESIRED = 5.0, 4.75, 2.0
R_O = R_V + R
R_S = R_V - (V_A + V_G) ** 2 / (2.0 * U_A)
DT = 0.05
DECLARED_BOUNDS = {"r_v": R_V, "v_a": V_A, "u_a": U_A, "v_g": V_G, "dt": DT}
"""The declared bounds of a certificate for these vehicles, except those of the detections."""


def certified(**numbers: float) -> SafetyBounds:
    """Return the safety bounds for these vehicles; the arguments are the letters of docs/explanation/proof.md."""
    n = DECLARED_BOUNDS | {"eps": 0.0, "age": 1.0} | numbers
    safety = SafetyParameters(
        max_measurement_error=n["eps"],
        max_measurement_age=n["age"],
        max_command_delay=n.get("delay", 0.0),
        max_command_interval=n.get("interval", 0.0),
        max_tracking_error=n.get("tracking", 0.0),
        margin=n.get("margin", 0.0),
    )
    area = {side: n[side] for side in ("width", "height") if side in n}
    bounds = {name: n[name] for name in ("v_a", "u_a", "v_g", "dt")}
    return certificate(safety_bounds(safety, visibility_radius=n["r_v"], **bounds, **area))


HERE = (20.0, 20.0)
UAV, UGV = Uav(position=HERE), Ugv(position=HERE)
"""The paper's vehicles at rest in the middle of the paper's area."""


def escort(law="logarithmic", *, uav=UAV, ugv=UGV, **fields):
    """Return a scenario with one UAV that escorts one UGV, and these fields."""
    return Scenario(
        law=Law(name=law) if isinstance(law, str) else law, uav=(uav,), ugv=(ugv,), **fields
    )


def pairs(uavs, ugvs, **fields):
    """Return UAVs and UGVs at these positions, or with these fields; by default, uav_k escorts ugv_k."""
    given = [[v if isinstance(v, dict) else {"position": v} for v in kind] for kind in (uavs, ugvs)]
    uav = (Uav(**{"name": f"uav_{k}", "escorts": f"ugv_{k}"} | v) for k, v in enumerate(given[0]))
    ugv = (Ugv(**{"name": f"ugv_{k}"} | v) for k, v in enumerate(given[1]))
    return Scenario(uav=(*uav,), ugv=(*ugv,), **fields)


def uav_sees(tick: int, *detections_of: Any, **fields: Any) -> UavObservation:
    """Return an observation of a UAV at rest in the middle, with these fields; detections as time [s] and p_a - p_g
    [m].
    """
    detections = tuple(
        Detection(time=time, relative_position=place) for time, place in detections_of
    )
    usual = {"time": tick * DT, "position": HERE, "velocity": (0.0, 0.0), "detections": detections}
    return UavObservation(tick=tick, **usual | fields)


def briefing_of(scenario: Scenario, seed: int = 0) -> UavBriefing:
    """Return the briefing of the scenario's UAV."""
    return uav_briefing(scenario, scenario.uav[0].name, seed)


def ugv_briefing(**fields: Any) -> UgvBriefing:
    """Return the briefing of the paper's UGV in a square of 20 m, with these fields."""
    usual: dict[str, Any] = {
        "vehicle": "ugv_0",
        "dt": DT,
        "area": Area(width=20.0, height=20.0, cell=0.5),
        "limits": Limits(max_speed=V_G, max_acceleration=U_G),
        "driver": "waypoints",
        "goals": ((3.0, 4.0), (18.0, 1.0)),
        "goal_tolerance": 0.05,
        "key": key_text(7),
    }
    return UgvBriefing(**usual | fields)


class FlownLaw(NamedTuple):
    """The law of a scenario's UAV, in the form for compiled code."""

    module: ModuleType
    uav: Any
    law: Any
    memory: Any

    def command(self, inputs: LawInputs) -> Any:
        """Return the nominal command."""
        return self.module.command(*self[1:], inputs)

    def weights(self, distance: float) -> tuple[float, float]:
        """Return alpha and beta."""
        return self.module.weights(self.uav, self.law, distance)


def flown_law(scenario: Scenario, **changes: Any) -> FlownLaw:
    """Return the law of the scenario's UAV with changed parameters."""
    module = import_module(LAWS[scenario.law.name].module)
    (uav,) = records(UavParameters, [uav_parameters(briefing_of(scenario))._replace(**changes)])
    (law,) = records(LAWS[scenario.law.name].parameters, [law_parameters(scenario.law)])
    return FlownLaw(module, uav, law, fresh(module.Memory)[0])


def target_at(x: float, y: float) -> Target:
    """Return an estimate of the UGV at rest at this position."""
    return Target(True, x, y, 0.0, 0.0, 0.0, 0.0)


def tracks(flight: Flight) -> tuple[FloatArray, FloatArray]:
    """Return p, v and u of the UAV and of the UGV at each tick. Shapes (rows, 6)."""
    states = flight.recorder.states
    return states[:, flight.world.names.index("uav_0")], states[
        :, flight.world.names.index("ugv_0")
    ]


def distances(flight: Flight) -> FloatArray:
    """Return the true distance at each tick [m]."""
    return flight.recorder.escorts[:, 0, 0]


def errors(flight: Flight) -> FloatArray:
    """Return e(t) of (4) at each tick [m²]."""
    return flight.recorder.escorts[:, 0, 1]


POOR = PROFILES["wifi-poor"]
BAD = LinkTable(detections=POOR, commands=PROFILES["jammed"], operator=POOR, radio=POOR)


def degraded(ticks: int, links: LinkTable = BAD) -> Scenario:
    scenario = load_scenario("escort", overrides=[f"duration={ticks * 0.05!r}"])
    return msgspec.structs.replace(scenario, links=links)


def record(env, policies, observations):
    """Fly to the end; return position, velocity and applied acceleration at each tick, in the order of the trajectory
    hash.
    """
    world, rows = env.unwrapped.world, []
    while env.agents:
        before = (world.position.copy(), world.velocity.copy())
        observations, *_ = env.step(
            {name: policies[name](observations[name]) for name in env.agents}
        )
        rows.append(np.hstack((*before, world.acceleration)))
    return np.array(rows)


def sha256(states):
    return hashlib.sha256((states + 0.0).astype("<f8").tobytes()).hexdigest()


def flown_in_both(scenario: Scenario, seed: int) -> tuple[FloatArray, Flight, Summary]:
    """Fly a scenario in the environment and as a run, and check that the bits are the same."""
    env = parallel_env(scenario, end_on_sight_lost=False)
    states = record(env, pilots(env), env.reset(seed=seed)[0])
    flight, summary = fly(scenario, seed)
    assert sha256(states) == summary.trajectory_sha256
    return states, flight, summary


class Piloted(InProcess):
    """The pilots, with a function of the test in place of one vehicle's pilot."""

    def __init__(self, pilots: Mapping[str, Pilot], vehicle: str, act: Callable[[Any], Command]):
        super().__init__({name: pilot for name, pilot in pilots.items() if name != vehicle})
        self._vehicle, self._act = vehicle, act

    def publish(self, observations: Mapping[str, Observation]) -> None:
        super().publish({name: observations[name] for name in self._pilots})
        self._seen = observations[self._vehicle]

    def collect(self, tick: int) -> dict[str, Command]:
        return {self._vehicle: self._act(self._seen), **super().collect(tick)}


def modelled(scenario: Scenario) -> Scenario:
    """Return the scenario with models in place of robots, for which pilots can be made in this process."""
    models = (
        msgspec.structs.replace(uav, body=DEFAULT_BODY) if BODIES[uav.body].reported else uav
        for uav in scenario.uav
    )
    return msgspec.structs.replace(scenario, uav=(*models,))


def flown_by(pilot: Any, scenario: Scenario, act: Callable[[Any], Command]) -> Flight:
    """Fly a run with seed 0 whose UAV is flown by this pilot: brief it, then call `act` at each tick."""
    flight = Flight(scenario, 0)
    pilot.make(uav_briefing(scenario, "uav_0", 0))
    flight.fly(Piloted(make_pilots(modelled(scenario), 0), "uav_0", act))
    return flight


def altered(
    pilots: Mapping[str, Pilot], vehicle: str, change: Callable[[Any], dict[str, Any]]
) -> Piloted:
    """Return the pilots with changed fields in one vehicle's commands, depending on its observation."""
    act = pilots[vehicle].act
    return Piloted(pilots, vehicle, lambda seen: msgspec.structs.replace(act(seen), **change(seen)))


EVADED = ("law.name=certified", "ugv.0.driver=evade", "duration=10.0")
"""Overrides of a scenario: a certified run with an evading UGV."""
