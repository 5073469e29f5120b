"""Parameters of all pilots of a closed loop, in tables."""

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar, cast

import msgspec
import numpy as np

from agents.drivers.compiled import briefed_grid, briefed_route, pending_rows
from agents.drivers.dispatch import CODES as DRIVER_CODES
from agents.drivers.dispatch import DriverTables, driver_tables
from agents.estimation.map_updates import map_update_ticks
from agents.estimation.motion_model import (
    KalmanParameters,
    kalman_parameters,
)
from agents.estimation.own_map import own_map
from agents.height import HeightMemory, HeightParameters, height_memory, height_parameters
from agents.laws.dispatch import CODES, law_tables
from agents.laws.selection import SelectedLaw
from agents.safety.levels import bounds_of, levels_of
from agents.safety.memory import track_ticks
from agents.uav_parameters import UavParameters, uav_parameters
from bus.errors import ScenarioError
from bus.messages.scenario import Law
from bus.messages.vehicle import UavBriefing, UgvBriefing
from bus.registry import DEFAULT_DRIVER, DRIVERS, EXTERNAL, LAWS
from bus.ticks import radio_ticks
from outrider.envs.closed_loop_state import HeightTables, LoopParameters
from sim.compiling.compile import IntArray
from sim.compiling.records import RecordArray, fill, fresh, record_type, records
from sim.engine.briefing import uav_briefing, ugv_briefing
from sim.env.patch import given_patch
from sim.env.settings import Settings
from sim.models.field import empty_coverage
from sim.models.safety import SafetyBounds
from sim.scenario.types import Scenario

_Memory = TypeVar("_Memory")


def repeated(memory: _Memory, worlds: int, of_each: int) -> _Memory:
    """Return the memories of many vehicles in many worlds, as copies of one.

    Args:
        memory: Array, or a named tuple of such memories.
        worlds, of_each: Sizes of the axes added in front of each array: worlds, and vehicles per world.
    """
    one: Any = memory
    if hasattr(one, "_make"):
        many = one._make(repeated(part, worlds, of_each) for part in one)
    else:
        many = np.broadcast_to(one, (worlds, of_each, *one.shape)).copy()
    return cast("_Memory", many)


def pilot_names(scenario: Scenario, vehicle: str) -> tuple[str, ...]:
    """Return the names of the laws or drivers that can control a vehicle in batches."""
    if any(uav.name == vehicle for uav in scenario.uav):
        return tuple(CODES)
    return tuple(DRIVER_CODES)


def uses_radio(scenario: Scenario, drivers: Sequence[str] = ()) -> bool:
    """Return whether any UGV uses the UAVs' radio: for map updates on ground with hazards, or for its driver.

    Args:
        scenario: Scenario.
        drivers: Names of further drivers in use.
    """
    own = [ugv.driver for ugv in scenario.ugv]
    return scenario.has_ground or any(DRIVERS[driver].listens for driver in (*own, *drivers))


def loop_parameters(scenario: Scenario, settings: Settings, *, radio: bool) -> LoopParameters:
    """Return the switches and parameters of the pilots.

    Args:
        scenario, settings: Scenario and settings of the environment.
        radio: True if any UGV uses the radio.
    """
    dt, ground, patch = scenario.dt, scenario.ground, given_patch(settings.coverage_patch)
    return LoopParameters(
        estimate=bool(settings.estimate),
        gradient=bool(settings.gradient),
        own_maps=len(scenario.uav) > 1 or scenario.disturbed or scenario.has_altitude,
        radio=radio,
        radio_ticks=radio_ticks(dt),
        map_update_ticks=map_update_ticks(ground.map_update_rate, dt) if scenario.has_ground else 0,
        tile=float(ground.tile) if scenario.has_ground else 0.0,
        meters_per_pixel=float(patch.meters_per_pixel) if patch else 1.0,
    )


def height_tables(briefings: Sequence[UavBriefing], most: int = 0) -> HeightTables:
    """Return the tables of UAVs of which at least one has an altitude; `most`: smallest number of rows by floor."""
    laws = np.zeros(len(briefings), record_type(HeightParameters))
    tables = [levels_of(one) for one in briefings]
    most = max(most, *map(len, tables))
    levels = np.zeros((len(briefings), most), tables[0].dtype)
    for k, (briefing, table) in enumerate(zip(briefings, tables, strict=True)):
        levels[k], levels["floor"][k] = table[-1], math.inf
        levels[k, : len(table)] = table
        if briefing.altitude is not None:
            fill(laws[k], height_parameters(briefing, uav_parameters(briefing)))
    return HeightTables(laws, levels)


class OwnNumbers(NamedTuple):
    """Numbers of all vehicles that may differ between worlds, with an axis for UAVs or UGVs."""

    uavs: RecordArray
    """`UavParameters`. Shape (UAVs,)."""
    kalman: RecordArray
    """`KalmanParameters`. Shape (UAVs,)."""
    safety: RecordArray
    """`SafetyBounds` of the filters. Shape (UAVs,)."""
    heights: HeightTables | None
    drivers: DriverTables
    """Drivers, with one row for this world."""
    late: IntArray
    """Rows of pending commands. Shape (UGVs,)."""


