"""Entry point of the command line: the table of commands, and the report of errors as one line and an exit code."""

import contextlib
import copy
import functools
import io
import logging
import os
import re
import signal
import sys
import traceback
from collections.abc import Callable
from importlib import import_module, metadata
from importlib.metadata import EntryPoint
from types import FrameType
from typing import Any, NoReturn

import typer

from bus import plugins
from bus.errors import (
    AccessDenied,
    Ended,
    OutriderError,
    ScenarioError,
    error_with_place,
    place_in_user_code,
    shortened,
)
from outrider.cli.options import help_without_command
from outrider.cli.standard_files import open_standard_files, print_text
from outrider.cli.start import INTERRUPTED
from sim.input.faults import one_line

COMMANDS = {
    "run": ("outrider.cli.run:command", "Fly a scenario, one process per vehicle."),
    "simulator": (
        "outrider.cli.simulator:command",
        "Simulate a scenario for vehicles that join over Zenoh.",
    ),
    "uav": ("outrider.cli.pilots:uav", "Fly one UAV of a run in this process."),
    "ugv": ("outrider.cli.pilots:ugv", "Drive one UGV of a run in this process."),
    "router": ("outrider.cli.router:command", "Route the messages of a run."),
    "credentials": ("outrider.cli.credentials:command", "Make random credentials for a run."),
    "scenarios": ("outrider.cli.scenarios:app", "List, show or create scenarios."),
    "check": ("outrider.cli.check:command", "Validate a scenario without flying it."),
    "drive": ("outrider.cli.drive:command", "Drive a UGV from this terminal."),
    "record": ("outrider.cli.record:command", "Record a run in progress into an MCAP file."),
    "replay": ("outrider.cli.replay:command", "Print a recorded run's summary, or fly it again."),
    "render": ("outrider.cli.render:command", "Draw a recorded flight as a picture or a film."),
    "figures": (
        "outrider.cli.figures:command",
        "Draw the paper's figures 1 to 5, and check their claims.",
    ),
    "sweep": (
        "outrider.cli.sweep:command",
        "Fly each law under each degradation with many seeds.",
    ),
    "report": ("outrider.cli.report:command", "Draw the results of sweeps."),
    "doctor": ("outrider.cli.doctor:command", "List what this machine lacks."),
}
"""Commands of the core: name, then `module:attribute` (a function or a typer app) and the line in --help."""

_FORWARD = {
    "allow_extra_args": True,
    "allow_interspersed_args": False,  # otherwise typer drops a `--` of the command
    "ignore_unknown_options": True,
}
_STRICT = ("strict", "surrogateescape")
"""Error handlers of terminals, the second in the C locale, that fail on a character which the terminal cannot show."""
_DEBUG = "OUTRIDER_DEBUG"
_MORE = "--debug shows the full traceback"


def _version(wanted: bool) -> None:
    if wanted:
        print_text(f"outrider {metadata.version('outrider')}\n")
        raise typer.Exit


def make_app(*, whole: bool = False) -> typer.Typer:
    """Return the command line.

    Args:
        whole: True: import every command, for shell completion and the reference, without extensions whose libraries
            are missing. False: import a command when it is called.
    """
    app = typer.Typer(pretty_exceptions_enable=False, rich_markup_mode=None)

    @app.callback(invoke_without_command=True)
    def about(
        context: typer.Context,
        version: bool = typer.Option(
            False, "--version", callback=_version, is_eager=True, help="Print the version and exit."
        ),
        debug: bool = typer.Option(
            False,
            "--debug",
            help="Show full tracebacks of errors in all processes.",
        ),
    ) -> None:
        """Simulate UAVs that escort ground vehicles and keep them in sight.

        Example: outrider run escort --seed 3
        """
        help_without_command(context)

    add = _add_whole if whole else _add
    registered = plugins.registered("commands")
    for name, (where, line) in COMMANDS.items():
        inner = {
            other.removeprefix(f"{name}."): entry
            for other, entry in sorted(registered.items())
            if other.startswith(f"{name}.")
        }
        load = functools.partial(_attribute, where)
        add(app, name, functools.partial(_with_subcommands, load, inner) if inner else load, line)
    for name, entry in sorted(registered.items()):
        if name.partition(".")[0] in COMMANDS and "." in name:
            continue
        load = functools.partial(plugins.load, entry)
        try:
            fault = _name_fault(name)
            if fault:
                raise OutriderError(fault)
            if plugins.is_installed(entry):
                add(app, name, load, plugins.about(entry))
            else:  # without extensions: the command names the missing extra
                _add(app, name, load, "", hidden=True)
        except OutriderError as error:
            plugins.ignore(entry, error)
    return app


