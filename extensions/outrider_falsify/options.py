"""Options of `outrider falsify`."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Literal

import typer

FLIGHT, ATTACK = 60.0, 200.0
"""The length of a run by default [s]."""
DEFAULTS = {"delay": 1.0, "loss": 0.3, "blackout": 5.0, "command_delay": 0.5}
"""The limits by default [s], share, [s], [s]; `noise` is the scenario's."""
_MOST = {"delay": 30.0, "loss": 0.99, "blackout": 1000.0, "command_delay": 30.0, "noise": 100.0}
"""The largest value of each limit."""
_UNDEGRADED = "none"

Expect = Literal["none", "some"]
"""The violations that are expected; the exit code tells whether it is so."""
Engine = Literal["flights", "attack"]


class ControlGuard(StrEnum):
    """Guards that are known to be wrong."""

    TRACKING = "tracking"
    ARGMIN = "argmin"
    PAPER_RADIUS = "paper-radius"
    SWITCHING = "switching"


Law = Annotated[
    str | None, typer.Option("--law", help="The law to be broken, instead of the scenario's.")
]
Limit = Annotated[
    list[str] | None,
    typer.Option(
        "--limit",
        metavar="KEY=VALUE|none",
        help="The most that noise and network may do; may be repeated. Of detections: delay in s, jitter and all "
        f"({DEFAULTS['delay']:g} by default), loss as a share ({DEFAULTS['loss']:g}), blackout in s "
        f"({DEFAULTS['blackout']:g}), noise as standard deviation per axis in m (the scenario's); of the UAV's "
        f"commands: command_delay in s ({DEFAULTS['command_delay']:g}). none: no noise and a perfect network, the "
        "UGV's motion and the start alone.",
    ),
]
Error = Annotated[
    float | None,
    typer.Option("--error", help="For the attack: only this largest error of a detection, in m."),
]
Runs = Annotated[
    int | None, typer.Option(help="How many runs; the same seed finds the same.", min=1)
]
Minutes = Annotated[float | None, typer.Option(help="For how long; 1 minute by default.", min=0.01)]
Duration = Annotated[
    float | None,
    typer.Option(
        help=f"Of a run in s; {FLIGHT:g} by default, {ATTACK:g} for the attack.", min=0.05
    ),
]
Seed = Annotated[int, typer.Option(help="Of the search.", min=0, max=2**53 - 1)]
Jobs = Annotated[
    int | None, typer.Option(help="Worker processes; one a core by default.", min=1, max=1024)
]
Expected = Annotated[
    Expect | None,
    typer.Option(help="Exit with 1 if violations are found (none), or if none is (some)."),
]
OneEngine = Annotated[
    Engine | None,
    typer.Option(help="For the law certified: whole flights alone, or the compiled attack alone."),
]
Control = Annotated[
    ControlGuard | None,
    typer.Option(
        help="Attack a guard that is known to be wrong in the place of the filter, to see that it is caught."
    ),
]
Out = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE", help="Where the counterexample goes; counterexample-LAW.toml by default."
    ),
]


def limits_of(given: list[str] | None, noise: float) -> dict[str, float]:
    """Read the numbers of `SearchLimits`.

    Args:
        given: As `KEY=VALUE`, or `none` alone.
        noise: The scenario's [m].

    Raises:
        BadParameter: If one is unknown or out of range.
    """
    if _UNDEGRADED in (given or ()):
        if given != [_UNDEGRADED]:
            raise typer.BadParameter("--limit none allows nothing: leave the other limits out")
        return {}
    limits = DEFAULTS | {"noise": noise}
    for text in given or ():
        key, _, told = text.partition("=")
        if key not in _MOST:
            allowed = ", ".join((*_MOST, _UNDEGRADED))
            raise typer.BadParameter(f"--limit {text}: no such limit; allowed: {allowed}")
        try:
            value = float(told)
        except ValueError:
            raise typer.BadParameter(f"--limit {text}: allowed: {key}=NUMBER") from None
        if not 0.0 <= value <= _MOST[key]:
            raise typer.BadParameter(f"--limit {text}: out of range; allowed: 0 to {_MOST[key]:g}")
        limits[key] = value
    return limits
