"""Constants of a UAV's on-board software, in tables: a pilot has one row, a batch a row for each UAV."""

from typing import NamedTuple

from agents.altitude_law import AltitudeParameters, altitude_parameters
from agents.estimation.motion_model import KalmanParameters, kalman_parameters
from agents.safety.levels import bounds_of, levels_of
from agents.team.records import team_parameters
from agents.uav_parameters import UavParameters, uav_parameters
from bus.messages.vehicle import UavBriefing
from sim.compiling.records import RecordArray, records
from sim.models.safety import SafetyBounds


class UavConstants(NamedTuple):
    """Constants of UAVs. The tables of a batch have axes in front, for worlds (or 1) and for UAVs."""

    uav: RecordArray
    """`UavParameters`. Shape (1,)."""
    kalman: RecordArray
    """`KalmanParameters` of the compiled estimator. Shape (1,)."""
    safety: RecordArray
    """`SafetyBounds` of the safety filter; with an altitude, those at the initial altitude. Shape (1,)."""
    levels: RecordArray | None
    """Its bounds by increasing floor; None: all UAVs fly in the plane. Shape (levels,)."""
    altitude: RecordArray | None
    """`AltitudeParameters`; None: all UAVs fly in the plane. Shape (1,)."""
    team: RecordArray | None
    """`TeamParameters`; None: there are no teams. Shape (1,)."""


def uav_constants(briefing: UavBriefing) -> UavConstants:
    """Return the constants of one UAV."""
    uav = uav_parameters(briefing)
    kalman = kalman_parameters(
        detector=briefing.detector,
        target=briefing.target_limits,
        dt=briefing.dt,
        settings=briefing.estimator,
    )
    levels, altitude = None, None
    if briefing.altitude is not None:
        levels = levels_of(briefing)
        altitude = records(AltitudeParameters, [altitude_parameters(briefing, uav)])
    return UavConstants(
        uav=records(UavParameters, [uav]),
        kalman=records(KalmanParameters, [kalman]),
        safety=records(SafetyBounds, [bounds_of(briefing)]),
        levels=levels,
        altitude=altitude,
        team=team_parameters(briefing),
    )
