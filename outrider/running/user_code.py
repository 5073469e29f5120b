"""Loading and checking of user code: functions named as module:function, and saved policies named as KIND:FILE."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from agents.drivers.policy import RowPolicy
from bus import plugins
from bus.errors import ScenarioError
from bus.policies import Vehicle, endings, is_policy_file, policy_forms, policy_kinds
from bus.registry import resolve
from outrider.running.user_modules import find_object
from sim.input.faults import one_line

if TYPE_CHECKING:
    from sim.scenario.types import Scenario


_POLICIES: dict[str, Vehicle] = {"policy": "ugv", "uav_policy": "uav"}
"""Fields that name a policy, with the kind of vehicle."""


def load_function(name: str, *, what: str) -> Callable[..., Any] | None:
    """Load the function named `module:function`; return None for an empty name.

    Modules in the working folder are found last.

    Args:
        name: `module:function`, or another form that `load_policy` accepts.
        what: Field that names the function, for errors; `policy` and `uav_policy` select the loader of policies.

    Raises:
        ScenarioError: If the function does not exist or is not callable.
    """
    if not name:
        return None
    vehicle = _POLICIES.get(what.rpartition(".")[2])
    if vehicle is not None:
        policy: Callable[..., Any] = load_policy(name, vehicle, what=what)
        return policy
    found = _named(name, what)
    if not callable(found):
        raise ScenarioError(f"{what} = {name!r}: not a function; allowed: module:function")
    loaded: Callable[..., Any] = found
    return loaded


def _named(name: str, what: str) -> Any:  # noqa: ANN401 - any object
    """Return the object named `module:name`."""
    return find_object(name, what)


def _load_saved(name: str, what: str, vehicle: Vehicle) -> Any:  # noqa: ANN401 - each kind has its own
    """Load `KIND:FILE`; return None if no kind of saved policies stands before the colon.

    Raises:
        ScenarioError: If the policy cannot be loaded, its kind is for other vehicles, or the name is a file without its
            kind.
    """
    try:
        is_file = is_policy_file(name, vehicle)
    except ValueError as error:
        raise ScenarioError(
            f"{what} = {name!r}: {error}; allowed: {policy_forms(vehicle)}"
        ) from error
    if is_file:
        kind, _, rest = name.partition(":")
        with plugins.foreign(f"{what} = {name!r}"):
            load = resolve(getattr(policy_kinds(vehicle)[kind], vehicle))
        return load(rest, f"{what} = {name!r}")
    if Path(name).suffix in endings():
        allowed = policy_forms(vehicle)
        raise ScenarioError(
            f"{what} = {name!r}: the kind of the file is missing; allowed: {allowed}"
        )
    return None


def load_policy(name: str, vehicle: Vehicle = "uav", *, what: str = "policy") -> Any:  # noqa: ANN401 - of several forms
    """Load a policy, as every option and field that names one does.

    The library that saved a policy must be installed to load it. Loading may run code in the file, so load only
    trusted files. A policy for a UAV maps the observations of one UAV in all worlds to its accelerations [m/s²], shape
    (worlds, 2); a saved one is loaded with the observation that it was trained on. A policy for a UGV is a function of
    its observation and briefing, or an object that predicts from its row (`bus.observations.UGV`).

    Args:
        name: `module:function`, `module:object`, or `KIND:FILE` of a saved policy (`bus.policies`).
        vehicle: "uav" or "ugv".
        what: Field that names the policy, for errors.

    Raises:
        ScenarioError: If the policy does not exist, cannot be loaded, or has the wrong type.
    """
    if vehicle not in ("uav", "ugv"):
        raise ValueError(f"vehicle = {vehicle!r}; allowed: 'uav', 'ugv'")
    saved = _load_saved(name, what, vehicle)
    if saved is not None:
        return saved
    found = _named(name, what)
    predicts = vehicle == "ugv" and isinstance(found, RowPolicy)
    if isinstance(found, type) or not (callable(found) or predicts):
        other = "an object with a method predict" if vehicle == "ugv" else "a callable object"
        raise ScenarioError(f"{what} = {name!r}: not a policy; allowed: a function, or {other}")
    return found


def own_code(scenario: "Scenario") -> dict[str, str]:
    """Return all fields of a scenario that name code, with their values."""
    custom: Any = scenario.custom
    named = {f"custom.{name}": getattr(custom, name) for name in custom.__struct_fields__}
    return {field: value for field, value in named.items() if value}


def foreign_code(scenario: "Scenario", named: Iterable[str] = ()) -> tuple[str, ...]:
    """Return a message for each field in which the file, not the user, names code.

    Such code is loaded only with the user's permission.

    Args:
        scenario: Scenario to fly.
        named: Fields that the user has set, as `field` or `field=value`.
    """
    changes = [change.partition("=") for change in named]
    own = {field.strip() for field, _, _ in changes}
    # ugv.0.driver=fmu:FILE and ugv.0.driver=policy:module:function name code, too
    values = {value.strip().strip("\"'").removeprefix("policy:") for _, _, value in changes}
    given = {} if "custom" in own else own_code(scenario)
    return tuple(
        f"{field} = {value!r}: the file names code; allow it with --allow-code (in Python: allow_code=True)"
        for field, value in given.items()
        if field not in own and value not in values
    )


def check_code(
    scenario: "Scenario", named: Iterable[str] = (), *, source: object, allowed: bool
) -> None:
    """Check that the scenario's file names no code, unless code is allowed; arguments as in `foreign_code`.

    Raises:
        ScenarioError: If a field of the file names code; the error names the first one.
    """
    for line in () if allowed else foreign_code(scenario, named):
        raise ScenarioError(f"{one_line(str(source))}: {line}, if you trust both")
