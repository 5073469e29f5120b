"""Functions of the user's own, named as module:function, and saved policies, named as KIND:FILE."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from agents.drivers.policy import RowPolicy
from bus.errors import ScenarioError
from bus.policies import Vehicle, endings, policy_forms, policy_kinds
from bus.registry import (
    LAWS,
    resolve,
)
from outrider.running.user_modules import find_object
from sim.input.faults import one_line

if TYPE_CHECKING:
    from agents.laws.policy import UavPolicy
    from sim.scenario.types import Scenario


def load_function(name: str, *, what: str) -> Callable[..., Any] | None:
    """The function that `module:function` names; None for an empty name. The working folder is searched last.

    Args:
        name: Where it is.
        what: What it is for, for the error; a `policy` may also be saved, or an object that predicts: see
            `load_policy`; so may a `uav_policy`: see `load_uav_policy`.

    Raises:
        ScenarioError: If it is not there, or no function.
    """
    if not name:
        return None
    if what.rpartition(".")[2] == "uav_policy":
        return load_uav_policy(name, what=what)
    if what.rpartition(".")[2] == "policy":
        policy: Callable[..., Any] = load_policy(name, what=what)
        return policy
    found = _named(name, what)
    if not callable(found):
        raise ScenarioError(f"{what} = {name!r}: not a function")
    loaded: Callable[..., Any] = found
    return loaded


def _named(name: str, what: str) -> Any:  # noqa: ANN401 - whatever it is
    """The object that `module:name` names."""
    return find_object(name, what)


def _load_saved(name: str, what: str, vehicle: Vehicle) -> Any:  # noqa: ANN401 - each kind has its own
    """Load `KIND:FILE`; return None if the name has no kind of saved policies before its colon.

    Raises:
        ScenarioError: If it cannot be loaded, or the name is a file without its kind.
    """
    kind, separator, rest = name.partition(":")
    kinds = policy_kinds(vehicle)
    if separator and kind in kinds:
        return resolve(getattr(kinds[kind], vehicle))(rest, f"{what} = {name!r}")
    if Path(name).suffix in endings():
        allowed = policy_forms(vehicle)
        raise ScenarioError(f"{what} = {name!r}: a file without its kind; allowed: {allowed}")
    return None


def load_policy(name: str, *, what: str = "policy") -> Any:  # noqa: ANN401 - a function, or an object that predicts
    """A policy for the driver `policy`.

    What a library has saved is loaded by that library, which must be installed, and runs code that is in the file:
    load only what you trust. It sees the UGV's row as the environment gives it (`bus.observations.UGV`) and answers the
    acceleration.

    Args:
        name: `module:function`, `module:object` with a method `predict`, or `KIND:FILE` of a saved policy
            (`bus.policies`).
        what: What it is for, for the error.

    Raises:
        ScenarioError: If it is not there, cannot be loaded, or is none.
    """
    saved = _load_saved(name, what, "ugv")
    if saved is not None:
        return saved
    found = _named(name, what)
    if isinstance(found, type) or not (callable(found) or isinstance(found, RowPolicy)):
        raise ScenarioError(
            f"{what} = {name!r}: neither a function nor an object with a method predict"
        )
    return found


def load_uav_policy(name: str, *, what: str = "uav_policy") -> "UavPolicy":
    """A policy for UAVs: the observations of one UAV in all worlds in, its accelerations out, shape (worlds, 2).

    What a library has saved is loaded with the observation that it was trained on, and may run code that is in the
    file: load only what you trust.

    Args:
        name: `module:function`, or `KIND:FILE` of a saved policy (`bus.policies`).
        what: What it is for, for the error.

    Raises:
        ScenarioError: If it is not there, cannot be loaded, or is none.
    """
    saved: UavPolicy | None = _load_saved(name, what, "uav")
    if saved is not None:
        return saved
    found = _named(name, what)
    if isinstance(found, type) or not callable(found):
        raise ScenarioError(f"{what} = {name!r}: neither a function nor an object that is called")
    policy: UavPolicy = found
    return policy


def own_code(scenario: "Scenario") -> dict[str, str]:
    """The code that a scenario names, whoever has named it: its fields with their values."""
    custom: Any = scenario.custom
    named = {f"custom.{name}": getattr(custom, name) for name in custom.__struct_fields__}
    return {field: value for field, value in named.items() if value}


def foreign_code(scenario: "Scenario", named: Iterable[str] = ()) -> tuple[str, ...]:
    """The code that a scenario's file names, and not the user.

    It is somebody else's until the user says that it may be loaded.

    Args:
        scenario: What is flown.
        named: What the user has set: fields, or `field=value` as with `--set`.

    Returns:
        A line for each field.
    """
    changes = [change.partition("=") for change in named]
    own = {field.strip() for field, _, _ in changes}
    # ugv.0.driver=fmu:FILE says it too
    said = {value.strip().strip("\"'") for _, _, value in changes}
    given = {} if "custom" in own else own_code(scenario)
    return tuple(
        f"{field} = {value!r}: the file names code, which is loaded with --allow-code alone (in Python: "
        "allow_code=True)"
        for field, value in given.items()
        if field not in own and value not in said
    )


def check_code(
    scenario: "Scenario", named: Iterable[str] = (), *, source: object, allowed: bool
) -> None:
    """Refuse a scenario whose file names code, unless that is allowed; arguments otherwise as of `foreign_code`.

    Raises:
        ScenarioError: The first such field.
    """
    for line in () if allowed else foreign_code(scenario, named):
        raise ScenarioError(f"{one_line(str(source))}: {line}; allowed where you trust both")


def check_own_functions(scenario: "Scenario") -> tuple[str, ...]:
    """Load the scenario's own functions and hold them against what the paper asks of them, before anything is started.

    Returns:
        Warnings, one a line, where a path cannot be followed.

    Raises:
        ScenarioError: If a function is not there or does not fit.
    """
    if not own_code(scenario):
        return ()
    from agents.control.orbit import check_path  # noqa: PLC0415 - nobody else needs the laws
    from agents.control.visibility import switching_radius  # noqa: PLC0415
    from agents.control.weighting import check_weighting  # noqa: PLC0415
    from agents.laws.policy import check_fit  # noqa: PLC0415
    from sim.engine.briefing import uav_briefing  # noqa: PLC0415

    weighting = load_function(scenario.custom.weighting, what="custom.weighting")
    path = load_function(scenario.custom.path, what="custom.path")
    load_function(scenario.custom.policy, what="custom.policy")
    own = load_function(scenario.custom.uav_policy, what="custom.uav_policy")
    ugvs = {ugv.name: ugv for ugv in scenario.ugv}
    warnings: list[str] = []
    for uav in scenario.uav:
        if own is not None:
            briefing = uav_briefing(scenario, uav.name, 0)
            warnings += check_fit(briefing, own, scenario.custom.uav_policy)
        r_v, v_g = scenario.visibility.radius, ugvs[uav.escorts].max_speed
        if weighting is not None and LAWS[scenario.law.name].own == "weighting":
            check_weighting(
                weighting, switching_radius(r_v, uav.max_speed, v_g, uav.max_acceleration)
            )
        if path is not None and LAWS[scenario.law.name].own == "path":
            warnings += check_path(
                path, scenario.duration, r_v, uav.max_speed, v_g, uav.max_acceleration
            )
    return tuple(dict.fromkeys(warnings))
