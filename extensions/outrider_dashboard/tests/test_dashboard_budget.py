"""The page of the network budget: the command's result, one computation for all browsers, cancelled and refused."""

import contextlib

import msgspec
import pytest

from outrider.running.network_budget import bound_table, link_table
from outrider_dashboard.budget_job import BudgetJob
from processes import alive, wait_until
from sim.scenario.loading import load_scenario
from sim.scenario.resolved import as_toml
from tabular import words

pytestmark = pytest.mark.usefixtures("nothing_left_behind")


def job_of(*overrides: str) -> BudgetJob:
    return BudgetJob(as_toml(load_scenario("escort", overrides=["duration=5.0", *overrides])))


def finished(job: BudgetJob) -> bool:
    job.update()
    return not job.running


def test_job_finds_what_the_command_prints(command) -> None:
    with contextlib.closing(job_of()) as job:
        _compare(job, command)


def _compare(job: BudgetJob, command) -> None:
    job.start(1e-2)
    shares = list[float]()

    def is_done() -> bool:
        job.update()
        shares.append(job.report.share)
        return not job.running

    wait_until(is_done, 240.0)
    assert job.fault == ""
    assert job.budget is not None
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, 1.0)
    printed = command(*words("network budget escort --duration 5 --risk 1e-2 --json"))
    assert msgspec.json.decode(printed.stdout.encode(), type=type(job.budget)) == job.budget
    assert len(bound_table(job.budget).rows) == 5
    assert len(link_table(job.budget).rows) == 8


def test_cancelled_job_ends_its_process_and_starts_again() -> None:
    job = job_of()
    job.start(1e-3)
    pid = job.pid
    job.start(1e-3)  # another browser: the same computation
    assert job.pid == pid
    job.cancel()
    assert not job.running
    assert not alive(pid)
    job.start(1e-3)
    assert job.running
    job.close()


def test_scenario_without_bounds_and_unknown_scenario_say_why() -> None:
    job = job_of("law.name=tracking")
    job.start(1e-3)
    wait_until(lambda: finished(job), 120.0)
    job.close()
    assert "no UAV relies on declared bounds" in job.fault
    unknown = BudgetJob("")
    assert "--scenario" in unknown.missing
    unknown.start(1e-3)
    assert not unknown.running
