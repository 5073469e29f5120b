"""Quantities that figures and claims read off a flight: distance, error, crossings, velocity error and its peaks."""

import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from agents.laws.common import CoverageMemory, coverage_velocity_error
from agents.uav_parameters import Target, UavParameters, uav_parameters
from bus.law_parameters import law_parameters
from bus.registry import LAWS, resolve
from outrider.running.summary import switching_radius_of
from sim.compiling.compile import FloatArray
from sim.compiling.records import fresh, records
from sim.engine.briefing import uav_briefing
from sim.models.field import accumulate, cover, empty_coverage
from sim.models.randomness import words_of
from sim.models.vehicles import Motion
from sim.scenario.types import Scenario
from sim.server.flight import Flight

PEAK = 0.5
"""A peak of the velocity error is higher than this share of v_ref."""
WINDOW = 3
"""Ticks over which u_si may have turned for a peak."""

BoolArray = npt.NDArray[np.bool_]


def distance(flight: Flight) -> FloatArray:
    """Distance between the first UAV and its UGV at each tick [m]."""
    return flight.recorder.escorts[:, 0, 0]


def error(flight: Flight) -> FloatArray:
    """e(t) of the first UAV at each tick [m²]."""
    return flight.recorder.escorts[:, 0, 1]


def until(flight: Flight, seconds: float) -> slice:
    """The rows of the record up to this time [s]."""
    return slice(0, round(seconds / flight.scenario.dt) + 1)


def rise(values: FloatArray) -> float:
    """All the rises of a series added up."""
    return float(np.diff(values).clip(min=0.0).sum())


def crossings(flight: Flight) -> int:
    """Counts how often the distance rises to r_s or beyond."""
    r_s = switching_radius_of(flight)
    beyond = distance(flight) >= (math.inf if r_s is None else r_s)
    return int((beyond[1:] & ~beyond[:-1]).sum())


def stop_row(flight: Flight) -> int:
    """The row from which on the first UAV's UGV stands still; the number of rows where it never does."""
    velocity = flight.recorder.states[:, flight.world.escorts[0, 1], 2:4]
    moving = np.flatnonzero(np.linalg.norm(velocity, axis=1) > 1e-9)
    return int(moving[-1]) + 1 if moving.size else 0


def velocity_errors(flight: Flight) -> tuple[FloatArray, FloatArray]:
    """e_vel of (10) at each tick of the first UAV, and the velocity wanted (v_ref along u_si).

    Both [m/s], shape (ticks, 2).

    The flight is repeated with the memory and the parameters of its law.
    """
    told = uav_briefing(flight.scenario, flight.world.uavs[0].name, flight.seed, flight.secret)
    c, parameters = uav_parameters(told), law_parameters(told.law)
    (uav,), (law,) = records(UavParameters, [c]), records(type(parameters), [parameters])
    memory, coverage = fresh(CoverageMemory)[0], empty_coverage(c.width, c.height, c.cell)
    memory["key_0"], memory["key_1"] = words_of(told.key)
    for region in told.covered:
        cover(coverage, region.lower, region.upper, c.cell, c.desired_coverage)
    states = flight.recorder.states[:, flight.world.escorts[0, 0]]
    estimates = flight.recorder.escorts[:, 0, 4:6]
    errors = np.empty((flight.recorder.ticks, 2))
    for tick in range(flight.recorder.ticks):
        here = Motion(*states[tick, :4].tolist())
        if tick > 0:
            accumulate(coverage, here.p_x, here.p_y, c.sensor, c.cell, c.dt)
        target = Target(True, estimates[tick, 0], estimates[tick, 1], 0.0, 0.0, 0.0, 0.0)
        errors[tick] = coverage_velocity_error(uav, law, memory, coverage, tick, here, target)
    return errors, errors + states[: flight.recorder.ticks, 2:4]


def searching(wanted: FloatArray) -> BoolArray:
    """The ticks at which the UAV wants to move at all, because something is uncovered."""
    found: BoolArray = np.linalg.norm(wanted, axis=1) > 0.5 * float(
        np.linalg.norm(wanted, axis=1).max()
    )
    return found


def turns(wanted: FloatArray) -> FloatArray:
    """The largest turn of u_si from one tick to the next over the last few ticks, at each tick [rad]."""
    course = wanted[:, 0] + 1j * wanted[:, 1]
    step = np.concatenate(([0.0], np.abs(np.angle(course[1:] * course[:-1].conj()))))
    found: FloatArray = np.max(
        [np.concatenate((np.zeros(k), step[: len(step) - k])) for k in range(WINDOW)], axis=0
    )
    return found


def peaks(speed_error: FloatArray, v_ref: float) -> npt.NDArray[np.intp]:
    """The ticks at which the velocity error rises above half of v_ref."""
    high = speed_error > PEAK * v_ref
    return np.flatnonzero(high[1:] & ~high[:-1]) + 1


def weighting_of(scenario: Scenario) -> tuple[Callable[[float, float], tuple[float, float]], float]:
    """Alpha and beta over distance and r_s, as the scenario's first UAV weighs them, and its r_s [m]."""
    told = uav_briefing(scenario, min(uav.name for uav in scenario.uav), scenario.seed)
    c, parameters = uav_parameters(told), law_parameters(told.law)
    (law,) = records(type(parameters), [parameters])

    def weighting(distance: float, r_s: float) -> tuple[float, float]:
        weights = resolve(f"{LAWS[told.law.name].module}:weights")
        (uav,) = records(UavParameters, [c._replace(switching_radius=r_s)])
        alpha, beta = weights(uav, law, distance)
        return float(alpha), float(beta)

    return weighting, c.switching_radius
