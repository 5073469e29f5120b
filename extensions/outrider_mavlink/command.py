"""`outrider mavlink`: show a run in MAVLink ground stations, or control a UAV."""

import os
import sys
import time
from typing import Annotated, Any

import typer

from bus.keys import Role
from bus.locator import check_endpoint
from outrider.cli import options
from outrider.cli.console import print_json
from outrider.cli.joining import Joining, joining, staff_of
from outrider.cli.stopping import stop_on_signals

_OUT, _OFFBOARD = "127.0.0.1:14550", "127.0.0.1:14540"
_AUTOPILOT = "127.0.0.1:14540"
_NICE = 5
"""Lower priority than the run on a busy machine."""
_TRUTH = "telemetry, including the truth,"

_Out = Annotated[
    list[str] | None,
    typer.Option(
        "--to",
        metavar="HOST:PORT",
        help=f"Send to this ground station; repeatable [default: {_OUT}; with --vehicle: {_OFFBOARD}].",
    ),
]
_Listen = Annotated[
    list[str] | None,
    typer.Option(
        "--in",
        metavar="HOST:PORT",
        help=f"Listen for ground stations here; repeatable [default with --autopilot: {_AUTOPILOT}].",
    ),
]
_Private = Annotated[
    bool,
    typer.Option(
        "--private",
        help="Send to a random local port, and print it.",
    ),
]
_Vehicle = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        help="Join as this UAV, controlled by setpoints inside the safety filter.",
    ),
]
_Autopilot = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        help="Join as this UAV, with a real autopilot as its inner loop.",
    ),
]
_First = Annotated[
    int,
    typer.Option(
        "--first-system", help="Set the system number of the first vehicle.", min=1, max=200
    ),
]
_Height = Annotated[
    float,
    typer.Option(help="Set the height in telemetry of UAVs without an altitude [m].", min=0.0),
]


def command(
    out: _Out = None,
    listen: _Listen = None,
    private: _Private = False,
    vehicle: _Vehicle = "",
    autopilot: _Autopilot = "",
    connect: options.Connect = options.DEFAULT_ENDPOINT,
    run: options.RunName = options.DEFAULT_RUN,
    credentials: options.CredentialFile = None,
    first: _First = 1,
    height: _Height = 10.0,
    join_timeout: options.JoinTimeout = 30.0,
    insecure: options.Insecure = False,
    json: options.Json = False,
) -> None:
    """Show a run in MAVLink ground stations, or control a UAV over MAVLink.

    Each vehicle is a MAVLink system. It sends HEARTBEAT, ATTITUDE, GLOBAL_POSITION_INT (from the scenario's origin) and
    LOCAL_POSITION_NED; a UGV also sends FOLLOW_TARGET. Status texts report lost processes and missing certificates.
    The run's settings are parameters. With the operator's credentials, a ground station can drive a UGV by joystick and
    set LAW, PAUSED and RT_FACTOR. With the observer's credentials, access is read-only. QGroundControl and MAVProxy
    listen on port 14550, MAVSDK on 14540. The command ends with the run, or at Ctrl-C.

    With --vehicle, the command replaces `outrider uav` for this UAV. In mode OFFBOARD, the UAV tracks
    SET_POSITION_TARGET_LOCAL_NED (velocity, acceleration). In mode HOLD, it holds its position. In mode MISSION, or
    without a setpoint for the scenario's `command_timeout`, the run's law controls it. The safety filter is always
    active.

    With --autopilot, the run's law controls the UAV, a real autopilot tracks its reference state, and the state that it
    reports is the UAV's true state in the run, which needs `body = "reported"`. If the tracking error exceeds
    `certificate.max_tracking_error`, or telemetry is missing, the UAV holds its position and nothing is certified. The
    autopilot must be armed, airborne and in a mode that follows setpoints. The run must keep real time. PX4 sends to
    the default address of --in.

    Example: outrider mavlink --to 127.0.0.1:14550 --credentials credentials/observer.json

    Example: outrider mavlink --vehicle uav_0 --to 127.0.0.1:14540 --credentials credentials/uav_0.json
    """
    check_endpoint(connect)
    if vehicle and autopilot:
        raise typer.BadParameter("--vehicle and --autopilot: not both; allowed: one of the two")
    if private and (out or autopilot):
        raise typer.BadParameter(
            f"--private and {'--to' if out else '--autopilot'}: not both; allowed: one of the two"
        )
    from outrider_mavlink.opening import open_network, private_address  # noqa: PLC0415 - an extra

    if private:
        out = [private_address()]
    elif out is None and listen is None:
        out = [] if autopilot else [_OFFBOARD if vehicle else _OUT]
        listen = [_AUTOPILOT] if autopilot else []
    what = "telemetry" if vehicle else "setpoints" if autopilot else _TRUTH
    network = open_network(what, out or [], listen or [], private=private, insecure=insecure)
    began = time.monotonic()
    try:
        if vehicle or autopilot:
            name = vehicle or autopilot
            from outrider_mavlink import flying  # noqa: PLC0415 - the extra [mavlink]

            joined = joining(Role.UAV, name, connect, run, credentials, join_timeout)
            found = (
                flying.fly_by_setpoints(network, joined, first, height)
                if vehicle
                else flying.fly_with_autopilot(network, joined)
            )
        else:
            from outrider_mavlink.showing import show  # noqa: PLC0415 - the extra [mavlink]

            os.nice(_NICE)
            with stop_on_signals() as stop:
                party, credential = staff_of(credentials, Role.OBSERVER)
                joined = Joining(party, connect, run, credential, join_timeout)
                found = show(network, joined, stop, first, height)
    finally:
        network.close()
    found["seconds"] = time.monotonic() - began
    if json:
        print_json(found)
    else:
        sys.stderr.write(_summary(found) + "\n")


def _summary(found: dict[str, Any]) -> str:
    count = sum(found.get("sent", {}).values())
    causes = ", ".join(f"{n} {cause}" for cause, n in found.get("refused", {}).items())
    return f"{count} messages sent, {found.get('received', 0)} received" + (
        f"; rejected: {causes}" if causes else ""
    )
