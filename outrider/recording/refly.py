"""Flying a recording again: the same commands through the same simulator, without pilots.

And the recorded flight as it was.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bus.errors import ScenarioError
from bus.messages.control import Action, Control
from bus.messages.links import LinkKind
from bus.messages.telemetry import Truth
from outrider.recording.reader import Recording
from sim.server.flight import Flight
from sim.server.recorder import platform_row

_FIELDS = ("position", "velocity", "acceleration")


@dataclass(frozen=True, slots=True, kw_only=True)
class Difference:
    """The first number that is not the same."""

    tick: int
    vehicle: str
    field: str
    recorded: tuple[float, float]
    flown: tuple[float, float]

    def __str__(self) -> str:
        """One line for a person."""
        return f"tick {self.tick}, {self.vehicle}: {self.field} recorded {self.recorded}, flown again {self.flown}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Reflight:
    """A recording flown again."""

    flight: Flight
    ticks: int
    """Ticks that were flown again."""
    recorded_sha256: str
    """`trajectory_sha256` of the recorded numbers."""
    trajectory_sha256: str
    """The same of the flight."""
    difference: Difference | None
    """None: every position, velocity and applied command is the same to the last bit."""
    note: str
    """Why there may be a difference, or why it was not flown to the end; empty: nothing to say."""


def from_the_start(recording: Recording) -> bool:
    """True if it holds the flight from its first tick."""
    return bool(recording.truths) and recording.truths[0].tick == 0


def _new_flight(recording: Recording) -> Flight:
    scenario = recording.scenario
    flight = Flight(scenario, recording.head.seed, secret=recording.head.secret)
    if not from_the_start(recording):
        where = f"begins at tick {recording.truths[0].tick}" if recording.truths else "is empty"
        raise ScenarioError(
            f"{recording.path}: {where}; allowed: a recording from the first tick on"
        )
    if set(recording.truths[0].vehicles) != set(flight.world.names):
        raise ScenarioError(
            f"{recording.path}: its vehicles are not those of its scenario {scenario.name!r}"
        )
    return flight


def _without_gap(recording: Recording) -> int:
    """Counts the truths that follow each other from the first on."""
    return next(
        (k for k, truth in enumerate(recording.truths) if truth.tick != k), len(recording.truths)
    )


def _put(flight: Flight, truth: Truth) -> None:
    """Make the world's state the recorded one, and take it down."""
    world = flight.world
    for k, name in enumerate(world.names):
        vehicle = truth.vehicles[name]
        world.position[k] = vehicle.position
        world.velocity[k] = vehicle.velocity
        world.acceleration[k] = vehicle.acceleration
    escorts = {escort.uav: escort for escort in truth.escorts}
    for k, uav in enumerate(world.uavs):
        found = escorts[uav.name].detection
        world.vehicles["detection"][world.escorts[k, 0]] = found or (np.nan, np.nan)
    flight.recorder.record([escorts[uav.name].report for uav in world.uavs])


def external_uavs(recording: Recording) -> set[str]:
    """UAVs that a program of the user's own has flown: detections have reached it, and it reports no estimate."""
    reported = {e.uav for truth in recording.truths for e in truth.escorts if e.report is not None}
    seen = {e.uav for truth in recording.truths for e in truth.escorts if e.detection is not None}
    dark = {
        name.partition("/")[0]
        for name, link in recording.links.items()
        if name.endswith(f"/{LinkKind.DETECTIONS}") and not link.delivered
    }
    return seen - reported - dark


def restore(recording: Recording) -> Flight:
    """The recorded flight, with its record and its ground, as if it had just been flown.

    Every state is the recorded one; the ground is what the UAVs saw from there. Ticks that an observer missed are
    bridged with the last command that is known.

    Raises:
        ScenarioError: If the file does not tell the scenario, or does not begin with the first tick.
    """
    flight = _new_flight(recording)
    _put(flight, recording.truths[0])
    for truth in recording.truths[1:]:
        for k, name in enumerate(flight.world.names):
            flight.commands[k] = truth.vehicles[name].command
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
    """Repeat an operator's change of law, driver or link; of all UGVs where none is named."""
    if control.action is Action.LAW and control.law is not None:
        flight.law = control.law
    elif control.action is Action.DRIVER and control.driver is not None:
        for name in flight.drivers:
            if control.vehicle in (None, name):
                flight.drivers[name] = control.driver


def _commands(recording: Recording, flight: Flight) -> Iterator[bool]:
    """Put the commands of each tick into the flight's array; ends where one is not in the file."""
    for tick in range(_without_gap(recording) - 1):
        asked = recording.commands.get(tick)
        if asked is None or set(asked.accelerations) != set(flight.world.names):
            return
        for k, name in enumerate(flight.world.names):
            flight.commands[k] = asked.accelerations[name]
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
    return None


def refly(recording: Recording) -> Reflight:
    """Fly the recorded commands again and compare every tick with what was recorded.

    Raises:
        ScenarioError: If the file does not tell the scenario, or does not begin with the first tick.
    """
    flight = _new_flight(recording)
    copy = _new_flight(recording)  # only hashes what was recorded
    difference = _difference(flight, recording.truths[0])
    flight.recorder.record(flight.answers.reports)
    _put(copy, recording.truths[0])
    for _ in _commands(recording, flight):
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
            f"flown again to tick {flight.recorder.ticks}: the next is not in the file, which has {missing} more"
        )
    return "; ".join(notes)