def _name_fault(name: str) -> str:
    """Describe why no package can add a command of this name; empty if one can."""
    if name in COMMANDS:
        return "Outrider has a command of this name"
    return "" if re.fullmatch(r"\w[\w.-]*", name) else "not a command's name"


def _attribute(where: str) -> Any:  # noqa: ANN401 - a command or an app
    module, _, name = where.partition(":")
    return getattr(import_module(module), name)


def _with_subcommands(load: Callable[[], Any], entries: dict[str, EntryPoint]) -> Any:  # noqa: ANN401 - an app
    """Return a group of commands with the subcommands of packages; one that cannot be added is ignored."""
    group = load()
    if not isinstance(group, typer.Typer):
        for entry in entries.values():
            plugins.ignore(entry, "not a group of commands")
        return group
    found = copy.copy(group)
    found.registered_commands = [*group.registered_commands]
    taken = {one.name or getattr(one.callback, "__name__", "") for one in group.registered_commands}
    for name, entry in entries.items():
        try:
            if name in taken:
                raise OutriderError("Outrider has a command of this name")
            if plugins.is_installed(entry):
                found.command(name)(_interruptible(plugins.load(entry)))
        except OutriderError as error:
            plugins.ignore(entry, error)
    return found


def _add(
    app: typer.Typer, name: str, load: Callable[[], Any], line: str, *, hidden: bool = False
) -> None:
    """Add a command that is imported when called; it handles its arguments, --help and exit code."""

    @app.command(name, help=line, hidden=hidden, add_help_option=False, context_settings=_FORWARD)
    @_interruptible
    def call(context: typer.Context) -> Any:  # noqa: ANN401 - an exit code, if any
        return _call(load(), f"{context.find_root().info_name} {name}", context.args)


def call_command(name: str, arguments: list[str]) -> Any:  # noqa: ANN401 - an exit code, if any
    """Call an extension's command in this process."""
    return _call(plugins.load(plugins.registered("commands")[name]), f"outrider {name}", arguments)


def _call(found: Any, program: str, arguments: list[str]) -> Any:  # noqa: ANN401 - a function or an app
    command = _as_command(found, program.rpartition(" ")[2])
    return command(args=arguments, prog_name=program, standalone_mode=False)


def _numba_fault(error: BaseException) -> str:
    """Describe an error that numba raises when imported with its variables; empty if the error is another one."""
    given = [name for name in os.environ if name.startswith("NUMBA_")]
    frames = traceback.extract_tb(error.__traceback__)
    if not given or f"{os.sep}numba{os.sep}" not in frames[-1].filename:
        return ""
    return f"numba: {error}; unset {', '.join(given)}"


def _as_command(found: Any, name: str) -> Any:  # noqa: ANN401 - click's, by version of typer
    if not isinstance(found, typer.Typer):
        alone = typer.Typer(add_completion=False, rich_markup_mode=None)
        alone.command(name)(_interruptible(found))
        found = alone
    return typer.main.get_command(found)


def _add_whole(app: typer.Typer, name: str, load: Callable[[], Any], line: str) -> None:
    try:
        found = load()
        with plugins.foreign():
            _as_command(found, name)  # otherwise a command that typer rejects would stop the others
    except OutriderError:
        return
    if isinstance(found, typer.Typer):
        app.add_typer(found, name=name, short_help=line)
    else:
        app.command(name, short_help=line)(found)


def _end(_signal: int, _frame: FrameType | None) -> None:
    raise Ended(128 + signal.SIGTERM)


