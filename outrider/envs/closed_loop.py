"""The closed loop in many worlds at once.

World, links, filters, laws, drivers and rewards of a tick in one compiled pass.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import Any, TypeVar, Unpack, cast

import msgspec
import numpy as np

from agents.control.guard import guard_state, track_ticks
from agents.control.handover import check_assumptions
from agents.control.laws import (
    LOOKAHEAD,
    WATCHED,
    LawParameters,
    initial_state,
    law_parameters,
)
from agents.control.lookahead import LookaheadMemory, lookahead_memory
from agents.control.promise import Promise
from agents.control.telling import BLOCK_TILES, telling_memory, telling_ticks
from agents.control.visibility import promise_of
from agents.drivers.compiled import driver_memory, driver_parameters, told_ground, told_route
from agents.drivers.parameters import COMPILED_DRIVERS, DriverParameters
from agents.estimation.batch_filter import estimator_rows
from agents.estimation.motion_model import (
    SPAN,
    KalmanParameters,
    history_depth,
    kalman_parameters,
)
from bus.errors import ScenarioError
from bus.messages import LinkKind, LinkStatus, Mission, UavBriefing
from bus.registry import DEFAULT_DRIVER, DRIVERS, LAWS
from bus.ticks import radio_ticks
from outrider.envs.closed_loop_state import (
    GUARD_METRICS,
    LoopParameters,
    LoopState,
    LoopTables,
)
from outrider.envs.closed_loop_tick import run_worlds
from sim.channel.link_records import no_packets
from sim.engine.batch import Batch, Fresh, arrays_of
from sim.engine.briefing import uav_briefing, ugv_briefing
from sim.engine.certificate_counts import (
    CertificateBounds,
    certificate_bounds,
    certificate_counts,
    sent_commands,
)
from sim.engine.mission import mission_of
from sim.engine.run_keys import check_secret
from sim.engine.world_state import joined
from sim.env.patch import given_patch
from sim.env.rewards import RewardWeights
from sim.env.rows import UAV_METRICS, row_state, row_tables
from sim.env.settings import EPISODE_DEFAULTS, EpisodeSettings, completed
from sim.kernels.compile import FloatArray, IntArray
from sim.kernels.records import records
from sim.models.randomness import PILOT
from sim.scenario.types import Scenario

_INNER = {law.code: law.inner for law in LAWS.values() if law.inner}
"""By the code of a law, the field of `[custom]` whose policy flies in its place."""
_NO_ACTIONS = np.zeros((0, 0, 2))
_Memory = TypeVar("_Memory")


def _repeated(memory: _Memory, worlds: int, of_each: int) -> _Memory:
    """The memory of one vehicle for each of `of_each` in each world.

    Args:
        memory: An array, or a named tuple of such memories.
        worlds, of_each: Sizes of the axes that come in front of each array.
    """
    one: Any = memory
    if hasattr(one, "_make"):
        many = one._make(_repeated(part, worlds, of_each) for part in one)
    else:
        many = np.broadcast_to(one, (worlds, of_each, *one.shape)).copy()
    return cast("_Memory", many)


def pilot_names(scenario: Scenario, vehicle: str) -> tuple[str, ...]:
    """The laws or drivers that can fly or drive a vehicle in here, by name."""
    if any(uav.name == vehicle for uav in scenario.uav):
        return tuple(law.name for law in LAWS.values() if not law.own)
    return tuple(COMPILED_DRIVERS)


class LoopSettings(EpisodeSettings, total=False):
    """Settings of many worlds at once; by default `LOOP_DEFAULTS`."""

    estimate: bool
    """True: the UAVs' rows have the Kalman filter's estimate in the place of the raw detection."""
    gradient: bool
    """True: the UAVs' rows end with `bus.observations.GRADIENT`."""
    safety_filter: bool
    """True: actions from outside go through the safety filter, as those of the law `certified` do."""
    threads: int | None
    """Processor cores that share the worlds; None: all that this process may use."""


LOOP_DEFAULTS = LoopSettings(
    **EPISODE_DEFAULTS,
    estimate=False,
    gradient=False,
    safety_filter=False,
    threads=None,
)


