"""`[law.parameters]` of the shipped laws: scenarios are checked with these classes, and laws compute with them."""

import math
from typing import Annotated

import msgspec
from msgspec import Meta

from bus.messages.base import Coordinate, Positive


class LawParameters(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of every law's `[law.parameters]`; a law without parameters has this class."""


class TrackingParameters(LawParameters, frozen=True, kw_only=True):
    """Gains of the tracking law (15)."""

    a_c: Coordinate = -3.0
    """A_c [1/s]."""
    b_c: Coordinate = -3.0
    """B_c [1/s]."""
    c_c: Coordinate = -8.0 / 3.0
    """C_c [1/s²]."""
    d_c: Coordinate = -3.0
    """D_c [1/s²]."""


class CoverageParameters(TrackingParameters, frozen=True, kw_only=True):
    """Gains of tracking and of the coverage law (6) to (11)."""

    speed_gain: Positive = 10.0
    """k_v of (11) [1/s]."""
    reference_speed: Positive = math.inf
    """v_ref of (10) [m/s]; defaults to the UAV's maximum speed."""


class LogarithmicParameters(CoverageParameters, frozen=True, kw_only=True):
    """Gains of the law `logarithmic`."""

    weight_gain: Positive = 20.0
    """Gain k_beta of eq. (19) [1]."""
    weight_limit: Positive = 100.0
    """Upper limit of beta_3 [1], footnote 2 of the paper."""


class CircleParameters(TrackingParameters, frozen=True, kw_only=True):
    """Gains and circle of the law `circle`."""

    circle_radius: Positive = math.inf
    """r_pv of (25) [m]; defaults to the switching radius."""
    circle_rate: Coordinate = 0.1
    """omega_pv of (25) [rad/s]; negative: clockwise."""


class LookaheadParameters(LawParameters, frozen=True, kw_only=True):
    """Parameters of the law `lookahead`."""

    reference_speed: Positive = math.inf
    """v_ref: largest planned speed [m/s]; defaults to the UAV's maximum speed."""
    horizon: Annotated[float, Meta(ge=0.5, le=60.0)] = 15.0
    """Prediction horizon [s]; 0.5: one step."""
    candidates: Annotated[int, Meta(ge=1, le=10_000)] = 800
    """Number of candidates compared every half second; 1: fly randomly drawn trajectories without comparison."""
