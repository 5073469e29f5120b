"""Options of `outrider falsify`."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Literal

import typer

from bus.messages.base import MAX_SEED

FLIGHT, ATTACK = 60.0, 200.0
"""Default durations of a run [s]."""
DEFAULTS = {"delay": 1.0, "loss": 0.3, "blackout": 5.0, "command_delay": 0.5}
"""Default limits: [s], share, [s], [s]; `noise` defaults to the scenario's."""
TEAM_DEFAULTS = {"delay": 0.2, "loss": 0.3, "blackout": 0.5, "command_delay": 0.1}
"""Default limits with --team."""
_MOST = {"delay": 30.0, "loss": 0.99, "blackout": 1000.0, "command_delay": 30.0, "noise": 100.0}
"""Largest value of each limit."""
_UNDEGRADED = "none"

Expect = Literal["none", "some"]
"""Expected violations; the exit code reports the comparison."""
Engine = Literal["flights", "attack"]


class ControlGuard(StrEnum):
    """Guards with known faults."""

    TRACKING = "tracking"
    ARGMIN = "argmin"
    PAPER_RADIUS = "paper-radius"
    SWITCHING = "switching"


Law = Annotated[
    str | None, typer.Option("--law", help="Attack this law instead of the scenario's.")
]
Limit = Annotated[
    list[str] | None,
    typer.Option(
        "--limit",
        metavar="KEY=VALUE|none",
        help="Limit noise and network effects (repeatable). Keys and defaults: "
        f"delay {DEFAULTS['delay']:g} s, loss {DEFAULTS['loss']:g}, blackout {DEFAULTS['blackout']:g} s, "
        f"command_delay {DEFAULTS['command_delay']:g} s, noise in m (the scenario's). none: perfect network, no noise. "
        f"Defaults with --team: {', '.join(f'{value:g}' for value in TEAM_DEFAULTS.values())}.",
    ),
]
Error = Annotated[
    float | None,
    typer.Option("--error", help="Attack with this largest detection error only [m]."),
]
Runs = Annotated[
    int | None, typer.Option(help="Stop after this number of runs, which is reproducible.", min=1)
]
Minutes = Annotated[
    float | None, typer.Option(help="Stop after this time [min]; default: 1.", min=0.01)
]
Duration = Annotated[
    float | None,
    typer.Option(
        help=f"Set the duration of a run [s]; default: {FLIGHT:g}, attack {ATTACK:g}.", min=0.05
    ),
]
Seed = Annotated[int, typer.Option(help="Set the seed of the search.", min=0, max=MAX_SEED)]
Jobs = Annotated[
    int | None,
    typer.Option(
        help="Set the number of worker processes; default: one per core.", min=1, max=1024
    ),
]
Expected = Annotated[
    Expect | None,
    typer.Option(help="Exit with 1 unless this many violations are found."),
]
OneEngine = Annotated[
    Engine | None,
    typer.Option(help="Use one engine only: scenarios (flights) or the compiled attack."),
]
Control = Annotated[
    ControlGuard | None,
    typer.Option(help="Attack a faulty filter in place of the safety filter."),
]
Altitude = Annotated[
    bool,
    typer.Option("--altitude", help="Attack a UAV that dives and climbs over towns."),
]
Team = Annotated[
    bool,
    typer.Option("--team", help="Attack the guarantee of a team."),
]
Out = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE", help="Save the counterexample here; default: counterexample-LAW.toml."
    ),
]


def limits_of(
    given: list[str] | None, noise: float, defaults: dict[str, float] = DEFAULTS
) -> dict[str, float]:
    """Parse the arguments of `SearchLimits`.

    Args:
        given: Options `KEY=VALUE`, or `none` alone.
        noise: Noise of the scenario [m].
        defaults: Limits that are not given.

    Raises:
        BadParameter: If a limit is unknown or out of range.
    """
    if _UNDEGRADED in (given or ()):
        if given != [_UNDEGRADED]:
            raise typer.BadParameter("--limit none: excludes other limits; allowed: none alone")
        return {}
    limits = defaults | {"noise": noise}
    for text in given or ():
        key, _, number = text.partition("=")
        if key not in _MOST:
            allowed = ", ".join((*_MOST, _UNDEGRADED))
            raise typer.BadParameter(f"--limit {text}: unknown limit; allowed: {allowed}")
        try:
            value = float(number)
        except ValueError:
            raise typer.BadParameter(
                f"--limit {text}: not a number; allowed: {key}=NUMBER"
            ) from None
        if not 0.0 <= value <= _MOST[key]:
            raise typer.BadParameter(f"--limit {text}: out of range; allowed: 0 to {_MOST[key]:g}")
        limits[key] = value
    return limits
