"""Conversion of a law's parameters from a scenario's table to the class in the law's row."""

from collections.abc import Mapping
from typing import Any

import msgspec

from bus.errors import ScenarioError
from bus.messages.scenario import Law, LawNumber
from bus.registry import LAWS


def parameter_names(name: str) -> tuple[str, ...]:
    """Return the names of a law's parameters."""
    return LAWS[name].parameters.__struct_fields__


def own_parameters(law: Law) -> Mapping[str, LawNumber]:
    """Return the given parameters that belong to the law: a scenario may hold parameters of several laws."""
    own = parameter_names(law.name)
    return {name: value for name, value in law.parameters.items() if name in own}


def unknown_parameters(law: Law) -> tuple[str, ...]:
    """Return the given parameters that belong to no law."""
    known = {name for row in LAWS for name in parameter_names(row)}
    return tuple(name for name in law.parameters if name not in known)


def law_parameters(law: Law) -> Any:  # noqa: ANN401 - the law's own class
    """Return the parameters of a law as the class in its row.

    Raises:
        ScenarioError: If a parameter has a wrong type, is out of bounds, or belongs to no law.
    """
    for name in unknown_parameters(law):
        allowed = ", ".join(parameter_names(law.name)) or "none"
        raise ScenarioError(f"law.parameters.{name}: unknown parameter; allowed: {allowed}")
    try:
        return msgspec.convert(own_parameters(law), LAWS[law.name].parameters)
    except msgspec.ValidationError as error:
        raise ScenarioError(f"law.parameters of {law.name}: {error}") from error
