"""Computation of the run's network budget in a child process, one for all browsers."""

import queue

import msgspec

from bus import plugins
from outrider.running.child import Child
from outrider.running.network_budget import Budget, BudgetReport
from outrider.running.parent import Start

COMMAND = "network"
"""Command that computes a network budget."""


class BudgetJob:
    """Network budget of a run, computed by `outrider network budget` when a browser asks for it.

    Args:
        scenario: Resolved scenario as TOML; empty: unknown.
    """

    def __init__(self, scenario: str) -> None:
        self._scenario = scenario
        self._child: Child | None = None
        self._lines: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self.report = BudgetReport()
        """Newest report of the computation."""
        self.budget: Budget | None = None
        """Newest result."""
        self.fault = ""
        """Reason why the last computation failed; empty: it did not."""

    @property
    def missing(self) -> str:
        """Return why no budget can be computed; empty if one can."""
        if not self._scenario:
            return (
                "The scenario of this run is not known here. A page of `outrider run --with dashboard` or of a "
                "recording knows it; `outrider dashboard` learns it from --scenario."
            )
        command = plugins.registered("commands").get(COMMAND)
        if command is None or not plugins.is_installed(command):
            return f"The command `outrider {COMMAND}` is not installed."
        return ""

    @property
    def running(self) -> bool:
        """True while a computation runs."""
        return self._child is not None and self.report.budget is None

    @property
    def pid(self) -> int:
        """Process id of the computation; 0: there is none."""
        return 0 if self._child is None else self._child.pid

    def start(self, risk: float) -> None:
        """Start the computation at a risk per link, unless one runs."""
        if self.running or self.missing:
            return
        self.cancel()  # the last one, which has reported its result
        self.report, self.fault, self._lines = (
            BudgetReport(step="starting"),
            "",
            queue.SimpleQueue(),
        )
        words = [COMMAND, "budget", "scenario", "--risk", repr(risk)]
        self._child = Child("budget", words, Start(scenario=self._scenario), lines=self._lines)

    def cancel(self) -> None:
        """End the computation, if one runs."""
        if self._child is not None:
            self._child.kill()
            self._end()

    def update(self) -> None:
        """Process the reports that have arrived."""
        while self._child is not None:
            try:
                line = self._lines.get_nowait()
            except queue.Empty:
                return
            if line is None:
                self._child.wait(1.0)
                if self.report.budget is None:
                    self.fault = self._child.error_line() or self._child.exit_report()
                self._end()
                return
            self.report = msgspec.json.decode(line, type=BudgetReport)
            self.budget = self.report.budget or self.budget

    def _end(self) -> None:
        if self._child is not None:
            self._child.close()
        self._child = None

    def close(self) -> None:
        """End the computation: the page is no longer served."""
        self.cancel()
