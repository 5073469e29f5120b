"""A co-simulation unit at a UGV's wheel, as a saved policy: `driver = "fmu:FILE.fmu"`.

At each tick it is given what it has inputs for, makes one step of a tick, and its outputs are the acceleration.
"""

import contextlib
import math
import shutil
import sys
import tempfile
import weakref
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from bus.errors import ScenarioError
from bus.messages.vehicle import UgvObservation
from bus.observations import UGV, Row, names
from bus.plugins import needs
from outrider_fmi.variables import ACCELERATION, DRIVER_INPUTS, GOAL, OWN_STATE, RADIO

_INPUTS = {one.name: "Float64" if one.unit else "Boolean" for one in DRIVER_INPUTS}
"""The inputs that a unit may have, with their types."""
_OUTPUTS = tuple(one.name for one in ACCELERATION)
MOST_UNPACKED = 256 << 20
"""Bytes that a unit unpacks to at most."""
_STEP = 0.05
"""Of the trial where the unit names no step size [s]."""
_FAULTY = 2
"""The least status of a message that tells a fault (fmi3Discard)."""


def _one_line(text: object) -> str:
    flat = " ".join(str(text).split())
    return flat if len(flat) <= 240 else f"{flat[:240]} ..."


def _free(fmu: Any) -> None:  # noqa: ANN401 - fmpy has no types
    with contextlib.suppress(Exception):
        fmu.terminate()
    with contextlib.suppress(Exception):
        fmu.dll.finalizePythonInterpreter()  # of pythonfmu3's units alone: see `slave`
    with contextlib.suppress(Exception):
        fmu.freeInstance()


class _Instance:
    """One UGV's instance of a unit; freed when nobody has it any more."""

    def __init__(self, fmu: Any, time: float) -> None:  # noqa: ANN401
        said: list[str] = []
        self._said = said
        self.fmu = fmu

        def listen(_where: object, status: int, _category: object, text: bytes | None) -> None:
            if status >= _FAULTY and text:
                said.append(text.decode("utf-8", "replace"))

        self._freed = weakref.finalize(self, _free, fmu)
        try:
            fmu.instantiate(loggingOn=False, logMessage=listen)
            sys.path[:] = dict.fromkeys(sys.path)  # pythonfmu3 adds its folder with each instance
            fmu.enterInitializationMode(startTime=time)
            fmu.exitInitializationMode()
        except Exception as error:
            raise ScenarioError(f"cannot be started: {self.give_up(error)}") from error

    def give_up(self, error: BaseException) -> str:
        """The unit's own last word about a fault, or else the error's; nobody may call it any more, even to free it."""
        self._freed.detach()
        return _one_line(self._said[-1] if self._said else error)


def _check_size(path: str, where: str) -> None:
    """Check what an archive says that it unpacks to, before it is unpacked.

    Raises:
        ScenarioError: If that is too much.
    """
    with zipfile.ZipFile(path) as archive:
        size = sum(entry.file_size for entry in archive.infolist())
    if size > MOST_UNPACKED:
        raise ScenarioError(
            f"{where}: unpacks to {size >> 20:,} MiB; allowed: {MOST_UNPACKED >> 20} MiB at most"
        )


