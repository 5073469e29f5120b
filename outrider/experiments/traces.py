"""Quantities of a flight for figures and claims: distance, error, crossings, velocity error and its peaks."""

import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from agents.laws.common import CoverageMemory, coverage_velocity_error
from agents.laws.inputs import LawInputs
from agents.uav_parameters import Target, UavParameters, uav_parameters
from bus.law_parameters import law_parameters
from bus.registry import LAWS, module_of
from outrider.running.summary import switching_radius_of
from sim.compiling.compile import FloatArray
from sim.compiling.records import fresh, records
from sim.engine.briefing import uav_briefing
from sim.models.field import accumulate, cover, empty_coverage
from sim.models.randomness import words_of
from sim.models.vehicles import State
from sim.scenario.types import Scenario
from sim.server.flight import Flight

PEAK = 0.5
"""Share of v_ref above which the velocity error has a peak."""
WINDOW = 3
"""Number of ticks before a peak within which a turn of u_si counts."""

BoolArray = npt.NDArray[np.bool_]


def distance(flight: Flight) -> FloatArray:
    """Return the distance between the first UAV and its UGV at each tick [m]."""
    return flight.recorder.escorts[:, 0, 0]


def error(flight: Flight) -> FloatArray:
    """Return the coverage error e(t) of the first UAV at each tick [m²]."""
    return flight.recorder.escorts[:, 0, 1]


def until(flight: Flight, seconds: float) -> slice:
    """Return the rows of the record up to this time [s]."""
    return slice(0, round(seconds / flight.scenario.dt) + 1)


def rise(values: FloatArray) -> float:
    """Return the sum of all increases of a series."""
    return float(np.diff(values).clip(min=0.0).sum())


def crossings(flight: Flight) -> int:
    """Return the number of times that the distance rises to r_s or beyond."""
    r_s = switching_radius_of(flight)
    beyond = distance(flight) >= (math.inf if r_s is None else r_s)
    return int((beyond[1:] & ~beyond[:-1]).sum())


def stop_row(flight: Flight) -> int:
    """Return the row from which on the first UAV's UGV stands still; the number of rows if it never does."""
    velocity = flight.recorder.states[:, flight.world.escorts[0, 1], 2:4]
    moving = np.flatnonzero(np.linalg.norm(velocity, axis=1) > 1e-9)
    return int(moving[-1]) + 1 if moving.size else 0


def velocity_errors(flight: Flight) -> tuple[FloatArray, FloatArray]:
    """Return the velocity error e_vel, eq. (10), and the desired velocity v_ref u_si of the first UAV at each tick.

    Both have shape (ticks, 2) [m/s]. They are computed again from the recorded states, with the law's memory and
    parameters.
    """
    brief = uav_briefing(flight.scenario, flight.world.uavs[0].name, flight.seed, flight.secret)
    c, parameters = uav_parameters(brief), law_parameters(brief.law)
    (uav,), (law,) = records(UavParameters, [c]), records(type(parameters), [parameters])
    memory, coverage = fresh(CoverageMemory)[0], empty_coverage(c.width, c.height, c.cell)
    memory["key_0"], memory["key_1"] = words_of(brief.key)
    for region in brief.covered:
        cover(coverage, region.lower, region.upper, c.cell, c.desired_coverage)
    states = flight.recorder.states[:, flight.world.escorts[0, 0]]
    estimates = flight.recorder.escorts[:, 0, 4:6]
    errors = np.empty((flight.recorder.ticks, 2))
    for tick in range(flight.recorder.ticks):
        state = State(*states[tick, :4].tolist())
        if tick > 0:
            accumulate(coverage, state.p_x, state.p_y, c.sensor, c.cell, c.dt)
        target = Target(True, estimates[tick, 0], estimates[tick, 1], 0.0, 0.0, 0.0, 0.0)
        errors[tick] = coverage_velocity_error(
            uav, law, memory, LawInputs(coverage, tick, state, target)
        )
    return errors, errors + states[: flight.recorder.ticks, 2:4]


def searching(wanted: FloatArray) -> BoolArray:
    """Return the ticks at which the desired velocity is not zero, as ground is uncovered."""
    found: BoolArray = np.linalg.norm(wanted, axis=1) > 0.5 * float(
        np.linalg.norm(wanted, axis=1).max()
    )
    return found


def turns(wanted: FloatArray) -> FloatArray:
    """Return the largest turn of u_si between consecutive ticks over the last `WINDOW` ticks, at each tick [rad]."""
    direction = wanted[:, 0] + 1j * wanted[:, 1]
    step = np.concatenate(([0.0], np.abs(np.angle(direction[1:] * direction[:-1].conj()))))
    found: FloatArray = np.max(
        [np.concatenate((np.zeros(k), step[: len(step) - k])) for k in range(WINDOW)], axis=0
    )
    return found


def peaks(speed_error: FloatArray, v_ref: float) -> npt.NDArray[np.intp]:
    """Return the ticks at which the velocity error rises above `PEAK` times v_ref."""
    high = speed_error > PEAK * v_ref
    return np.flatnonzero(high[1:] & ~high[:-1]) + 1


def weighting_of(scenario: Scenario) -> tuple[Callable[[float, float], tuple[float, float]], float]:
    """Return the weighting (alpha, beta) of the scenario's first UAV over distance and r_s, and its r_s [m]."""
    brief = uav_briefing(scenario, min(uav.name for uav in scenario.uav), scenario.seed)
    c, parameters = uav_parameters(brief), law_parameters(brief.law)
    (law,) = records(type(parameters), [parameters])

    def weighting(distance: float, r_s: float) -> tuple[float, float]:
        weights = module_of(LAWS[brief.law.name]).weights
        (uav,) = records(UavParameters, [c._replace(switching_radius=r_s)])
        alpha, beta = weights(uav, law, distance)
        return float(alpha), float(beta)

    return weighting, c.switching_radius
