"""Second flight of recorded commands, without pilots, and restoration of the recorded flight."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bus.errors import ScenarioError
from bus.messages.control import Action, Control
from bus.messages.links import LinkKind
from bus.messages.telemetry import Truth
from outrider.recording.reader import Recording
from sim.models.body import Motion
from sim.server.flight import Flight
from sim.server.recorder import platform_row

_FIELDS = ("position", "velocity", "acceleration")
_HEIGHT = "altitude and climb rate"


@dataclass(frozen=True, slots=True, kw_only=True)
class Difference:
    """First value that differs."""

    tick: int
    vehicle: str
    field: str
    recorded: tuple[float, float]
    flown: tuple[float, float]

    def __str__(self) -> str:
        """Describe the difference in one line."""
        return f"tick {self.tick}, {self.vehicle}: {self.field} recorded {self.recorded}, flown again {self.flown}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Reflight:
    """Result of a second flight."""

    flight: Flight
    ticks: int
    """Number of ticks flown again."""
    recorded_sha256: str
    """`trajectory_sha256` of the recorded flight."""
    trajectory_sha256: str
    """`trajectory_sha256` of the second flight."""
    difference: Difference | None
    """First difference; None: every position, velocity and applied command is identical to the last bit."""
    note: str
    """Reason for a difference or for an early end; empty: none."""


def from_the_start(recording: Recording) -> bool:
    """Return true if the recording contains the flight's first tick."""
    return bool(recording.truths) and recording.truths[0].tick == 0


def _new_flight(recording: Recording) -> Flight:
    scenario = recording.scenario
    flight = Flight(scenario, recording.head.seed, secret=recording.head.secret)
    if not from_the_start(recording):
        where = f"begins at tick {recording.truths[0].tick}" if recording.truths else "is empty"
        raise ScenarioError(
            f"{recording.path}: {where}; allowed: a recording that starts at tick 0"
        )
    if set(recording.truths[0].vehicles) != set(flight.world.names):
        raise ScenarioError(
            f"{recording.path}: vehicles differ from the vehicles of its scenario {scenario.name!r}"
        )
    return flight


def _without_gap(recording: Recording) -> int:
    """Return the number of truths before the first gap."""
    return next(
        (k for k, truth in enumerate(recording.truths) if truth.tick != k), len(recording.truths)
    )


def _put(flight: Flight, truth: Truth) -> None:
    """Set the world to a recorded state, and record it."""
    world = flight.world
    for k, name in enumerate(world.names):
        vehicle = truth.vehicles[name]
        world.position[k] = vehicle.position
        world.velocity[k] = vehicle.velocity
        world.acceleration[k] = vehicle.acceleration
        if vehicle.heading is not None:
            world.vehicles["heading"][k] = vehicle.heading
        if vehicle.altitude is not None:
            world.vertical["altitude"][k] = vehicle.altitude
            world.vertical["rate"][k] = vehicle.climb_rate
            world.vertical["acceleration"][k] = vehicle.vertical_acceleration
    escorts = {escort.uav: escort for escort in truth.escorts}
    for k, uav in enumerate(world.uavs):
        found = escorts[uav.name].detection
        world.vehicles["detection"][world.escorts[k, 0]] = found or (np.nan, np.nan)
    given = [escorts[uav.name] for uav in world.uavs]
    flight.recorder.record([one.report for one in given], [one.revoked for one in given])


def _report(flight: Flight, truth: Truth) -> None:
    """Report the recorded states of the next tick to the bodies that robots flew."""
    for name, robot in flight.world.robots.items():
        vehicle = truth.vehicles[name]
        state = Motion((*vehicle.position, vehicle.altitude or 0.0), (*vehicle.velocity, 0.0))
        robot.receive(state, 0.0 if vehicle.known else math.inf)


def external_uavs(recording: Recording) -> set[str]:
    """Return the UAVs flown by a program of the user: they receive detections, but report no estimate."""
    reported = {e.uav for truth in recording.truths for e in truth.escorts if e.report is not None}
    detecting = {
        e.uav for truth in recording.truths for e in truth.escorts if e.detection is not None
    }
    disconnected = {
        name.partition("/")[0]
        for name, link in recording.links.items()
        if name.endswith(f"/{LinkKind.DETECTIONS}") and not link.delivered
    }
    return detecting - reported - disconnected


