"""Co-simulation unit as a UGV's driver and saved policy: `driver = "fmu:FILE.fmu"`.

At each tick the unit receives the values of its inputs and makes one step of a tick; its outputs are the acceleration.
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
from bus.observations import UGV, Row, names, ugv_table
from bus.plugins import needs
from outrider_fmi.variables import ACCELERATION, DRIVER_INPUTS, GOAL, HEADING, OWN_STATE, RADIO

_INPUTS = {one.name: "Float64" if one.unit else "Boolean" for one in DRIVER_INPUTS}
"""Allowed inputs of a unit, with their types."""
_OUTPUTS = tuple(one.name for one in ACCELERATION)
MOST_UNPACKED = 256 << 20
"""Largest size of an unpacked unit [bytes]."""
_STEP = 0.05
"""Step size of the trial for a unit without one [s]."""
_FAULTY = 2
"""Lowest status of an error message (fmi3Discard)."""


def _one_line(text: object) -> str:
    flat = " ".join(str(text).split())
    return flat if len(flat) <= 240 else f"{flat[:240]} ..."


def _free(fmu: Any) -> None:  # noqa: ANN401 - fmpy has no types
    with contextlib.suppress(Exception):
        fmu.terminate()
    with contextlib.suppress(Exception):
        fmu.dll.finalizePythonInterpreter()  # for pythonfmu3's units only, see `slave`
    with contextlib.suppress(Exception):
        fmu.freeInstance()


class _Instance:
    """Instance of a unit for one UGV; freed with its last reference."""

    def __init__(self, fmu: Any, time: float) -> None:  # noqa: ANN401
        errors: list[str] = []
        self._errors = errors
        self.fmu = fmu

        def listen(_where: object, status: int, _category: object, text: bytes | None) -> None:
            if status >= _FAULTY and text:
                errors.append(text.decode("utf-8", "replace"))

        self._freed = weakref.finalize(self, _free, fmu)
        try:
            fmu.instantiate(loggingOn=False, logMessage=listen)
            sys.path[:] = dict.fromkeys(sys.path)  # pythonfmu3 adds its folder with each instance
            fmu.enterInitializationMode(startTime=time)
            fmu.exitInitializationMode()
        except Exception as error:
            raise ScenarioError(f"cannot be started: {self.give_up(error)}") from error

    def give_up(self, error: BaseException) -> str:
        """Return the unit's last error message, else the exception's; the instance must not be used or freed again."""
        self._freed.detach()
        return _one_line(self._errors[-1] if self._errors else error)


def _check_size(path: str, where: str) -> None:
    """Check the declared size of an archive before unpacking.

    Raises:
        ScenarioError: If the size exceeds the limit.
    """
    with zipfile.ZipFile(path) as archive:
        size = sum(entry.file_size for entry in archive.infolist())
    if size > MOST_UNPACKED:
        raise ScenarioError(
            f"{where}: unpacks to {size >> 20:,} MiB; allowed: {MOST_UNPACKED >> 20} MiB or less"
        )


class FmuPolicy:
    """Unit `FILE.fmu`, read and tested; each UGV has an instance of its own.

    fmpy is imported only here.

    Args:
        path: File of the unit.
        where: Field and value, for errors.

    Raises:
        ScenarioError: If the unit cannot drive a UGV.
    """

    def __init__(self, path: str, where: str) -> None:
        if not Path(path).is_file():
            raise ScenarioError(f"{where}: no such file: {path or 'no file given'}")
        with needs("fmi", where):
            import fmpy  # noqa: PLC0415 - optional
            from fmpy.fmi3 import FMU3Slave  # noqa: PLC0415 - optional
        self._where = where
        self._folder = tempfile.mkdtemp(prefix="outrider-fmu-")
        weakref.finalize(self, shutil.rmtree, self._folder, ignore_errors=True)
        try:
            _check_size(path, where)
            fmpy.extract(path, self._folder)
            xml = Path(self._folder, "modelDescription.xml")
            version = ElementTree.parse(xml).getroot().get("fmiVersion")  # noqa: S314 - the unit's code runs next anyway
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
            raise ScenarioError(f"{where}: not for co-simulation; allowed: co-simulation units")
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

    def _check_platform(self, platform: str) -> None:
        made = sorted(one.name for one in Path(self._folder, "binaries").glob("*"))
        if platform not in made:
            raise ScenarioError(
                f"{self._where}: made for {', '.join(made) or 'no platform'}; this one is {platform}"
            )

    def _try(self, step: float) -> None:
        """Make one step at the origin as a test.

        Raises:
            ScenarioError: If the step fails or returns invalid numbers.
        """
        try:
            answer, _ = self.predict([0.0] * len(UGV), None, dt=step)
        except ScenarioError as error:
            raise ScenarioError(f"{self._where}: {error}") from error
        if not all(math.isfinite(value) for value in answer):
            raise ScenarioError(f"{self._where}: returned {answer}; allowed: two finite numbers")

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
        """Return the acceleration [m/s²] and the instance that computed it.

        Args:
            row: Row of the UGV, `bus.observations.ugv_table`.
            state: Instance of this UGV; None creates one.
            dt: Length of a tick [s].
            perceived: Observation with the radio messages of the UGV; None: without any.

        Raises:
            ScenarioError: If the unit cannot be started or rejects the step.
        """
        table = ugv_table(steers=len(row) > len(UGV))
        observed = dict(zip(names(table), map(float, row), strict=True))
        instance = self._instance(observed["time"]) if state is None else state
        fmu, values = instance.fmu, _values(observed, perceived)
        try:
            for kind, inputs in self._inputs.items():
                if inputs:
                    put = fmu.setBoolean if kind == "Boolean" else fmu.setFloat64
                    put(
                        [reference for _, reference in inputs], [values[name] for name, _ in inputs]
                    )
            fmu.doStep(currentCommunicationPoint=observed["time"], communicationStepSize=dt)
            return fmu.getFloat64(self._outputs), instance
        except Exception as error:
            raise ScenarioError(instance.give_up(error)) from error


def _values(observed: Mapping[str, float], perceived: UgvObservation | None) -> Mapping[str, float]:
    values: dict[str, float] = dict.fromkeys(_INPUTS, 0.0)
    state = observed["x"], observed["y"], observed["vx"], observed["vy"]
    values |= zip((one.name for one in OWN_STATE), state, strict=True)
    if "heading_x" in observed:
        values[HEADING[0].name] = math.atan2(observed["heading_y"], observed["heading_x"])
    goal = bool(observed["underway"]), observed["goal_x"], observed["goal_y"]
    values |= zip((one.name for one in GOAL), goal, strict=True)
    received = perceived.radio[-1:] if perceived is not None else ()
    for message in received:
        fields = True, message.time, *message.relative_position, message.coverage_error
        values |= zip((one.name for one in RADIO), fields, strict=True)
    values["radio.new"] = bool(received)
    return values
