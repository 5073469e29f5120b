"""Saved policies, `KIND:FILE`: the kinds that extensions and other packages register under `outrider.policies`."""

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

from bus import plugins

Vehicle = Literal["uav", "ugv"]


@dataclass(frozen=True, slots=True, kw_only=True)
class PolicyKind:
    """Kind of saved policies: the object of an entry point, whose name is the text before the colon.

    A loader is a `module:function`, imported when a policy is loaded. It is called with the text after the colon, and
    with the field and value for error messages.
    """

    form: str
    """Form of the text after the colon, such as `FILE.onnx`."""
    ugv: str = ""
    """Loader of a policy that drives a UGV: a function, or an object with a method `predict`."""
    uav: str = ""
    """Loader of a policy that flies a UAV: `agents.laws.policy.UavPolicy`."""


@functools.cache
def policy_kinds(vehicle: Vehicle) -> Mapping[str, PolicyKind]:
    """Return the kinds of policies for this kind of vehicle by name."""
    kinds = plugins.load_all("policies", PolicyKind)
    return MappingProxyType(
        {name: kind for name, kind in kinds.items() if getattr(kind, vehicle) != ""}
    )


def is_policy_file(text: str, vehicle: Vehicle) -> bool:
    """Return true for `KIND:...` of a kind of saved policies for this kind of vehicle.

    Raises:
        ValueError: If the kind is for the other kind of vehicle only; what is wrong, without the allowed forms.
    """
    kind, separator, _ = text.partition(":")
    if not separator:
        return False
    other: Vehicle = "ugv" if vehicle == "uav" else "uav"
    if kind in policy_kinds(other) and kind not in policy_kinds(vehicle):
        raise ValueError(f"{kind}: is for a {other.upper()} only, not for a {vehicle.upper()}")
    return kind in policy_kinds(vehicle)


def policy_forms(vehicle: Vehicle) -> str:
    """Return the allowed forms of a policy for this kind of vehicle, for error messages."""
    forms = ["module:function"]
    forms += [f"{name}:{kind.form}" for name, kind in sorted(policy_kinds(vehicle).items())]
    return " or ".join([*([", ".join(forms[:-1])] if forms[1:] else []), forms[-1]])


def endings() -> frozenset[str]:
    """Return the suffixes of policy files, such as `.onnx`."""
    vehicles: tuple[Vehicle, ...] = ("uav", "ugv")
    forms = {kind.form for vehicle in vehicles for kind in policy_kinds(vehicle).values()}
    return frozenset(f".{form.rpartition('.')[2]}" for form in forms if "." in form)