def restore(recording: Recording) -> Flight:
    """Restore a recorded flight with its record and its coverage.

    States are taken from the recording; coverage is computed from them. Ticks that an observer missed are simulated
    with the last known command.

    Raises:
        ScenarioError: If the file does not contain the scenario, or does not start at tick 0.
    """
    flight = _new_flight(recording)
    _put(flight, recording.truths[0])
    for truth in recording.truths[1:]:
        for k, name in enumerate(flight.world.names):
            flight.commands[k] = truth.vehicles[name].command
            flight.world.vertical["command"][k] = truth.vehicles[name].vertical_acceleration
        _report(flight, truth)
        while flight.world.tick < truth.tick - 1:
            flight.world.step(flight.commands)
            flight.recorder.record([None] * len(flight.world.uavs))
        flight.world.step(flight.commands)
        _put(flight, truth)
    for change in recording.changes:
        _repeat(flight, change.control)
    flight.answers.external = external_uavs(recording)
    return flight


def _repeat(flight: Flight, control: Control) -> None:
    """Repeat an operator's change of law or driver; without a vehicle it applies to all UGVs."""
    if control.action is Action.LAW and control.law is not None:
        flight.assign_law(control.law)
    elif control.action is Action.DRIVER and control.driver is not None:
        for name in flight.drivers:
            if control.vehicle in (None, name):
                flight.drivers[name] = control.driver


def _commands(recording: Recording, flight: Flight) -> Iterator[bool]:
    """Set the flight's commands tick by tick; stop at the first tick without commands in the file."""
    for tick in range(_without_gap(recording) - 1):
        asked = recording.commands.get(tick)
        if asked is None or set(asked.accelerations) != set(flight.world.names):
            return
        for k, name in enumerate(flight.world.names):
            flight.commands[k] = asked.accelerations[name]
            flight.world.vertical["command"][k] = asked.vertical.get(name, np.nan)
        yield True


def _difference(flight: Flight, truth: Truth) -> Difference | None:
    world = flight.world
    arrays = (world.position, world.velocity, world.acceleration)
    for k, name in enumerate(world.names):
        for field, array in zip(_FIELDS, arrays, strict=True):
            recorded = getattr(truth.vehicles[name], field)
            flown = (float(array[k, 0]), float(array[k, 1]))
            if recorded != flown:
                return Difference(
                    tick=truth.tick, vehicle=name, field=field, recorded=recorded, flown=flown
                )
        vertical, there = world.vertical[k], truth.vehicles[name]
        if there.altitude is None:
            continue
        recorded, flown = (
            (there.altitude, there.climb_rate),
            (float(vertical["altitude"]), float(vertical["rate"])),
        )
        if recorded != flown:
            return Difference(
                tick=truth.tick, vehicle=name, field=_HEIGHT, recorded=recorded, flown=flown
            )
    return None


def refly(recording: Recording) -> Reflight:
    """Fly the recorded commands again, and compare every tick with the recording.

    Raises:
        ScenarioError: If the file does not contain the scenario, or does not start at tick 0.
    """
    flight = _new_flight(recording)
    copy = _new_flight(recording)  # to hash the recorded states
    difference = _difference(flight, recording.truths[0])
    flight.recorder.record(flight.answers.reports)
    _put(copy, recording.truths[0])
    for _ in _commands(recording, flight):
        _report(flight, recording.truths[flight.world.tick + 1])
        flight.world.step(flight.commands)
        flight.recorder.record(flight.answers.reports)
        truth = recording.truths[flight.world.tick]
        copy.world.move_to(truth.tick)
        _put(copy, truth)
        difference = difference or _difference(flight, truth)
    return Reflight(
        flight=flight,
        ticks=flight.recorder.ticks,
        recorded_sha256=copy.recorder.sha256(),
        trajectory_sha256=flight.recorder.sha256(),
        difference=difference,
        note=_note(recording, flight, difference),
    )


def _note(recording: Recording, flight: Flight, difference: Difference | None) -> str:
    notes = []
    here, there = platform_row(), recording.head.platform
    if difference is not None and here != there:
        other = ", ".join(
            f"{key} {there.get(key)} there, {here[key]} here"
            for key in here
            if here[key] != there.get(key)
        )
        notes.append(f"recorded on another platform ({other}): compare to 1e-9")
    missing = recording.truths[-1].tick - flight.recorder.ticks
    if missing:
        notes.append(
            f"flown again up to tick {flight.recorder.ticks} only, {missing} ticks before the end: the file has a gap"
        )
    return "; ".join(notes)