def drivers_in_control(
    scenario: Scenario, external: Collection[str], pilots: Mapping[str, str]
) -> dict[str, str]:
    """Return the driver in control of each UGV, `EXTERNAL` for external actions.

    Args:
        scenario: The scenario.
        external: Vehicles with external actions.
        pilots: Laws and drivers chosen instead of the scenario's, by vehicle.
    """
    return {
        ugv.name: EXTERNAL if ugv.name in external else pilots.get(ugv.name, ugv.driver)
        for ugv in scenario.ugv
    }


class PilotNumbers:
    """Parameters of all pilots, in tables.

    Args:
        scenario: Scenario of all worlds.
        uavs, ugvs: Names of the vehicles, in the order of the tables.
        external: Vehicles with external actions.
        chosen: Laws and drivers chosen instead of the scenario's, by vehicle.
        shield: True if the actions of external UAVs pass the safety filter.

    Raises:
        ScenarioError: If a vehicle has a law or a driver that cannot be compiled.
    """

    def __init__(
        self,
        scenario: Scenario,
        uavs: Sequence[str],
        ugvs: Sequence[str],
        external: set[str],
        chosen: Mapping[str, str],
        shield: bool,
    ) -> None:
        self._uavs, self._ugvs = uavs, ugvs
        self._driven = drivers_in_control(scenario, external, chosen)
        never_asked = dict.fromkeys(uavs, "tracking") | dict.fromkeys(ugvs, DEFAULT_DRIVER)
        self._pilots = {**chosen, **{name: never_asked[name] for name in external}}
        uav_briefings, ugv_briefings = self._briefings(scenario)
        laws = self.check_laws(scenario)
        self.own = self.numbers(scenario)
        """Numbers of this scenario."""
        safety = [bounds_of(one) for one in uav_briefings]
        self.laws = law_tables(uav_briefings, laws)
        self.longest = max((bounds.delay_ticks for bounds in safety), default=0)
        self.track = max((track_ticks(bounds) for bounds in safety), default=1)
        self.climbs = np.concatenate(
            [fresh(HeightMemory, (0,)), *map(height_memory, uav_briefings)]
        )
        """`HeightMemory` of each UAV at the start. Shape (UAVs,)."""
        area = scenario.area
        none = empty_coverage(area.width, area.height, area.cell)[None][:0]
        self.maps = np.concatenate([none, *(own_map(one)[None] for one in uav_briefings)])
        """Own map of each UAV at the start. Shape (UAVs, rows, columns)."""
        outside = np.array([name in external for name in uavs], dtype=np.bool_)
        watched = np.array([LAWS[law.name].watched for law in laws], dtype=np.bool_)
        self.filtered = watched & ~outside | outside & shield
        self.estimating = ~outside
        self.scripts = [briefed_route(one).script for one in ugv_briefings]
        self.grids = [briefed_grid(one) for one in ugv_briefings]
        self.radio = uses_radio(scenario, self._drivers(ugv_briefings))

    def _briefings(self, scenario: Scenario) -> tuple[list[UavBriefing], list[UgvBriefing]]:
        return (
            [uav_briefing(scenario, name, 0, drivers=self._driven) for name in self._uavs],
            [ugv_briefing(scenario, name, 0) for name in self._ugvs],
        )

    def _drivers(self, briefings: Sequence[UgvBriefing]) -> list[str]:
        return [self._pilots.get(one.vehicle) or one.driver for one in briefings]

    def numbers(self, scenario: Scenario, most_levels: int = 0) -> OwnNumbers:
        """Return the numbers of the vehicles in a scenario that may differ from the common one in numbers only.

        Args:
            scenario: The scenario.
            most_levels: Smallest number of rows in `HeightTables.levels`.
        """
        uavs, ugvs = self._briefings(scenario)
        return OwnNumbers(
            uavs=records(UavParameters, list(map(uav_parameters, uavs))),
            kalman=records(
                KalmanParameters,
                [
                    kalman_parameters(
                        detector=one.detector,
                        target=one.target_limits,
                        dt=one.dt,
                        settings=one.estimator,
                    )
                    for one in uavs
                ],
            ),
            safety=records(SafetyBounds, list(map(bounds_of, uavs))),
            heights=height_tables(uavs, most_levels) if scenario.has_altitude else None,
            drivers=driver_tables(ugvs, self._drivers(ugvs)),
            late=np.array(list(map(pending_rows, ugvs)), dtype=np.int64),
        )

    def check_laws(self, scenario: Scenario) -> list[Law]:
        """Return the law of each UAV in a scenario.

        Raises:
            ScenarioError: If a law cannot be compiled, or does not fit the scenario.
        """
        briefings, pilots = self._briefings(scenario)[0], self._pilots
        laws = [self._law(one, pilots.get(one.vehicle)) for one in briefings]
        for one, law in zip(briefings, laws, strict=True):
            named = getattr(scenario.custom, LAWS[law.name].inner, "")
            if named and one.vehicle not in pilots:
                raise ScenarioError(
                    f"{one.vehicle}: uav_policy = {named!r}: not supported in batches; allowed: no policy, "
                    "or the policy itself in `others`"
                )
        return laws

    @staticmethod
    def _law(briefing: UavBriefing, name: str | None) -> Law:
        law = briefing.law if name is None else msgspec.structs.replace(briefing.law, name=name)
        if law.name in LAWS and LAWS[law.name].own:
            raise ScenarioError(
                f"{briefing.vehicle}: law.name = {law.name!r}: a user's function cannot compile; allowed: others"
            )
        SelectedLaw(briefing, law, uav_parameters(briefing))  # raises if the law does not fit
        return law