class _Interrupted(Exception):
    """Ctrl-C in a command; typer would exit without a message."""


def _interruptible(command: Callable[..., Any]) -> Callable[..., Any]:
    """Wrap a command so that Ctrl-C raises `_Interrupted`."""

    @functools.wraps(command)
    def call(*arguments: Any, **options: Any) -> Any:  # noqa: ANN401 - the command's own
        try:
            return command(*arguments, **options)
        except KeyboardInterrupt as error:
            raise _Interrupted from error
        except EOFError as error:  # typer would take it for Ctrl-D
            raise OutriderError(
                _cache_fault(error) or f"{error_with_place(error)}; {_MORE}"
            ) from error

    return call


def _cache_fault(error: BaseException) -> str:
    """Describe a failure to read or write the compile cache; empty if the error is another one."""
    if "sim.compiling.compile" not in sys.modules:  # nothing was compiled
        return ""
    from sim.compiling.compile import cache_fault  # noqa: PLC0415 - loaded already

    return cache_fault(error)


def _fail(line: str, code: int) -> int:
    sys.stderr.write(f"outrider: {one_line(' '.join(line.split()))}\n")
    return code


def _show_traceback() -> None:
    if os.environ.get(_DEBUG):
        traceback.print_exc()


def _system_fault(error: OSError) -> str:
    """Describe a system error and, if known, the file that it concerns."""
    if fault := _cache_fault(error):
        return fault
    if place_in_user_code(error):
        return f"{error_with_place(error)}; {_MORE}"
    reason = error.strerror or str(error)
    if error.filename is not None:
        return f"{error.filename}: {reason}"
    if error.errno is None:
        return reason
    return f"{type(error).__name__}: {reason}; {_MORE}"


def _run() -> int:
    try:
        code = int(make_app(whole="_OUTRIDER_COMPLETE" in os.environ)(standalone_mode=False) or 0)
        if not code:  # otherwise the exit code says more than a closed terminal
            print_text("")  # flush
        return code
    except ScenarioError as error:
        _show_traceback()
        return _fail(str(error.args[0]), 2)
    except AccessDenied as error:
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
    except (
        UnicodeEncodeError
    ) as error:  # a word of the command line that is no text, such as a file's name
        _show_traceback()
        return _fail(f"{shortened(error.object)}: not encoded in UTF-8; allowed: UTF-8", 2)
    except (KeyboardInterrupt, _Interrupted):
        return _fail("interrupted", INTERRUPTED)
    except Exception as error:
        # typer's own errors, independent of its version of click
        format_message = getattr(error, "format_message", None)
        if format_message is None:
            if fault := _cache_fault(error) or _numba_fault(error):
                _show_traceback()
                return _fail(fault, 1)
            if not place_in_user_code(error):
                raise
            _show_traceback()
            return _fail(f"{error_with_place(error)}; {_MORE}", 1)
        return _fail(f"{format_message()}; see --help", int(getattr(error, "exit_code", 2)))


def run_command_line() -> int:
    """Run the command line, and return its exit code."""
    if (
        "--debug" in sys.argv[1:]
    ):  # before or after the command's name; children inherit the variable
        sys.argv.remove("--debug")
        os.environ[_DEBUG] = "1"
    # Workers of process pools must not import files in the user's working folder.
    os.environ["PYTHONSAFEPATH"] = "1"
    for stream in (
        sys.stdout,
        sys.stderr,
    ):  # a character that the terminal cannot show is not an error
        if isinstance(stream, io.TextIOWrapper) and stream.errors in _STRICT:
            with contextlib.suppress(OSError):  # a child's pipe
                stream.reconfigure(errors="replace")
    logging.basicConfig(format="%(name)s: %(message)s", level=logging.WARNING)
    logging.captureWarnings(True)
    signal.signal(signal.SIGTERM, _end)
    return _run()


def main() -> NoReturn:
    """Run the command line, and exit."""
    open_standard_files()
    code: int | str | None
    try:
        code = run_command_line()
    except SystemExit as ended:
        code = ended.code
    # The process exits already; an exception would only write to the log.
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    sys.exit(code)
