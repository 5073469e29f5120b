"""Pilot of the UAV: maps observations to commands."""

from collections.abc import Callable
from typing import TYPE_CHECKING, cast

import numpy as np

from agents.altitude_law import altitude_memory
from agents.control.orbit import Path, check_path
from agents.control.weighting import Weighting, check_weighting
from agents.estimation.estimator import Estimate, estimator_of
from agents.estimation.map_updates import MapUpdateScheduler
from agents.estimation.own_map import own_map
from agents.laws.policy import PolicyControl, TargetEstimate, UavPolicy
from agents.laws.selection import SelectedLaw
from agents.safety.altitude import Acceleration
from agents.safety.safety_filter import SafetyFilter
from agents.team.member import TeamMember
from agents.team.messages import team_inputs
from agents.team.records import team_memory
from agents.team.tick import law_coverage
from agents.uav_constants import uav_constants
from agents.uav_inputs import KnownBuildings, UavInputs, uav_inputs
from agents.uav_parameters import uav_parameters
from agents.uav_tick import (
    UavMemory,
    altitude_control,
    fly_law,
    occlusion_of,
    perceive,
)
from bus.errors import ScenarioError
from bus.messages.base import Vector
from bus.messages.scenario import Law
from bus.messages.vehicle import (
    BackupTrajectory,
    RelativeInformation,
    UavBriefing,
    UavCommand,
    UavObservation,
    UavReport,
)
from bus.ticks import detection_rows, radio_ticks
from sim.compiling.compile import FloatArray
from sim.compiling.records import RecordArray
from sim.models.altitude import vertical_state
from sim.models.buildings import tables_of
from sim.models.field import coverage_error
from sim.models.sensor import SensorParameters
from sim.models.vehicles import norm

if TYPE_CHECKING:
    from agents.laws.dispatch import FlownLaw

Inner = Callable[[UavObservation], Vector | None]
"""User's inner control: returns the acceleration of this tick [m/s²], or None to fly the law."""

_PATH_HORIZON = 600.0
"""Time over which a user's path is checked [s]; a pilot does not know the duration of the run."""


