"""Compilation of a pilot's code before its first tick, by throwaway pilots."""

import math
from typing import TYPE_CHECKING, Any

import msgspec

from bus.keys import Role
from bus.messages.scenario import Law
from bus.messages.vehicle import (
    Detection,
    UavBriefing,
    UavObservation,
    UgvBriefing,
    UgvObservation,
)
from bus.registry import DEFAULT_DRIVER, LAWS, TELEOP
from sim.models.endurance import AT_BASE

if TYPE_CHECKING:
    from agents.uav import Inner

_VEHICLE = {
    "vehicle": "warm_up",
    "dt": 0.05,
    "area": {"width": 10.0, "height": 10.0, "cell": 0.5},
    "limits": {"max_speed": 0.6, "max_acceleration": 0.3},
    "key": "1" * 32,
}
_UAV = _VEHICLE | {
    "target_limits": {"max_speed": 0.2, "max_acceleration": 0.1},
    "visibility_radius": 4.75,
    "sensor": {},
    "desired_coverage": 2.0,
    "law": {},
    "detector": {"noise": 0.1, "period": 0.05},
    "estimator": {},
}
_FILTERED = {
    "law": {"name": "certified"},
    "safety": {"max_measurement_error": 0.3, "max_measurement_age": 1.0},
}
_UGV = _VEHICLE | {
    "driver": "waypoints",
    "goals": [[1.0, 1.0], [9.0, 9.0]],
    "goal_tolerance": 0.05,
}

_OPERATOR = {"operator": "warm_up"}
_MESSAGES: tuple[list[dict[str, Any]], ...] = (
    [],
    [_OPERATOR | {"velocity": [0.1, 0.0]}],
    [_OPERATOR | {"goal": [1.0, 1.0]}],
)


def _observation(tick: int) -> dict[str, Any]:
    return {"tick": tick, "time": tick * 0.05, "position": [5.0, 5.0], "velocity": [0.0, 0.0]}


def warm_up(role: Role, *, inner: "Inner | None" = None) -> None:
    """Run a throwaway pilot for a few ticks, so that all its code is compiled or loaded.

    Args:
        role: Kind of vehicle.
        inner: User's control of a UAV.
    """
    if role is Role.UGV:
        from agents.ugv import UgvPilot  # noqa: PLC0415 - a UAV does not need it

        for driver in (DEFAULT_DRIVER, TELEOP):  # an operator may take over any UGV
            ugv = UgvPilot(msgspec.convert(_UGV | {"driver": driver}, UgvBriefing))
            for tick, messages in enumerate(_MESSAGES):
                ugv.act(
                    msgspec.convert(_observation(tick) | {"operator": messages}, UgvObservation)
                )
        return
    from agents.uav import UavPilot  # noqa: PLC0415 - slow to import, and a UGV does not need it

    for own in ({}, _FILTERED):
        uav = UavPilot(msgspec.convert(_UAV | own, UavBriefing), inner=inner)
        for tick in range(3):
            detection = {"time": tick * 0.05, "relative_position": [1.0, 0.0]}
            uav.act(
                msgspec.convert(_observation(tick) | {"detections": [detection]}, UavObservation)
            )


_EXERCISE = 8
"""Ticks of a pilot's exercise: more than the period of its messages."""


def exercise(briefing: UavBriefing) -> None:
    """Fly a throwaway pilot of a team at rest beside its UGV, until it guards and has sent a message.

    Otherwise its code would be compiled bit by bit, in the ticks that first need it.
    """
    from agents.uav import UavPilot  # noqa: PLC0415 - slow to import, and a UGV does not need it

    law = Law() if LAWS[briefing.law.name].own else briefing.law
    pilot = UavPilot(msgspec.structs.replace(briefing, law=law))
    altitude, endurance = briefing.altitude, briefing.endurance
    x, y = 0.5 * briefing.area.width, 0.5 * briefing.area.height
    if endurance is not None and math.dist(endurance.base, (x, y)) < 2.0 * AT_BASE:
        x *= 0.5  # at its base it would wait as a scout
    for tick in range(_EXERCISE):
        seen = UavObservation(
            tick=tick,
            time=tick * briefing.dt,
            position=(x, y),
            velocity=(0.0, 0.0),
            altitude=None if altitude is None else altitude.initial_altitude,
            detections=(Detection(time=tick * briefing.dt, relative_position=(0.1, 0.0)),),
            charge=None if endurance is None else endurance.endurance,
        )
        pilot.act(seen)
