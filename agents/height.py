"""Vertical control and camera of a UAV that has an altitude: its altitude law, and its sensor at its altitude."""

import math

from agents.control.altitude import ABOVE_FLOOR, PERIOD, best_altitude, climb_to
from agents.safety.levels import least_altitude, levels_of, lowest_certified
from agents.uav_parameters import UavParameters
from bus.messages.base import Vector
from bus.messages.vehicle import UavBriefing, UavObservation
from sim.compiling.compile import FloatArray
from sim.models.buildings import building_table
from sim.models.camera import CameraParameters, sensor_at
from sim.models.sensor import SensorParameters
from sim.models.shadows import Occlusion


class HeightControl:
    """Altitude law of one UAV, and what its camera sees from its altitude.

    Args:
        briefing: Briefing of a UAV with an altitude.
        uav: Constants of the UAV.

    Raises:
        ValueError: If the UAV flies in the plane.
    """

    def __init__(self, briefing: UavBriefing, uav: UavParameters) -> None:
        if briefing.altitude is None or briefing.camera is None:
            raise ValueError("the UAV flies in the plane: it has no altitude to control")
        self._own, self._uav = briefing.altitude, uav
        self._camera = CameraParameters(
            math.tan(briefing.camera.half_angle),
            briefing.camera.reference_altitude,
            briefing.marker_height,
        )
        self._buildings = building_table([(one.corners, one.height) for one in briefing.buildings])
        levels = levels_of(briefing)
        lowest = lowest_certified(briefing)
        floor = least_altitude(briefing) if lowest is None else lowest
        self._lowest = min(floor + ABOVE_FLOOR, self._own.max_altitude)
        top = float(levels["floor"][-1]) if lowest is not None else self._own.max_altitude
        self._highest = max(top, self._lowest)
        self._goal, self._compared = self._own.initial_altitude, -1
        self._z = self._own.initial_altitude

    def see(self, observation: UavObservation) -> None:
        """Record the altitude."""
        if observation.altitude is not None:
            self._z = observation.altitude

    @property
    def sensor(self) -> SensorParameters:
        """Sensor at the present altitude."""
        found: SensorParameters = sensor_at(self._uav.sensor, self._camera, self._z)
        return found

    @property
    def occlusion(self) -> Occlusion | None:
        """Known buildings, seen from the present altitude; None: none is known."""
        rows, corners = self._buildings
        return Occlusion(rows, corners, self._z) if len(rows) else None

    def command(
        self, observation: UavObservation, coverage: FloatArray, target: Vector | None
    ) -> float:
        """Return the vertical acceleration of the altitude law [m/s²].

        Args:
            observation: Observation of this tick.
            coverage: The UAV's own map. Shape (rows, columns).
            target: Estimated position of the UGV [m]; None: unknown.
        """
        own, uav = self._own, self._uav
        if own.law == "certified":
            self._goal = self._lowest
        elif own.law == "best" and target is not None:
            self._compare(observation, coverage, target)
        return float(
            climb_to(
                self._z,
                observation.climb_rate,
                self._goal,
                own.max_climb_rate,
                own.max_vertical_acceleration,
                uav.dt,
            )
        )

    def _compare(self, observation: UavObservation, coverage: FloatArray, target: Vector) -> None:
        """Choose the best altitude, once a second."""
        period = max(1, round(PERIOD / self._uav.dt))
        if self._compared >= 0 and observation.tick - self._compared < period:
            return
        self._compared, uav = observation.tick, self._uav
        self._goal = best_altitude(
            coverage,
            observation.position,
            target,
            (uav.density_radius, uav.desired_coverage, uav.cell),
            uav.sensor,
            self._camera,
            (self._lowest, self._highest),
        )