class UavPilot:
    """Pilot of a UAV: runs any law on the filter's estimate and the UAV's own map. It performs no input or output.

    Args:
        briefing: Briefing of the UAV.
        weighting: User's weighting for the law `weighted`.
        path: User's path for the law `path`.
        policy: User's policy for the laws `policy` and `certified`; it must not be shared with another pilot.
        policy_name: Name of the policy in errors.
        inner: User's control, called once per tick before the law. The safety filter covers both, whatever the law.
            While the inner control acts, the law's state does not advance.

    Raises:
        ScenarioError: If the briefing cannot be flown, or a user's function is missing or does not fit.
    """

    def __init__(
        self,
        briefing: UavBriefing,
        *,
        weighting: Weighting | None = None,
        path: Path | None = None,
        policy: UavPolicy | None = None,
        policy_name: str = "policy",
        inner: Inner | None = None,
    ) -> None:
        self._briefing = briefing
        self._uav = uav_parameters(briefing)
        self._law = SelectedLaw(briefing, briefing.law, self._uav)
        self._vertical: RecordArray | None = None
        if briefing.altitude is not None:
            self._vertical = vertical_state(briefing.altitude)
        self._known = [*briefing.buildings]
        self._discovered = [-1] * len(briefing.buildings)
        self._buildings = self._known_buildings()
        self._weighting, self._path, self._inner = weighting, path, inner
        self._policy: PolicyControl | None = None
        if policy is not None:
            self._policy = PolicyControl(briefing, self._uav, policy, policy_name)
        self._check_own_functions()
        self.coverage: FloatArray = own_map(briefing)
        """The UAV's own coverage map, built from its own trajectory. Shape (rows, columns)."""
        self.estimator = estimator_of(briefing)
        self.filter: SafetyFilter | None = self._make_filter()
        """Safety filter of the law `certified` and of a user's inner control; None for other laws."""
        safety = self.filter or SafetyFilter(briefing)  # all flights compile the same types
        # tables of one row: a single row becomes read-only when pickled
        self._constants = uav_constants(briefing)
        self._memory = UavMemory(
            uav=self._constants.uav.copy(),
            coverage=self.coverage,
            altitude=None if briefing.altitude is None else altitude_memory(briefing),
            filter=safety.memory,
            team=team_memory(briefing, self.coverage),
        )
        self.team: TeamMember | None = None
        """Its part in its team; None: it has none."""
        parameters, memory = self._constants.team, self._memory.team
        if parameters is not None and memory is not None:
            self.team = TeamMember(briefing, parameters, memory, self._constants.safety)
        self.map_updates = MapUpdateScheduler(briefing)
        """Scheduler of the map updates."""
        self._tick: int | None = None
        self._radio_ticks = radio_ticks(briefing.dt)
        self._dt = briefing.dt
        c = self._uav
        self._fixed_error = c.density_radius, c.desired_coverage, c.cell
        self._estimate: Estimate | None = None

    def _make_filter(self) -> SafetyFilter | None:
        return SafetyFilter(self._briefing) if self._watched else None

    @property
    def _watched(self) -> bool:
        return self._briefing.team is not None or self._inner is not None or self._law.row.watched

    def _check_own_functions(self) -> None:
        own = self._law.row.own
        if own == "uav_policy" and self._policy is None:
            raise ScenarioError(
                "law.name = 'policy': needs a policy, given to the UAV as module:function or KIND:FILE"
            )
        if own == "weighting":
            if self._weighting is None:
                raise ScenarioError(
                    "law.name = 'weighted': needs a weighting, given to the UAV as module:function"
                )
            check_weighting(self._weighting, self._uav.switching_radius)
        if own == "path":
            if self._path is None:
                raise ScenarioError(
                    "law.name = 'path': needs a path, given to the UAV as module:function"
                )
            c = self._uav
            v_a, v_g, u_a = c.max_speed, c.target_max_speed, c.max_acceleration
            check_path(self._path, _PATH_HORIZON, self._briefing.visibility_radius, v_a, v_g, u_a)

    def _known_buildings(self) -> KnownBuildings | None:
        if self._vertical is None or self._briefing.max_building_height is None:
            return None
        known = np.ones(len(self._known), dtype=np.bool_)
        discovered = np.array(self._discovered, dtype=np.int64)
        return KnownBuildings(*tables_of(self._known), known, discovered)

    def act(self, observation: UavObservation) -> UavCommand:
        """Return the command for this observation."""
        tick = observation.tick
        if observation.law is not None:
            self._select_law(observation.law)
        wanted = None if self._inner is None else self._inner(observation)
        inputs = self._receive(observation)
        u_x, u_y, vertical = self._nominal(observation, inputs, wanted)
        acceleration, decision, team = (u_x, u_y), None, self.team
        if team is not None:
            acceleration = team.control(inputs, acceleration)
        backups: tuple[BackupTrajectory, ...] = ()
        if self.filter is not None and (team is None or team.filtered):
            decision = self.filter.decide(inputs, Acceleration(*acceleration, vertical))
            acceleration, vertical = decision.acceleration, decision.vertical_acceleration
            backups = self.filter.backup_trajectories(tick)
        elif self.filter is not None and self._vertical is not None:
            u_x, u_y, vertical = self.filter.pass_bare(
                inputs, Acceleration(*acceleration, vertical)
            )
            acceleration, backups = (u_x, u_y), self.filter.backup_trajectories(tick)
        number, message = 0, None
        if team is not None:
            team.accept(decision)
            number, message = team.number, team.message(inputs, self.coverage)
        estimate = self._estimate
        if estimate is None:
            return UavCommand(
                tick=tick,
                acceleration=acceleration,
                vertical_acceleration=vertical,
                backup_trajectories=backups,
                number=number,
                team=message,
            )
        target_position = estimate.position
        return UavCommand(
            tick=tick,
            acceleration=acceleration,
            vertical_acceleration=vertical,
            backup_trajectories=backups,
            radio=() if tick % self._radio_ticks else self._radio(observation, *target_position),
            map_updates=self.map_updates.due(tick, target_position),
            number=number,
            team=message,
            report=UavReport(
                estimate=target_position,
                covariance=estimate.covariance,
                age=estimate.age,
                rejected=estimate.rejected,
                decision=decision,
                role=None if team is None else team.role,
            ),
        )

    def forget_commands(self) -> None:
        """Mark the plans sent so far as unchecked: the last commands may not have been sent."""
        if self.filter is not None:
            self.filter.invalidate_plans()
        if self.team is not None:
            self.team.forget_commands()

    def perceive(self, observation: UavObservation) -> None:
        """Update map, estimator and safety filter from an observation that is too late to answer."""
        self._perceive(self._receive(observation))

    def _perceive(self, inputs: UavInputs) -> None:
        perceive(self._constants, self._memory, inputs, self.filter is not None)

    def _receive(self, observation: UavObservation) -> UavInputs:
        """Update the estimate, and convert the message: altitude, detections, and buildings just discovered."""
        tick, before = observation.tick, self._tick
        if observation.tile_reports:
            self.map_updates.record(observation.tile_reports)
        if self._policy is not None:
            self._policy.perceive(observation)
        detections = detection_rows(observation.detections, self._dt)
        self._estimate = self.estimator.update(
            tick=tick,
            own_position=observation.position,
            detections=detections,
            received=observation.team,
        )
        self._tick = tick
        if observation.buildings and self._buildings is not None:
            self._known += observation.buildings
            self._discovered += [tick] * len(observation.buildings)
            self._buildings = self._known_buildings()
        return uav_inputs(
            observation,
            detections,
            elapsed=0 if before is None else tick - before,
            vertical=self._vertical,
            buildings=self._buildings,
            team=team_inputs(
                self._briefing, observation, 0 if self._policy is None else self._policy.request
            ),
        )

    def _select_law(self, law: Law) -> None:
        """Switch to another law; keep map, filter, and the memory fields that both laws share."""
        self._law = SelectedLaw(self._briefing, law, self._uav, self._law)
        self._check_own_functions()
        if self.filter is None or not self._watched:
            self.filter = self._make_filter()
        if self.filter is not None:
            self._memory = self._memory._replace(filter=self.filter.memory)

    @property
    def _flies_policy(self) -> bool:
        row = self._law.row
        return self._policy is not None and "uav_policy" in (row.own, row.inner)

    def _nominal(
        self, observation: UavObservation, inputs: UavInputs, wanted: Vector | None
    ) -> tuple[float, float, float]:
        """Perceive, and return the nominal acceleration: x, y and z [m/s²].

        The user's inner control comes first, then the policy, then the law.
        """
        target = self.estimator.target
        if self._policy is not None and self._flies_policy:
            self._perceive(inputs)
            if wanted is None:
                wanted = self._ask_policy(self._policy, observation, inputs)
            return *wanted, self._policy.vertical
        if wanted is not None:
            self._perceive(inputs)
            u_z = altitude_control(self._constants, self._memory, inputs, target)
            return *wanted, u_z
        if target.known:
            self._call_user_function(observation)
        law = cast("FlownLaw", self._law.flown)  # only a policy, which was asked above, has none
        u_x, u_y, u_z = fly_law(
            law, self._constants, self._memory, inputs, target, self.filter is not None
        )
        return u_x, u_y, u_z

    def _ask_policy(
        self, policy: PolicyControl, observation: UavObservation, inputs: UavInputs
    ) -> Vector:
        """Return the acceleration of the user's policy [m/s²]."""
        if self._vertical is not None:
            policy.sensor = SensorParameters(*self._memory.uav[0]["sensor"].tolist())
            policy.occlusion = occlusion_of(inputs)
        if self.team is not None:
            policy.team = self.team.row(inputs, self._dt, policy.never)
        coverage = law_coverage(self._memory.team, self.coverage)
        return policy.acceleration(observation, self._policy_estimate(), coverage)

    def _policy_estimate(self) -> TargetEstimate:
        s = self.estimator.target
        return TargetEstimate(s.known, s.p_x, s.p_y, self.estimator.age)

    def _call_user_function(self, observation: UavObservation) -> None:
        """Call the user's function, if the law needs one, and write its answer into the law's memory."""
        own, memory, target = self._law.row.own, self._law.memory, self.estimator.target
        if own == "weighting" and self._weighting is not None:
            p_x, p_y = observation.position
            distance = norm(p_x - target.p_x, p_y - target.p_y)
            memory["alpha"], memory["beta"] = self._weighting(distance, self._uav.switching_radius)
        elif own == "path" and self._path is not None:
            memory["offset"], memory["acceleration"] = self._path(observation.time)

    def _radio(
        self, observation: UavObservation, g_x: float, g_y: float
    ) -> tuple[RelativeInformation, ...]:
        p_x, p_y = observation.position
        error = coverage_error(self.coverage, g_x, g_y, *self._fixed_error)
        return (
            RelativeInformation(
                time=observation.time,
                relative_position=(p_x - g_x, p_y - g_y),
                coverage_error=max(0.0, error),
            ),
        )
