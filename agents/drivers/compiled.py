"""The drivers that are compiled: a shell around `agents.drivers.ugv_tick.ugv_tick`.

A driver that listens to a person or to a policy has no compiled form.
"""

import math

import numpy as np

from agents.drivers.evade import evade_lead, evade_ticks
from agents.drivers.navigate import PLAIN
from agents.drivers.parameters import COMPILED_DRIVERS, DriverMemory, DriverParameters, Route
from agents.drivers.planning import way_corners
from agents.drivers.steering import Steering
from agents.drivers.tile_map import (
    GroundMemory,
    PlaceArray,
    ground_memory,
    note_block,
    note_tiles,
)
from agents.drivers.ugv_tick import ugv_tick
from agents.drivers.wander import wander_pace
from agents.looks import LookRows
from bus.errors import ScenarioError
from bus.messages import (
    MOST_CARRIED,
    MOST_CORNERS,
    MotionPlan,
    UgvBriefing,
    UgvObservation,
    UgvReport,
    Vector,
    or_infinite,
)
from bus.registry import BOLD, DRIVERS
from bus.ticks import first_tick_from
from sim.kernels.records import RecordArray, record_type, records
from sim.models.ground import (
    CERTIFIED,
    NO_CLAIM,
    UNCERTIFIED,
    tile_index,
    tile_states,
    tiles_shape,
)
from sim.models.motion import NO_MOTION
from sim.models.randomness import words_of
from sim.models.vehicles import Motion

MOST_TILES = 1_000_000
"""More than that no UGV keeps."""
_PLAN_PERIOD = 0.2
"""The driver that navigates keeps a plan for so long at least [s]."""
PLAN_TILES = 8192
"""So many tiles it settles a tick at most when it plans: as long as that takes, no tick takes much longer."""


def driver_parameters(briefing: UgvBriefing, driver: str) -> DriverParameters:
    """The numbers of one driver for one UGV.

    Raises:
        ScenarioError: If the driver has no compiled form.
    """
    if driver not in COMPILED_DRIVERS:
        raise ScenarioError(
            f"driver = {driver!r}: has no compiled form; allowed: {', '.join(COMPILED_DRIVERS)}"
        )
    wheel, limits, ground = Steering(briefing), briefing.limits, briefing.ground
    width, height = float(briefing.area.width), float(briefing.area.height)
    speed, margin = wander_pace(width, height, wheel.v_max, wheel.u_max, wheel.dt)
    unbounded = DRIVERS[driver].unbounded
    key_0, key_1 = words_of(briefing.key)
    lead = float(evade_lead(speed, wheel.u_max))
    forgotten, dash = evade_ticks(lead, wheel.dt)
    return DriverParameters(
        driver=COMPILED_DRIVERS[driver],
        dt=wheel.dt,
        width=width,
        height=height,
        v_max=or_infinite(limits.max_speed) if unbounded else wheel.v_max,
        u_max=or_infinite(limits.max_acceleration) if unbounded else wheel.u_max,
        tolerance=float(briefing.goal_tolerance),
        speed=float(speed),
        margin=float(margin),
        lead=lead,
        forgotten=forgotten,
        dash=dash,
        key_0=key_0,
        key_1=key_1,
        tile=0.0 if ground is None else ground.tile,
        bold=int(ground is not None and ground.caution == BOLD),
        share=1.0 if ground is None else ground.share,
        plan_ticks=max(1, round(_PLAN_PERIOD / wheel.dt)),
        plan_tiles=PLAN_TILES,
    )


def told_route(briefing: UgvBriefing) -> Route:
    """The goals and the script of a briefing; of two steps at one time the later in the list counts."""
    steps = sorted(briefing.script, key=lambda step: step.time)
    script = [(first_tick_from(step.time, briefing.dt), *step.velocity) for step in steps]
    return Route(
        goals=np.array(briefing.goals, dtype=np.float64).reshape(-1, 2),
        script=np.array(script, dtype=np.float64).reshape(-1, 3),
    )


def driver_memory() -> RecordArray:
    """The memory of a driver that has not driven yet, whichever it is. Shape (1,)."""
    memory = np.zeros(1, record_type(DriverMemory))
    memory["received"] = memory["out_end"] = -math.inf
    return memory


def told_ground(briefing: UgvBriefing) -> GroundMemory:
    """The ground as a UGV knows it before it has been told any tile; without tiles where there are no hazards.

    Raises:
        ScenarioError: If there are too many tiles.
    """
    ground, area = briefing.ground, briefing.area
    if ground is None:
        return ground_memory(0, 0)
    shape = tiles_shape(area.width, area.height, ground.tile)
    if shape[0] * shape[1] > MOST_TILES:
        raise ScenarioError(
            f"ground.tile = {ground.tile:g}: makes {shape[0] * shape[1]:.3g} tiles of the area; "
            f"at most {MOST_TILES:,}"
        )
    return ground_memory(*shape, first_tick_from(ground.delay, briefing.dt))


