"""Conversion of a law's parameters from a message to the class declared in the law's file."""

from collections.abc import Mapping
from typing import Any

import msgspec

from bus.errors import ScenarioError
from bus.messages.scenario import Law, LawNumber
from bus.registry import LAWS, module_of, usable
from bus.rows import LawRow


def parameters_class(name: str) -> type[msgspec.Struct] | None:
    """Return the class of a law's parameters; None for a law without a file."""
    return _declared(LAWS[name])


def _declared(row: LawRow) -> type[msgspec.Struct] | None:
    if not row.module:
        return None
    declared: type[msgspec.Struct] = module_of(row, "Parameters").Parameters
    return declared


def parameter_names(name: str) -> tuple[str, ...]:
    """Return the names of a law's parameters."""
    parameters = parameters_class(name)
    return () if parameters is None else parameters.__struct_fields__


def own_parameters(law: Law) -> Mapping[str, LawNumber]:
    """Return the given parameters that belong to the law: a scenario may hold parameters of several laws."""
    own = parameter_names(law.name)
    return {name: value for name, value in law.parameters.items() if name in own}


def unknown_parameters(law: Law) -> tuple[str, ...]:
    """Return the given parameters that belong to no law."""
    others = [name for name in law.parameters if name not in parameter_names(law.name)]
    if not others:
        return ()
    usable(LAWS.values(), _declared)
    known = {name for row in LAWS for name in parameter_names(row)}
    return tuple(name for name in others if name not in known)


def law_parameters(law: Law) -> Any:  # noqa: ANN401 - the law's own class
    """Return the parameters of a law as its declared class; None for a law without a file.

    Raises:
        ScenarioError: If a parameter has a wrong type, is out of bounds, or belongs to no law.
    """
    for name in unknown_parameters(law):
        allowed = ", ".join(parameter_names(law.name)) or "none"
        raise ScenarioError(f"law.parameters.{name}: unknown parameter; allowed: {allowed}")
    parameters = parameters_class(law.name)
    if parameters is None:
        return None
    try:
        return msgspec.convert(own_parameters(law), parameters)
    except msgspec.ValidationError as error:
        raise ScenarioError(f"law.parameters of {law.name}: {error}") from error