class ClosedLoop:
    """Many worlds of one scenario with everybody in them.

    Args:
        scenario: What is flown in each.
        worlds: How many.
        external: Vehicles whose actions come from outside, in the order of the actions.
        pilots: Who flies or drives the others, by name, instead of the scenario's law and drivers.
        error: Whether e(t) is computed at every tick; if `uncovered` is paid, it is in any case.
        settings: Options by keyword: `LoopSettings` says what each is.

    Raises:
        ScenarioError: If a vehicle has a law or a driver that cannot be flown in here.
        ValueError: If another argument is not allowed.
        TypeError: If there is no setting of that name.
    """

    def __init__(
        self,
        scenario: Scenario,
        worlds: int,
        *,
        external: Collection[str] = (),
        pilots: Mapping[str, str] | None = None,
        error: bool = False,
        **settings: Unpack[LoopSettings],
    ) -> None:
        options = completed(LoopSettings, settings, LOOP_DEFAULTS)
        estimate, gradient = options["estimate"], options["gradient"]
        patch = given_patch(options["coverage_patch"])
        self.scenario = scenario
        self.worlds = worlds
        self.names = tuple(vehicle.name for vehicle in scenario.vehicles)
        """Vehicles in the order of every array."""
        self.uavs = tuple(name for name in self.names if name in {uav.name for uav in scenario.uav})
        """UAVs in the order of theirs."""
        self.ugvs = tuple(name for name in self.names if name not in self.uavs)
        """UGVs in the order of theirs."""
        self.external = tuple(external)
        """The vehicles whose actions come from outside."""
        weights = options["rewards"] or RewardWeights()
        chosen = dict(pilots or {})
        for name in (*self.external, *chosen):
            if name not in self.names:
                raise ValueError(f"vehicle = {name!r}; allowed: {', '.join(self.names)}")
        numbers = _PilotNumbers(
            scenario,
            self.uavs,
            self.ugvs,
            set(self.external),
            chosen,
            shield=options["safety_filter"],
        )
        self.batch = Batch(
            scenario,
            worlds,
            gains=weights.seen > 0.0,
            threads=options["threads"],
            secret=check_secret(options["secret"]),
            others=(LinkKind.RADIO,),
        )
        receiving = numbers.radio
        thinking = numbers.thinking | (estimate or gradient or receiving)
        dt, ground, grounded = scenario.dt, scenario.ground, scenario.has_ground and receiving
        self.parameters = LoopParameters(
            error=error or weights.uncovered > 0.0,
            estimate=estimate,
            gradient=gradient,
            own_maps=len(self.uavs) > 1 or scenario.disturbed,
            radio=receiving,
            radio_ticks=radio_ticks(dt),
            telling_ticks=telling_ticks(ground.telling, dt) if grounded else 0,
            tile=float(ground.tile) if grounded else 0.0,
            meters_per_pixel=float(patch.meters_per_pixel) if patch else 1.0,
        )
        scripts, script_rows = joined(numbers.scripts, 3)
        rows = row_tables(
            scenario,
            weights,
            end_on_sight_lost=options["end_on_sight_lost"],
            end_on_goals=options["end_on_goals_reached"],
        )
        self.tables = LoopTables(
            batch=self.batch.tables,
            rows=rows,
            hand=np.array(
                [self.external.index(n) if n in self.external else -1 for n in self.names],
                dtype=np.int64,
            ),
            thinking=thinking.astype(np.int64),
            guarded=numbers.guarded.astype(np.int64),
            faults=numbers.faults.astype(np.int64),
            bounds=numbers.bounds,
            receivers=np.array(
                [self.ugvs.index(self.names[g]) for g in self.batch.tables.escorts[:, 1]],
                dtype=np.int64,
            ),
            kalman=numbers.kalman,
            promises=numbers.promises,
            scripts=scripts,
            script_rows=script_rows,
            late=numbers.late,
        )
        late = self.batch.links.longest(LinkKind.DETECTIONS)
        kalman = estimator_rows(min(late + 1, history_depth(SPAN, dt)))
        guard = guard_state(numbers.longest, min(late + 1, numbers.track))
        uavs, ugvs = len(self.uavs), len(self.ugvs)
        room = self.batch.links.packets.shape[3]
        coverage = self.batch.state.coverage
        told_room = 0
        if grounded and self.batch.ground is not None:
            told_room = max(BLOCK_TILES, self.batch.ground.seen.shape[2])
        telling = telling_memory(scenario.area.width, scenario.area.height, self.parameters.tile)
        pixels = patch.pixels if patch else 1
        self.state = LoopState(
            batch=self.batch.state,
            rows=row_state(rows, worlds, uav_metrics=len(GUARD_METRICS)),
            maps=_repeated(coverage[0], worlds, uavs if self.parameters.own_maps else 0),
            certificates=np.repeat(numbers.certificates[None], worlds, axis=0),
            sent=np.repeat(numbers.sent[None], worlds, axis=0),
            laws=np.repeat(numbers.laws[None], worlds, axis=0),
            drivers=np.repeat(numbers.drivers[None], worlds, axis=0),
            law_states=_repeated(initial_state(), worlds, uavs),
            kalman=_repeated(kalman, worlds, uavs),
            guards=_repeated(guard, worlds, uavs),
            driver_states=_repeated(driver_memory(), worlds, ugvs),
            grounds=_repeated(numbers.ground, worlds, ugvs),
            outbox=no_packets(worlds, uavs, 2),
            looks=np.zeros((worlds, room, 3)),
            inboxes=np.zeros((worlds, ugvs, room * uavs if receiving else 1, 3)),
            arrived=np.zeros((worlds, ugvs), dtype=np.int64),
            patches=np.zeros((worlds, uavs if patch else 0, pixels, pixels)),
            telling=_repeated(telling, worlds, uavs),
            places=np.zeros((worlds, 2, told_room), dtype=np.int64),
            states=np.zeros((worlds, told_room), dtype=np.uint8),
        )
        self.state.outbox["stamp"] = -1.0
        self._lookaheads: LookaheadMemory | None = None  # unless a UAV flies by that law
        if (numbers.laws["law"] == LOOKAHEAD).any():
            self._lookaheads = _repeated(lookahead_memory(), worlds, uavs)
        # all but the batch, which knows its own
        self._fresh = Fresh((*self.state[1:], self._lookaheads))
        self._all = np.arange(worlds)
        self.begin([scenario.seed], [0])

    @property
    def degraded(self) -> bool:
        """True if any link does anything to a message."""
        return self.batch.links.degraded

    def begin(
        self, seeds: Sequence[int] | IntArray, worlds: Sequence[int] | IntArray | None = None
    ) -> None:
        """Begin worlds anew.

        Args:
            seeds: One for each of them, from 0 to 2**53 - 1.
            worlds: Which; all by default.
        """
        which = self.batch.restore(seeds, worlds)
        self._fresh.restore(which)
        keys = self.state.batch.vehicles["keys"][which, :, PILOT]
        for rows, vehicles in (
            (self.state.laws, self.tables.batch.escorts[:, 0]),
            (self.state.drivers, self.tables.batch.ugvs),
        ):
            for word, name in enumerate(("key_0", "key_1")):
                rows[name][which] = keys[:, vehicles, word]
        self._run(which, _NO_ACTIONS, 0)

    def step(self, actions: FloatArray, worlds: IntArray | None = None) -> None:
        """Worlds advance by one tick.

        Args:
            actions: Accelerations [m/s²] of the vehicles in `external`, finite. Shape (worlds, len(external), 2).
            worlds: Which; all by default.
        """
        self._run(self._all if worlds is None else worlds, actions, 1)

    def fly(self, ticks: int | None = None) -> None:
        """Fly every world on, each until its episode is over, or so many ticks.

        Raises:
            ValueError: If actions are to come from outside.
        """
        if self.external:
            raise ValueError(
                f"the actions of {', '.join(self.external)} come from outside: use step"
            )
        none, most = np.zeros((self.worlds, 0, 2)), self.scenario.ticks if ticks is None else ticks
        if most > 0:
            self._run(self._all, none, most)

    def _run(self, worlds: IntArray, actions: FloatArray, ticks: int) -> None:
        which = np.ascontiguousarray(worlds, dtype=np.int64)
        given = np.ascontiguousarray(actions, dtype=np.float64)
        loop = self.parameters, self.tables, self.state, self.batch.ground, self._lookaheads
        self.batch.workers.share(run_worlds, len(worlds), *loop, which, given, ticks)

    def metrics(self, uav: str) -> dict[str, FloatArray]:
        """A UAV's true standing in this episode, in each world; arrays of shape (worlds,).

        `mean_error` is the mean of e(t) [m²] over the ticks so far, the first included; NaN where e(t) is not computed.
        `certified_while_lost` counts the ticks that the safety filter certified with the UGV out of sight,
        `certificate_broken` those that it did not certify although the one before was and all assumptions held: any is
        a fault of the certificate.
        """
        row, ticks = self.uavs.index(uav), self.state.batch.ticks
        rows, counts = self.state.rows.uavs[:, row], self.state.certificates[:, row]
        watched = np.maximum(counts["ticks"], 1.0)
        counted = np.where(self.parameters.error, 1.0, np.nan)
        return {
            "ticks": ticks.astype(np.float64),
            "distance": rows[:, UAV_METRICS.distance].copy(),
            "max_distance": rows[:, UAV_METRICS.max_distance].copy(),
            "visibility_violations": rows[:, UAV_METRICS.violations].copy(),
            "coverage_error": rows[:, UAV_METRICS.error] * counted,
            "mean_error": rows[:, UAV_METRICS.error_sum] / (ticks + 1) * counted,
            "intervened": counts["intervened"] / watched,
            "certified": counts["certified"] / watched,
            "certified_while_lost": counts["lost"].astype(np.float64),
            "certificate_broken": counts["broken"].astype(np.float64),
        }

    def mission(self, world: int) -> Mission:
        """The mission of one world so far, where there are hazards."""
        if self.batch.ground is None:
            raise ValueError("there are no hazards, so there is no mission")
        goal_rows, dt = self.tables.batch.goal_rows, self.scenario.dt
        return mission_of(goal_rows, self.batch.ground, world, dt, self.ugvs)

    def links(self, world: int) -> dict[str, LinkStatus]:
        """The counters of each link of one world so far, by `vehicle/kind`."""
        return self.batch.links.status(world)

    def bytes_per_world(self) -> int:
        """Memory that one more world needs [bytes]."""
        return sum(array.nbytes for array in arrays_of(self.state)) // self.worlds

    def close(self) -> None:
        """End the threads."""
        self.batch.workers.close()


