"""Supervision of the teams of a run: counters by `sim.engine.team_monitor`, in the form of messages."""

from collections.abc import Sequence

import numpy as np

from bus.messages.decision import NotCertified
from bus.messages.team import Role
from bus.messages.telemetry import TeamStatus
from bus.messages.vehicle import UavReport
from sim.compiling.compile import FloatArray
from sim.engine.team_monitor import are_too_near, record_team, team_counters, team_reports
from sim.scenario.team import teams_of
from sim.scenario.types import Scenario
from sim.server.recorder import Recorder
from sim.server.team_radio import TeamRadio

_ROUNDING = 1.0
"""Tolerance when a charge is compared with what the way back needs [s]: a UAV moves in the tick of its decision."""


class TeamWatch:
    """Supervision of all teams.

    Args:
        scenario: Scenario of the run.
        radio: Stored numbers and messages.
        recorder: Record of the run.
    """

    def __init__(self, scenario: Scenario, radio: TeamRadio, recorder: Recorder) -> None:
        uavs = sorted(uav.name for uav in scenario.uav)
        teams = teams_of(scenario)
        self._rows = [[uavs.index(name) for name in team] for team in teams]
        self._names, self._guards = uavs, scenario.team.guards if scenario.team else 0
        self._radio, self._recorder, self._dt = radio, recorder, scenario.dt
        self._counts = team_counters(len(teams))
        self._reports = [team_reports(len(team)) for team in teams]
        flying = {uav.name for uav in scenario.uav if uav.initial_altitude is not None}
        self._flying = [row for row, name in enumerate(uavs) if name in flying]
        names = [vehicle.name for vehicle in scenario.vehicles]
        self._vehicles = [names.index(uavs[row]) for row in self._flying]
        self._separation = scenario.team.separation if scenario.team else 0.0
        self._violations = 0

    def record(
        self,
        tick: int,
        current: Sequence[bool],
        reports: Sequence[UavReport | None],
        revoked: Sequence[NotCertified | None],
    ) -> None:
        """Count a tick.

        Args:
            tick: The tick.
            current: True for each UAV that has answered this tick.
            reports: Latest report of each UAV.
            revoked: Reason why its certificate does not hold; None: no such reason.
        """
        for team, (uavs, rows) in enumerate(zip(self._rows, self._reports, strict=True)):
            for row, uav in zip(rows, uavs, strict=True):
                report = reports[uav] if current[uav] else None
                decision = None if report is None else report.decision
                row["number"] = self._radio.number(self._names[uav], tick)
                row["current"] = report is not None
                row["guards"] = report is not None and report.role is Role.GUARD
                row["exhausted"] = report is not None and self._exhausted(uav, report)
                row["certified"] = (
                    decision is not None and decision.certified and revoked[uav] is None
                )
                row["lost"] = self._recorder.is_lost(tick, uav)
            record_team(self._counts[team], rows, self._guards)
        if len(self._flying) > 1:
            self._violations += are_too_near(self._points(tick), self._separation)

    def _points(self, tick: int) -> FloatArray:
        """Return the true positions of the UAVs with an altitude [m]. Shape (UAVs, 3)."""
        plane = self._recorder.states[tick, self._vehicles, :2]
        return np.column_stack([plane, self._recorder.heights[tick, self._flying, 0]])

    def _exhausted(self, uav: int, report: UavReport) -> bool:
        """Return whether a UAV flies to its base as its charge lasts for that only."""
        name = self._names[uav]
        charge = self._radio.charge(name)
        if charge is None or report.role is not Role.AWAY:
            return False
        return charge <= self._radio.needed_charge(name) + _ROUNDING

    def status(self) -> TeamStatus | None:
        """Return all counts as a message; None: there are no teams, or no tick was monitored."""
        counts = self._counts
        ticks = int(counts["ticks"].sum())
        if not ticks:
            return None
        duration = ticks / len(counts) * self._dt
        members = [self._names[uav] for uavs in self._rows for uav in uavs]
        octets = sum(self._radio.octets[name] for name in members)
        return TeamStatus(
            team_certified_share=int(counts["certified"].sum()) / ticks,
            team_out_of_sight=int(counts["lost"].sum()),
            team_certified_while_lost=int(counts["certified_while_lost"].sum()),
            team_certificate_broken=int(counts["broken"].sum()),
            handovers=int(counts["handovers"].sum()),
            extra_guard_share=int(counts["extra"].sum()) / ticks,
            team_traffic=octets / len(members) / duration,
            left_without_relief=int(counts["left"].sum()),
            separation_violations=self._violations,
            charges={
                name: left for name in members if (left := self._radio.charge(name)) is not None
            },
            numbers={name: self._radio.number(name) for name in members},
            refused_messages=sum(self._radio.refused[name] for name in members),
        )
