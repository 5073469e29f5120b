"""Work of `outrider run`."""

from contextlib import nullcontext
from pathlib import Path

import msgspec
import typer

from bus.credentials import CredentialSet, read_credentials
from bus.errors import AccessDenied, PeerLost, ScenarioError
from bus.registry import DRIVERS
from outrider.cli.console import ERR, flight_progress, print_json, print_warnings
from outrider.cli.options import check_endpoints, with_respawn
from outrider.cli.run import RunOptions
from outrider.cli.run_secret import secret_of
from outrider.cli.stopping import Stop, stop_on_signals
from outrider.cli.summary_table import print_summary
from outrider.running.companions import Beside, pace_with, parse_companion
from outrider.running.launch import Outcome, Watcher, launch
from outrider.running.listening import Listening
from outrider.running.own_functions import check_own_functions
from outrider.running.parent import Output
from outrider.running.resolve import resolve
from outrider.running.user_code import check_code
from outrider.view.output import output_folder, write_summary
from sim.scenario.checks import check_no_robot, scenario_warnings
from sim.scenario.types import Scenario


def run(wanted: RunOptions) -> None:
    """Fly the scenario, print its summary and write its files.

    Raises:
        Exit: If a signal ended the run.
        ScenarioError: If the options or the scenario are unusable.
        PeerLost: If a process or a file failed.
    """
    beside = tuple(parse_companion(text) for text in wanted.companions)
    asked = wanted.realtime
    realtime = pace_with(beside) if asked is None else asked
    flown, named = resolve(
        wanted.scenario,
        seed=wanted.seed,
        duration=wanted.duration,
        law=wanted.law,
        driver=wanted.driver,
        uav_policy=wanted.uav_policy,
        network=wanted.network,
        realtime=realtime,
        changes=with_respawn(wanted.changes, respawn=wanted.respawn),
    )
    flown = _paced(flown, wanted)
    has_external = any(DRIVERS[ugv.driver].outside for ugv in flown.ugv)
    _check_processes(flown, 0 if wanted.in_process else wanted.allow_processes)
    _check_in_process(
        wanted.in_process,
        bool(asked or wanted.respawn or wanted.companions or wanted.listen),
        has_external,
    )
    listening = _listening(flown, wanted)
    run_secret = secret_of(wanted.secret, wanted=has_external)
    check_code(flown, named, source=wanted.scenario, allowed=wanted.allow_code)
    print_warnings((*scenario_warnings(flown), *check_own_functions(flown)))
    _check_recording(wanted.record)
    output_context = output_folder(wanted.out, flown.name) if wanted.files else nullcontext()
    with output_context as folder, stop_on_signals() as stop:
        output = Output(
            folder=str(folder or ""), picture=wanted.picture, record=str(wanted.record or "")
        )
        if wanted.in_process:
            from outrider.cli.work.in_process import fly_here  # noqa: PLC0415 - all vehicles' code

            outcome = fly_here(flown, run_secret, output, stop)
        else:
            outcome = _fly_apart(flown, run_secret, output, beside, listening, stop)
        _report(outcome, folder, json=wanted.json)
    _end(outcome, stop)


def _paced(flown: Scenario, wanted: RunOptions) -> Scenario:
    """Return the scenario at the pace of the wall clock if an operator drives, unless the user has set a pace."""
    is_set = wanted.realtime is not None or flown.run.realtime > 0.0
    is_set |= any(change.partition("=")[0].strip() == "run.realtime" for change in wanted.changes)
    operated = any(DRIVERS[ugv.driver].operated for ugv in flown.ugv)
    if is_set or wanted.in_process or not operated:
        return flown
    return msgspec.structs.replace(flown, run=msgspec.structs.replace(flown.run, realtime=1.0))


def _listening(flown: Scenario, wanted: RunOptions) -> Listening:
    """Return where others can join, after checking it.

    Raises:
        ScenarioError: If an endpoint is invalid.
        AccessDenied: If the credentials do not suit the scenario.
    """
    if wanted.credentials is None or not wanted.listen:  # a variable's file is for other commands
        check_endpoints(wanted.listen, secured=True, insecure=False)
        return Listening(wanted.listen)
    file = wanted.credentials
    given: CredentialSet = read_credentials(file)
    if given.tls is not None:
        raise AccessDenied(
            f"{file}: certificates; allowed: passwords (outrider credentials without --tls), or "
            "certificates with `outrider simulator`"
        )
    known = {one.name for one in given.parties}
    lacking = [one.name for one in flown.vehicles if one.name not in known]
    if lacking:
        raise AccessDenied(
            f"{file}: no credentials for {', '.join(lacking)}; make them with "
            f"`outrider credentials --scenario {wanted.scenario}`"
        )
    check_endpoints(wanted.listen, secured=True, insecure=False)
    return Listening(wanted.listen, given, file.parent)


def _check_recording(record: Path | None) -> None:
    """Report a missing extra here, not in a child."""
    if record is not None:
        import outrider.recording.writer  # noqa: F401, PLC0415 - the extra [record]


def _check_in_process(in_process: bool, has_options: bool, has_external: bool) -> None:
    """Raise `typer.BadParameter` if a run in one process has an option that needs several."""
    needed = "several processes required; leave --in-process out"
    if in_process and has_options:
        raise typer.BadParameter(f"--realtime, --respawn, --with, --listen: {needed}")
    if in_process and has_external:
        raise typer.BadParameter(f"--driver external: {needed}")


def _report(outcome: Outcome, folder: Path | None, *, json: bool) -> None:
    """Write and print the summary, if there is one."""
    if outcome.summary is None:
        return
    if folder is not None:
        try:
            write_summary(outcome.summary, folder)
        except OSError as error:  # the summary is printed nevertheless
            outcome.fault = outcome.fault or f"{error.filename}: {error.strerror}"
    if json:
        print_json(outcome.summary)
    else:
        print_summary(outcome.summary, outcome.files)


def _fly_apart(
    flown: Scenario,
    secret: str,
    output: Output,
    beside: tuple[Beside, ...],
    listening: Listening,
    stop: Stop,
) -> Outcome:
    with flight_progress(flown, "starting (the first start compiles)") as progress:
        watcher = Watcher(
            on_tick=progress.show,
            on_event=progress.say,
            on_warnings=print_warnings,
            stop=lambda: stop.count,
            companions=beside,
        )
        return launch(flown, watcher, output, secret=secret, listening=listening)


def _check_processes(flown: Scenario, allowed: int) -> None:
    """Check the number of processes against its limit; 0: the run starts none.

    Raises:
        ScenarioError: If the run needs more processes, or a robot that a process of the user reports.
    """
    check_no_robot(flown)
    outside = sum(DRIVERS[ugv.driver].outside for ugv in flown.ugv)
    wanted = 1 + len(flown.vehicles) - outside
    if 0 < allowed < wanted:
        raise ScenarioError(
            f"{flown.name}: needs {wanted} processes; allowed: {allowed}; add --allow-processes {wanted} or "
            "--in-process"
        )


def _end(outcome: Outcome, stop: Stop) -> None:
    if stop:
        if outcome.summary is None:
            ERR.tell("outrider: interrupted before the first tick; there are no results")
        raise typer.Exit(stop.exit_code)
    if outcome.fault:
        unusable = outcome.unusable and outcome.summary is None
        raise (ScenarioError if unusable else PeerLost)(outcome.fault)
