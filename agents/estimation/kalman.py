"""filterpy's Kalman filter, without the rest of filterpy until somebody asks for it.

Its packages import every filter when they are opened, and for them `scipy.stats` and `scipy.linalg`: more processor
time than all else that a pilot loads. The filter needs neither, so the packages are entered without being opened.
Whoever wants more of them opens them, and finds what filterpy's own import would have given.
"""

import sys
from importlib import import_module
from importlib.util import find_spec, module_from_spec
from types import ModuleType
from typing import Any

__all__ = ["KalmanFilter"]


def _enter(name: str) -> ModuleType:
    """A package whose `__init__` runs when something is first asked of it that it does not have yet."""
    if name in sys.modules:
        return sys.modules[name]
    spec = find_spec(name)
    if spec is None or spec.loader is None:
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)
    package, loader = module_from_spec(spec), spec.loader

    def open_package(attribute: str) -> object:
        if package.__dict__.pop("__getattr__", None) is not None:
            loader.exec_module(package)
        return getattr(package, attribute)

    package.__dict__["__getattr__"] = open_package
    sys.modules[name] = package
    parent, _, child = name.rpartition(".")
    if parent:
        setattr(sys.modules[parent], child, package)
    return package


def _log_density(*arguments: Any, **named: Any) -> float:  # noqa: ANN401 - filterpy's
    """`filterpy.stats.logpdf`, which a filter asks for its likelihood alone, loaded then."""
    density: float = import_module("filterpy.stats.stats").logpdf(*arguments, **named)
    return density


def _load() -> Any:  # noqa: ANN401 - a class that has no types
    if "filterpy" in sys.modules:
        return import_module("filterpy.kalman").KalmanFilter
    _enter("filterpy")
    common, stats = _enter("filterpy.common"), _enter("filterpy.stats")
    _enter("filterpy.kalman")
    helpers = import_module("filterpy.common.helpers")
    needed = {common: ("pretty_str", "reshape_z"), stats: ("logpdf",)}
    common.__dict__.update({name: getattr(helpers, name) for name in needed[common]})
    stats.__dict__["logpdf"] = _log_density
    found = import_module("filterpy.kalman.kalman_filter").KalmanFilter
    for package, names in needed.items():
        if "__getattr__" in package.__dict__:  # still not opened: what it was lent goes again
            for name in names:
                del package.__dict__[name]
    return found


KalmanFilter: Any = _load()
"""The class `filterpy.kalman.KalmanFilter`."""