class FmuPolicy:
    """A unit, `FILE.fmu`, that has been read and tried; each UGV has an instance of its own.

    fmpy is imported here, and never else.

    Args:
        path: The file.
        where: It stands in errors.

    Raises:
        ScenarioError: If it cannot drive a UGV.
    """

    def __init__(self, path: str, where: str) -> None:
        if not Path(path).is_file():
            raise ScenarioError(f"{where}: no such file: {path or 'none is named'}")
        with needs("fmi", where):
            import fmpy  # noqa: PLC0415
            from fmpy.fmi3 import FMU3Slave  # noqa: PLC0415
        self._where = where
        self._folder = tempfile.mkdtemp(prefix="outrider-fmu-")
        weakref.finalize(self, shutil.rmtree, self._folder, ignore_errors=True)
        try:
            _check_size(path, where)
            fmpy.extract(path, self._folder)
            xml = Path(self._folder, "modelDescription.xml")
            version = ElementTree.parse(xml).getroot().get("fmiVersion")  # noqa: S314 - its code is run next
            if version is not None and not version.startswith("3."):
                raise ScenarioError(f"{where}: of FMI {version}; allowed: FMI 3.0")
            described = fmpy.read_model_description(self._folder)
        except ScenarioError:
            raise
        except Exception as error:
            raise ScenarioError(f"{where}: not an FMU: {_one_line(error)}") from error
        self._check(described)
        self._check_platform(fmpy.platform_tuple)
        self._make: Any = FMU3Slave
        step = described.defaultExperiment and described.defaultExperiment.stepSize
        self._try(float(step or _STEP))

    def _check(self, described: Any) -> None:  # noqa: ANN401
        where = self._where
        if described.coSimulation is None:
            raise ScenarioError(f"{where}: not for co-simulation; allowed: units that are")
        by_name = {one.name: one for one in described.modelVariables}
        inputs = [one for one in described.modelVariables if one.causality == "input"]
        for one in inputs:
            if _INPUTS.get(one.name) != one.type or one.dimensions:
                allowed = ", ".join(f"{name} ({kind})" for name, kind in _INPUTS.items())
                raise ScenarioError(
                    f"{where}: has an input {one.name!r} ({one.type}); allowed: {allowed}"
                )
        for name in _OUTPUTS:
            one = by_name.get(name)
            if one is None or one.causality != "output" or one.type != "Float64" or one.dimensions:
                raise ScenarioError(
                    f"{where}: has no output {name!r} (Float64); needed: {' and '.join(_OUTPUTS)}"
                )
        self._inputs = {
            kind: [(one.name, one.valueReference) for one in inputs if one.type == kind]
            for kind in set(_INPUTS.values())
        }
        self._outputs = [by_name[name].valueReference for name in _OUTPUTS]
        self._token = described.instantiationToken
        self._identifier = described.coSimulation.modelIdentifier

    def _check_platform(self, here: str) -> None:
        made = sorted(one.name for one in Path(self._folder, "binaries").glob("*"))
        if here not in made:
            raise ScenarioError(
                f"{self._where}: made for {', '.join(made) or 'no platform'}; this one is {here}"
            )

    def _try(self, step: float) -> None:
        """Make one step at the origin, as a flight would.

        Raises:
            ScenarioError: If the unit cannot, or answers no numbers.
        """
        try:
            answer, _ = self.predict([0.0] * len(UGV), None, dt=step)
        except ScenarioError as error:
            raise ScenarioError(f"{self._where}: {error}") from error
        if not all(math.isfinite(value) for value in answer):
            raise ScenarioError(f"{self._where}: answers {answer}; allowed: two finite numbers")

    def _instance(self, time: float) -> _Instance:
        try:
            fmu = self._make(
                instanceName="ugv",
                guid=self._token,
                modelIdentifier=self._identifier,
                unzipDirectory=self._folder,
            )
        except Exception as error:
            raise ScenarioError(f"cannot be loaded: {_one_line(error)}") from error
        return _Instance(fmu, time)

    def predict(
        self,
        row: "Row | list[float]",
        state: _Instance | None,
        *,
        dt: float,
        perceived: UgvObservation | None = None,
    ) -> tuple[list[float], _Instance]:
        """The acceleration, and the instance that gave it.

        Args:
            row: The UGV's row, `bus.observations.UGV`.
            state: The instance of this UGV; None: it is made.
            dt: Length of a tick [s].
            perceived: For what the UGV has received by radio; None: nothing.

        Raises:
            ScenarioError: If the unit cannot be started here or refuses the step.
        """
        seen = dict(zip(names(UGV), map(float, row), strict=True))
        instance = self._instance(seen["time"]) if state is None else state
        fmu, values = instance.fmu, _values(seen, perceived)
        try:
            for kind, inputs in self._inputs.items():
                if inputs:
                    put = fmu.setBoolean if kind == "Boolean" else fmu.setFloat64
                    put([place for _, place in inputs], [values[name] for name, _ in inputs])
            fmu.doStep(currentCommunicationPoint=seen["time"], communicationStepSize=dt)
            return fmu.getFloat64(self._outputs), instance
        except Exception as error:
            raise ScenarioError(instance.give_up(error)) from error


def _values(seen: Mapping[str, float], perceived: UgvObservation | None) -> Mapping[str, float]:
    values: dict[str, float] = dict.fromkeys(_INPUTS, 0.0)
    motion = seen["x"], seen["y"], seen["vx"], seen["vy"]
    values |= zip((one.name for one in OWN_STATE), motion, strict=True)
    goal = bool(seen["underway"]), seen["goal_x"], seen["goal_y"]
    values |= zip((one.name for one in GOAL), goal, strict=True)
    received = perceived.radio[-1:] if perceived is not None else ()
    for message in received:
        told = True, message.time, *message.relative_position, message.coverage_error
        values |= zip((one.name for one in RADIO), told, strict=True)
    values["radio.new"] = bool(received)
    return values
