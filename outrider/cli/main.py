"""The command line's table, and what becomes of its errors: one clear line, and an exit code."""

import contextlib
import functools
import io
import logging
import os
import signal
import sys
import traceback
from collections.abc import Callable
from types import FrameType
from typing import Any, NoReturn

import typer

from bus.errors import (
    AccessDenied,
    OutriderError,
    ScenarioError,
    place_in_user_code,
    told_with_place,
)
from outrider.cli import (
    check,
    credentials,
    dashboard,
    doctor,
    drive,
    falsify,
    figures,
    fmu,
    mavlink,
    network,
    pilots,
    record,
    render,
    replay,
    report,
    ros2,
    router,
    run,
    scenarios,
    simulator,
    suite,
    sweep,
)
from outrider.cli.options import help_without_command
from outrider.cli.standard_files import open_standard_files, print_text
from sim.input.faults import one_line

COMMANDS: dict[str, Callable[..., None]] = {
    "run": run.command,
    "simulator": simulator.command,
    "uav": pilots.uav,
    "ugv": pilots.ugv,
    "router": router.command,
    "credentials": credentials.command,
    "dashboard": dashboard.command,
    "drive": drive.command,
    "ros2": ros2.command,
    "mavlink": mavlink.command,
    "record": record.command,
    "replay": replay.command,
    "render": render.command,
    "check": check.command,
    "falsify": falsify.command,
    "figures": figures.command,
    "suite": suite.command,
    "sweep": sweep.command,
    "report": report.command,
    "doctor": doctor.command,
}


_DEBUG = "OUTRIDER_DEBUG"
_INTERRUPTED = 130
_MORE = "--debug shows the whole traceback"


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        print_text(f"outrider {version('outrider')}\n")
        raise typer.Exit


def make_app() -> typer.Typer:
    """The whole command line: for `main`, and for the pages that tell of it."""
    app = typer.Typer(pretty_exceptions_enable=False, rich_markup_mode=None)

    @app.callback(invoke_without_command=True)
    def about(
        context: typer.Context,
        version: bool = typer.Option(
            False, "--version", callback=_version, is_eager=True, help="Print the version and stop."
        ),
        debug: bool = typer.Option(
            False,
            "--debug",
            help="Show the whole traceback of an error, of every process of a run.",
        ),
    ) -> None:
        """Outrider: a UAV that flies as the outrider of a ground vehicle, and never loses sight of it.

        Example: outrider run escort --seed 3
        """
        help_without_command(context)

    for name, command in COMMANDS.items():
        app.command(name)(_telling(command))
    app.add_typer(scenarios.app, name="scenarios")
    app.add_typer(network.app, name="network")
    app.add_typer(fmu.app, name="fmu")
    return app


def _end(_signal: int, _frame: FrameType | None) -> None:
    raise SystemExit(128 + signal.SIGTERM)


class _Interrupted(Exception):
    """Ctrl-C in a command; typer would end it without a word."""


def _telling(command: Callable[..., None]) -> Callable[..., None]:
    """The same command, whose Ctrl-C is told."""

    @functools.wraps(command)
    def call(*arguments: Any, **options: Any) -> None:  # noqa: ANN401 - the command's own
        try:
            command(*arguments, **options)
        except KeyboardInterrupt as error:
            raise _Interrupted from error

    return call


def _fail(line: str, code: int) -> int:
    sys.stderr.write(f"outrider: {one_line(' '.join(line.split()))}\n")
    return code


def _show_traceback() -> None:
    if os.environ.get(_DEBUG):
        traceback.print_exc()


def _system_fault(error: OSError) -> str:
    """Return an error of the system and, as far as that is known, what it is about."""
    if place_in_user_code(error):
        return f"{told_with_place(error)}; {_MORE}"
    reason = error.strerror or str(error)
    if error.filename is not None:
        return f"{error.filename}: {reason}"
    if error.errno is None:
        return reason  # its whole text
    return f"{type(error).__name__}: {reason}; {_MORE}"


def _run() -> int:
    try:
        code = int(make_app()(standalone_mode=False) or 0)
        if not code:  # one of its own tells more than that the terminal has gone
            print_text("")  # what waits to be written
        return code
    except (ScenarioError, AccessDenied) as error:
        _show_traceback()
        return _fail(str(error), 2)
    except OutriderError as error:
        _show_traceback()
        return _fail(str(error), 1)
    except BrokenPipeError:
        return 1
    except OSError as error:
        _show_traceback()
        return _fail(_system_fault(error), 1)
    except (KeyboardInterrupt, _Interrupted):
        return _fail("interrupted", _INTERRUPTED)
    except Exception as error:
        # typer's own errors, of whichever click it carries
        told = getattr(error, "format_message", None)
        if told is None:
            if not place_in_user_code(error):
                raise
            _show_traceback()
            return _fail(f"{told_with_place(error)}; {_MORE}", 1)
        return _fail(f"{told()} (outrider --help tells more)", int(getattr(error, "exit_code", 2)))


def run_command_line() -> int:
    """Run the command line, and tell its exit code."""
    if "--debug" in sys.argv[1:]:  # before or after the command's name; children find the variable
        sys.argv.remove("--debug")
        os.environ[_DEBUG] = "1"
    # Pools start their workers by themselves: none of them is to import what lies in the folder where the user stands.
    os.environ["PYTHONSAFEPATH"] = "1"
    for stream in (sys.stdout, sys.stderr):  # a letter that a terminal lacks is no fault
        if isinstance(stream, io.TextIOWrapper) and stream.errors == "strict":
            with contextlib.suppress(OSError):  # a child's pipe
                stream.reconfigure(errors="replace")
    logging.basicConfig(format="%(name)s: %(message)s", level=logging.WARNING)
    logging.captureWarnings(True)
    signal.signal(signal.SIGTERM, _end)
    return _run()


def main() -> NoReturn:
    """Run the command line, and end this process."""
    open_standard_files()
    code: int | str | None
    try:
        code = run_command_line()
    except SystemExit as ended:
        code = ended.code
    # It ends: an exception in the middle of its exit would only be written to its log.
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    sys.exit(code)