class _PilotNumbers:
    """The parameters of all pilots, in tables."""

    def __init__(
        self,
        scenario: Scenario,
        uavs: Sequence[str],
        ugvs: Sequence[str],
        external: set[str],
        chosen: Mapping[str, str],
        *,
        shield: bool,
    ) -> None:
        told_uavs = [uav_briefing(scenario, name, 0) for name in uavs]
        told_ugvs = [ugv_briefing(scenario, name, 0) for name in ugvs]
        never_asked = dict.fromkeys(uavs, "tracking") | dict.fromkeys(ugvs, DEFAULT_DRIVER)
        pilots = {**chosen, **{name: never_asked[name] for name in external}}
        laws = [self._law(one, pilots.get(one.vehicle)) for one in told_uavs]
        for one, law in zip(told_uavs, laws, strict=True):
            named = getattr(scenario.custom, _INNER.get(law.law, ""), "")
            if named and one.vehicle not in pilots:
                raise ScenarioError(
                    f"{one.vehicle}: uav_policy = {named!r}: flies in a run, not in many worlds; allowed: no policy, "
                    "or the policy itself as one of the `others`"
                )
        promises = [promise_of(one) for one in told_uavs]
        self.laws = records(LawParameters, laws)
        self.longest = max((promise.delay_ticks for promise in promises), default=0)
        self.track = max((track_ticks(promise) for promise in promises), default=1)
        bounds = [certificate_bounds(one.certificate, one.dt) for one in told_uavs]
        self.bounds = records(CertificateBounds, bounds)
        self.certificates = certificate_counts(len(uavs))
        self.sent = sent_commands(bounds)
        self.promises = records(Promise, promises)
        self.faults = np.array([bool(check_assumptions(one)) for one in promises], dtype=np.bool_)
        self.kalman = records(
            KalmanParameters,
            [
                kalman_parameters(
                    detector=one.detector,
                    target=one.target_limits,
                    dt=one.dt,
                    settings=one.estimator,
                )
                for one in told_uavs
            ],
        )
        outside = np.array([name in external for name in uavs], dtype=np.bool_)
        watched = np.array([law.law in WATCHED for law in laws], dtype=np.bool_)
        self.guarded = watched & ~outside | outside & shield
        self.thinking = ~outside
        drivers = [pilots.get(one.vehicle) or one.driver for one in told_ugvs]
        self.drivers = records(DriverParameters, list(map(driver_parameters, told_ugvs, drivers)))
        self.scripts = [told_route(one).script for one in told_ugvs]
        grounds = [told_ground(one) for one in told_ugvs]
        self.late = np.array([len(memory.sent) for memory in grounds], dtype=np.int64)
        self.ground = max(grounds, key=lambda memory: len(memory.sent))  # all have one area
        self.radio = scenario.has_ground or any(  # whoever drives is told of the ground
            DRIVERS[driver].listens and name not in external
            for name, driver in zip(ugvs, drivers, strict=True)
        )

    @staticmethod
    def _law(told: UavBriefing, name: str | None) -> LawParameters:
        law = told.law if name is None else msgspec.structs.replace(told.law, name=name)
        if law.name in LAWS and LAWS[law.name].own:
            raise ScenarioError(
                f"{told.vehicle}: law.name = {law.name!r} is a function of your own and cannot be compiled"
            )
        return law_parameters(told, law)
