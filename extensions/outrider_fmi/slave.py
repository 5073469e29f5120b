"""Python part of an exported unit: copied into the unit, and run by its library.

The Python that loads the unit needs outrider in the version that exported it.
"""

import ctypes
import hashlib
import sys
import weakref
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pythonfmu3 import Fmi3Causality, Fmi3Slave, Fmi3Status, Fmi3Variability
from pythonfmu3.default_experiment import DefaultExperiment
from pythonfmu3.fmi3slave import Fmi3StepResult
from pythonfmu3.unit import Unit
from pythonfmu3.variables import Boolean, Float64, String

from outrider_fmi.unit_files import open_unit
from outrider_fmi.variables import Variable

_UNITS = (
    Unit("m", m=1),
    Unit("s", s=1),
    Unit("m/s", m=1, s=-1),
    Unit("m/s2", m=1, s=-2),
    Unit("m2", m=2),
    Unit("rad", rad=1),
    Unit("rad/s", rad=1, s=-1),
)
_RETAINED: set[Path] = set()
"""Libraries for which this process keeps a reference to Python."""


class OutriderUnit(Fmi3Slave):  # type: ignore[misc]  # pythonfmu3 has no types
    """Vehicle of an Outrider scenario, or a whole run."""

    def __init__(self, **given: Any) -> None:  # noqa: ANN401 - pythonfmu3's own
        super().__init__(**given)
        folder = Path(given["resources"])
        _protect_heap(self, folder)
        self._unit = unit = open_unit(folder)
        self.description = f"{unit.about}; needs outrider in the Python that loads it"
        self.version = version("outrider")
        self.guid = _token(folder)
        self.default_experiment = DefaultExperiment(0.0, unit.duration, unit.dt)
        self.register_units(list(_UNITS))
        self._values = {one.name: one.initial for one in unit.inputs}
        self._values |= unit.start()
        self._time = 0.0
        clock = {
            "causality": Fmi3Causality.independent,
            "variability": Fmi3Variability.continuous,
            "description": "Simulated time",
            "getter": lambda: self._time,
        }
        self.register_variable(Float64("time", unit="s", **clock), nested=False)
        for one in unit.inputs:
            self._register(one, Fmi3Causality.input)
        for one in unit.outputs:
            self._register(one, Fmi3Causality.output)

    def _register(self, one: Variable, causality: Fmi3Causality) -> None:
        attributes: dict[str, Any] = {
            "causality": causality,
            "variability": Fmi3Variability.discrete,  # values change at communication points
            "description": one.about,
            "getter": partial(self._values.__getitem__, one.name),
            "setter": partial(self._values.__setitem__, one.name),
        }
        made = (
            Float64(one.name, unit=one.unit, **attributes)
            if one.unit
            else (String if one.text else Boolean)(one.name, **attributes)
        )
        self.register_variable(made, nested=False)

    def do_step(self, current_time: float, step_size: float) -> Fmi3StepResult:
        """Advance one tick; report a wrong step or a non-finite input as an error of the master."""
        inputs = {one.name: self._values[one.name] for one in self._unit.inputs}
        try:
            self._values |= self._unit.step(current_time, step_size, inputs)
        except ValueError as error:
            self.log(str(error), Fmi3Status.error)
            return Fmi3StepResult(status=Fmi3Status.error)
        self._time = current_time + step_size
        return Fmi3StepResult(status=Fmi3Status.ok)


def _protect_heap(unit: OutriderUnit, folder: Path) -> None:
    """Prevent pythonfmu3's library from releasing Python twice when it is unloaded or the process ends.

    Its destructor runs after its global variable's (0.3.4) and corrupts the heap: every second master aborted at exit.
    In a Python process the reference is released earlier, with the unit. A master in another language lets the library
    start Python, which cannot be restarted; there, two instances that are never freed keep the reference.
    """
    ours = list(folder.parent.glob(f"binaries/*/{type(unit).__name__}.so"))
    if not ours:
        return
    library = ctypes.CDLL(str(ours[0]))
    if sys.orig_argv:
        weakref.finalize(unit, _release, library)
    elif ours[0] not in _RETAINED:
        _RETAINED.add(ours[0])
        make, resources = library.fmi3InstantiateCoSimulation, str(folder / "placeholder")
        make.restype = ctypes.c_void_p
        flags, none = (False,) * 4, ctypes.c_void_p()
        for _ in range(2):
            make(
                b"placeholder",
                b"",
                resources.encode(),
                *flags,
                none,
                ctypes.c_size_t(),
                *(none,) * 3,
            )


def _release(library: ctypes.CDLL) -> None:
    import _ctypes  # noqa: PLC0415 - systems without `dlclose` have no .so

    library.finalizePythonInterpreter()
    _ctypes.dlclose(library._handle)


def _token(folder: Path) -> str:
    """Return an identifier of the unit's content; pythonfmu3's own would reveal the exporting machine."""
    files = sorted(one for one in folder.iterdir() if one.suffix in (".json", ".msgpack", ".txt"))
    contents = [one.read_bytes() for one in files if one.name != "slavemodule.txt"]
    return hashlib.sha256(b"\0".join(contents)).hexdigest()[:32]