def take_ground(memory: GroundMemory, observation: UgvObservation) -> None:
    """Take in what an observation tells of the ground."""
    for block in observation.blocks:
        note_block(memory, block.row, block.column, tile_states(block.tiles))
    if observation.ground:
        places = np.array([(one.row, one.column) for one in observation.ground], dtype=np.int64)
        states = tile_states("".join(one.state for one in observation.ground))
        rows, columns = np.ascontiguousarray(places.T)
        note_tiles(memory, rows, columns, states)


class CompiledDriver:
    """Drives as `ugv_tick` says.

    Args:
        briefing: What the UGV is told when it joins.
        name: Of the driver, a row of the registry with a code.

    Raises:
        ScenarioError: If the driver has no compiled form, or the ground has too many tiles.
    """

    def __init__(self, briefing: UgvBriefing, name: str) -> None:
        self.parameters = driver_parameters(briefing, name)
        """Its numbers."""
        self.own = driver_memory()
        """Memory of the drivers without a plan."""
        self.ground = told_ground(briefing)
        """Memory of the ground; without tiles if there are no hazards."""
        self._fixed = (
            records(DriverParameters, [self.parameters])[0],
            told_route(briefing),
            self.own,
            self.ground if self.ground.tiles.size else None,
        )
        self._looks = LookRows(briefing.dt)
        self._carries = briefing.ground is not None and briefing.ground.carries

    def drive(self, observation: UgvObservation) -> tuple[float, float]:
        """Return the acceleration [m/s²] for this observation."""
        if observation.ground or observation.blocks:
            take_ground(self.ground, observation)
        radio, here = (
            self._looks.take(observation.radio),
            Motion(*observation.position, *observation.velocity),
        )
        flown = NO_MOTION if observation.flown is None else observation.flown
        flown = flown if self._carries else PLAIN
        return ugv_tick(*self._fixed, *radio, observation.tick, here, flown)

    @property
    def goal(self) -> tuple[float, float] | None:
        """The random goal that it wanders to [m]; None while it has none."""
        own = self.own[0]
        return (float(own["goal_x"]), float(own["goal_y"])) if own["chosen"] else None


class NavigateDriver(CompiledDriver):
    """From goal to goal over the ground as it knows it, see `agents.drivers.navigate`."""

    def __init__(self, briefing: UgvBriefing, name: str = "navigate") -> None:
        super().__init__(briefing, name)
        self._plans = 0
        self._told: tuple[Vector, ...] = ()
        self._corners: PlaceArray = np.zeros(MOST_CORNERS, dtype=np.int32)

    def motions(self, tick: int) -> tuple[MotionPlan, ...]:
        """Return the motions that the command of this tick carries: its own, and those before it that may begin yet."""
        if not self._carries:
            return ()
        sent = self.ground.sent
        last = tick + len(sent) - 2
        first = max(tick, last - MOST_CARRIED + 1)
        rows = [sent[begins % len(sent)] for begins in range(first, last + 1)]
        return tuple(
            MotionPlan(begins, int(row["parent"]), (float(row["first_x"]), float(row["first_y"])))
            for begins, row in zip(range(first, last + 1), rows, strict=True)
            if row["begins"] == begins
        )

    def report(self) -> UgvReport | None:
        """Return the certificate of this tick's command; None: the UGV promises nothing."""
        claim = int(self.ground.flags[0]["claim"])
        if claim == NO_CLAIM:
            return None
        return UgvReport(certified=claim == CERTIFIED, uncertified=UNCERTIFIED.get(claim, ""))

    def forget_commands(self) -> None:
        """Forget the commands so far: they were not sent, or another process has sent them."""
        self.ground.sent["begins"] = NO_MOTION

    def new_route(self, position: Vector) -> tuple[Vector, ...] | None:
        """The way that it plans, by its corners [m] from a place to the goal, for observers; none where there is none.

        Args:
            position: Where the UGV is [m].

        Returns:
            None if it has not changed since it was asked last, but for what has been driven of it.
        """
        memory, tile = self.ground, self.parameters.tile
        flags = memory.flags[0]
        if flags["plans"] == self._plans:
            return None
        self._plans = int(flags["plans"])
        (rows, columns), route = memory.tiles.shape, self._fixed[1]
        goal_x, goal_y = route.goals[flags["goal"]].tolist()
        own, goal = (
            tile_index(y, tile, rows) * columns + tile_index(x, tile, columns)
            for x, y in (position, (goal_x, goal_y))
        )
        count = way_corners(memory.way, columns, own, self._corners)
        turns = self._corners[:count].tolist()
        ahead = [((n % columns + 0.5) * tile, (n // columns + 0.5) * tile) for n in turns[1:]]
        if turns and turns[-1] == goal:
            ahead[-1:] = [(goal_x, goal_y)]
        if tuple(ahead) == self._told[len(self._told) - len(ahead) :] and (ahead or not self._told):
            return None
        self._told = tuple(ahead)
        return (position, *ahead) if ahead else ()
