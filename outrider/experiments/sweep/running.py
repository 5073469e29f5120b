"""Execution of a sweep: tasks of about a second, on worker processes or a cluster."""

from collections.abc import Callable, Generator, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import closing, contextmanager
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING, Any

from bus.errors import PeerLost
from outrider.experiments.sweep.folder import SweepFolder
from outrider.experiments.sweep.plan import SweepPlan
from outrider.experiments.sweep.worker import fly_runs, installed_version, warm_up_once
from outrider.running.workers import interrupts_masked, open_pool
from sim.scenario.types import Scenario

if TYPE_CHECKING:
    from distributed import Client

_TASK = 20_000
"""Ticks of one UAV in a task, about a second; the overhead of a task is some milliseconds."""
_CONNECT = 10.0
"""Timeout of the connection to a cluster's scheduler [s]."""
_AHEAD = 3
"""Number of tasks submitted per worker."""
_TASKS_A_WORKER = 4
"""Smallest number of tasks per worker, given enough runs, so that all workers finish at about the same time."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepTask:
    """Runs of one point."""

    scenario: Scenario
    seeds: dict[int, int]
    """Seeds by run number."""


def cost_of(scenario: Scenario) -> int:
    """Return the estimated cost of a run, in ticks of one UAV."""
    return scenario.ticks * max(1, len(scenario.uav))


def make_tasks(plan: SweepPlan, done: set[int], workers: int) -> list[SweepTask]:
    """Divide the missing runs into tasks, in order.

    Args:
        plan: Plan of the sweep.
        done: Numbers of the finished runs.
        workers: Number of worker processes.
    """
    missing = plan.runs - len(done)
    most = max(1, missing // (_TASKS_A_WORKER * workers))
    tasks: list[SweepTask] = []
    for k, point in enumerate(plan.points):
        runs = [
            run
            for run in range(k * plan.sweep.seeds, (k + 1) * plan.sweep.seeds)
            if run not in done
        ]
        size = min(most, max(1, _TASK // cost_of(point.scenario)))
        for first in range(0, len(runs), size):
            seeds = {run: plan.seed_of(run) for run in runs[first : first + size]}
            tasks.append(SweepTask(scenario=point.scenario, seeds=seeds))
    return tasks


@contextmanager
def open_cluster(address: str, version: str) -> Iterator["Client"]:
    """Open a client of a Dask cluster whose workers have the same version of Outrider.

    Args:
        address: Address of the scheduler.
        version: Version of Outrider here.

    Raises:
        PeerLost: If there is no scheduler or worker, or a worker has another version or none.
    """
    from distributed import Client  # noqa: PLC0415 - optional dependency

    try:
        client = Client(address, timeout=_CONNECT)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise PeerLost(f"--dask {address}: no scheduler found ({error})") from error
    with client:
        try:
            found = client.run(installed_version)
        except Exception as error:
            raise PeerLost(f"--dask {address}: a worker cannot import outrider: {error}") from error
        for worker, other in found.items():
            if other != version:
                raise PeerLost(
                    f"--dask {address}: worker {worker} has outrider {other}; allowed: {version}"
                )
        if not found:
            raise PeerLost(f"--dask {address}: the cluster has no workers")
        yield client


def _results(
    tasks: list[SweepTask], jobs: int, client: "Client | None"
) -> Generator[list[dict[str, Any]]]:
    """Yield the results of the tasks as they arrive."""
    if client is not None:
        yield from _results_of_cluster(tasks, jobs, client)
    elif jobs == 1:
        for task in tasks:
            yield fly_runs(task.scenario, task.seeds)
    else:
        yield from _results_of_pool(tasks, jobs)


def _results_of_pool(tasks: list[SweepTask], jobs: int) -> Generator[list[dict[str, Any]]]:
    waiting, asked = iter(tasks), set[Future[list[dict[str, Any]]]]()
    pool = open_pool(jobs, warm_up_once)
    try:
        while True:
            with interrupts_masked():
                for task in islice(waiting, _AHEAD * jobs - len(asked)):
                    asked.add(pool.submit(fly_runs, task.scenario, task.seeds))
            if not asked:
                return
            done, asked = wait(asked, return_when=FIRST_COMPLETED)
            for future in done:
                yield future.result()
    finally:
        pool.shutdown(cancel_futures=True)


def _results_of_cluster(
    tasks: list[SweepTask], jobs: int, client: "Client"
) -> Generator[list[dict[str, Any]]]:
    from distributed import as_completed  # noqa: PLC0415 - optional dependency

    def submit(task: SweepTask) -> Any:  # noqa: ANN401 - distributed's future
        return client.submit(fly_runs, task.scenario, task.seeds, pure=False)

    waiting = iter(tasks)
    # Dask cancels a future without references, and so the remaining tasks when this generator is closed.
    asked = as_completed([submit(task) for task in islice(waiting, _AHEAD * jobs)])  # type: ignore[no-untyped-call]
    for future in asked:
        yield future.result()
        for task in islice(waiting, 1):
            asked.add(submit(task))  # type: ignore[no-untyped-call]


def _is_a_death(error: Exception) -> bool:
    """Return true if a worker process of the pool died, or too many of the cluster."""
    return type(error).__name__ in ("BrokenProcessPool", "KilledWorker")


def fly_sweep(
    plan: SweepPlan,
    folder: SweepFolder,
    *,
    jobs: int,
    client: "Client | None" = None,
    on_results: Callable[[list[dict[str, Any]]], None] = lambda _results: None,
) -> None:
    """Fly the missing runs of a sweep.

    A failed run has a row with its error; a worker that dies is replaced.

    Args:
        plan: Plan of the sweep.
        folder: Folder that stores the results.
        jobs: Number of worker processes.
        client: Client of a cluster; None: fly on this machine.
        on_results: Called with results after they are stored.

    Raises:
        PeerLost: If workers die repeatedly without results, or the cluster disconnects.
    """
    done = set(folder.done)
    while True:
        before = len(done)
        tasks = make_tasks(plan, done, jobs)
        if not tasks:
            return
        try:
            with closing(_results(tasks, jobs, client)) as all_results:
                for results in all_results:
                    folder.add(results)
                    done |= {result["run"] for result in results}
                    on_results(results)
            return
        except Exception as error:
            if client is not None and not _is_a_death(error):
                raise PeerLost(
                    f"--dask: the cluster disconnected ({type(error).__name__}: {error}); finished runs are stored"
                ) from error
            if not _is_a_death(error):
                raise
            if len(done) == before:
                raise PeerLost(
                    "worker processes die at once, maybe out of memory; try fewer --jobs; finished runs are stored"
                ) from error
