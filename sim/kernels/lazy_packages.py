"""Packages whose `__init__` runs when something is first asked of it, not when they are passed on the way to a module.

Some packages import all that they have when they are opened, where one module is needed: filterpy every filter and
with them `scipy.stats`, `scipy.linalg` half of SciPy and `numpy.f2py`, for the one extension module by which numba
finds BLAS. Whoever wants more of such a package opens it, and finds what its own import would have given.
"""

import sys
from importlib.util import find_spec, module_from_spec
from types import ModuleType


def enter(name: str) -> ModuleType:
    """A package that is not open yet; as it is, where it has been imported before.

    Args:
        name: Of the package; those around it have been imported or entered.

    Raises:
        ModuleNotFoundError: If it is not installed.
    """
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
