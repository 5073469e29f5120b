"""The vehicles' seats in the environment: what each observes and is paid, and what has to be remembered for it."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bus.layout import UavRow, UavState, UgvRow, UgvState
from sim.env.rewards import (
    RewardWeights,
    UavTerms,
    UgvTerms,
    full_error,
    total,
    uav_terms,
    ugv_terms,
)
from sim.kernels.compile import FloatArray, compiled
from sim.models.vehicles import goal_reached, norm
from sim.scenario.types import Scenario, Ugv
from sim.world import Look, World


class Moment(NamedTuple):
    """The truth at one tick, as plain floats: rows as in the world's arrays."""

    tick: int
    time: float
    position: list[list[float]]
    velocity: list[list[float]]
    acceleration: list[list[float]]
    received: list[list[Look]]
    gains: list[float]
    measures: list[list[float]]

    @classmethod
    def of(cls, world: World) -> "Moment":
        """The moment that the world is at."""
        return cls(
            world.tick,
            world.time,
            world.position.tolist(),
            world.velocity.tolist(),
            world.acceleration.tolist(),
            list(world.received),
            world.state.gains.tolist(),
            world.measure().tolist(),
        )


def route_of(ugv: Ugv) -> FloatArray:
    """A UGV's goals [m]. Shape (goals, 2)."""
    return np.array(ugv.goals, dtype=np.float64).reshape(-1, 2)


@compiled
def turn(
    goals: FloatArray, reached: int, tolerance: float, x: float, y: float
) -> tuple[int, float]:
    """How many goals are reached from (x, y) [m] on, and the way to the next one [m]; 0 where none is left."""
    while reached < goals.shape[0] and goal_reached(
        x, y, goals[reached, 0], goals[reached, 1], tolerance
    ):
        reached += 1
    if reached == goals.shape[0]:
        return reached, 0.0
    return reached, norm(x - goals[reached, 0], y - goals[reached, 1])


class UavSeat:
    """One UAV: it may know its own state and its detections; it is paid for ground seen and for sight kept."""

    state_row = UavState

    def __init__(
        self, scenario: Scenario, weights: RewardWeights, name: str, vehicle: int, escort: int
    ) -> None:
        self.name = name
        self.vehicle = vehicle
        """Its row in the world's arrays of vehicles."""
        self.escort = escort
        """Its row in the world's arrays of UAVs."""
        self.lost = False
        """Whether the distance is r_v or more at this tick."""
        self.terms = UavTerms()
        self._weights = weights
        self._dt = scenario.dt
        self._horizon = scenario.ticks * scenario.dt
        self._r_v = scenario.visibility.radius
        self._full = full_error(
            scenario.visibility.radius + scenario.sensor.range, scenario.coverage.desired
        )

    def begin(self, moment: Moment) -> None:
        """Forget the last episode."""
        self.terms = UavTerms()
        self._newest: int | None = None  # tick of the newest detection that has come
        self._violations = 0
        self._max_distance = 0.0
        self.lost = False
        self.advance(moment)

    def advance(self, moment: Moment) -> None:
        """Take in the next tick."""
        distance = moment.measures[self.escort][0]
        self._was_lost, self.lost = self.lost, distance >= self._r_v
        self._violations += self.lost
        self._max_distance = max(self._max_distance, distance)
        for look in moment.received[self.escort]:
            self._newest = look.tick if self._newest is None else max(self._newest, look.tick)

    def _age(self, moment: Moment) -> float:
        return self._horizon if self._newest is None else moment.time - self._newest * self._dt

    def row(self, moment: Moment) -> UavRow:
        """What it observes."""
        x, y = moment.position[self.vehicle]
        vx, vy = moment.velocity[self.vehicle]
        looks = moment.received[self.escort]
        if looks:
            look = max(looks)  # the newest; the pilots that fly over the bus use them all
            return UavRow(
                moment.time, x, y, vx, vy, 1.0, look.x, look.y, moment.time - look.tick * self._dt
            )
        return UavRow(moment.time, x, y, vx, vy, 0.0, 0.0, 0.0, self._age(moment))

    def state(self, moment: Moment) -> UavState:
        """The truth of it."""
        distance, error = moment.measures[self.escort]
        x, y = moment.position[self.vehicle]
        vx, vy = moment.velocity[self.vehicle]
        return UavState(x, y, vx, vy, distance, error, self._age(moment))

    def reward(self, moment: Moment, ticks_lost: int) -> float:
        """What it is paid for this tick; the terms stay in `terms`.

        Args:
            moment: This tick.
            ticks_lost: Ticks that are charged if it is out of sight: one, and the rest of the episode where it
                ends by that.
        """
        w, (u_x, u_y) = self._weights, moment.acceleration[self.vehicle]
        self.terms = UavTerms._make(
            uav_terms(
                w.uncovered,
                w.seen,
                w.sight_lost,
                w.out_of_sight,
                w.effort,
                moment.measures[self.escort][1],
                moment.gains[self.escort],
                self._full,
                self.lost,
                self._was_lost,
                ticks_lost,
                u_x,
                u_y,
                self._dt,
            )
        )
        return total(self.terms)

    def info(self) -> dict[str, float]:
        """Facts of its own that are in no row: none."""
        return {}

    def metrics(self, moment: Moment) -> dict[str, float]:
        """How it truly stands, for people."""
        distance, error = moment.measures[self.escort]
        return {
            "distance": distance,
            "margin": self._r_v - distance,
            "max_distance": self._max_distance,
            "visibility_violations": self._violations,
            "coverage_error": error,
            "uncovered_share": error / self._full,
        } | {f"reward_{name}": term for name, term in self.terms._asdict().items()}


class UgvSeat:
    """One UGV: it may know its own state and its goal.

    It is paid for coming nearer to its goals and for reaching them.
    """

    state_row = UgvState
    lost = False

    def __init__(self, scenario: Scenario, weights: RewardWeights, ugv: Ugv, vehicle: int) -> None:
        self.name = ugv.name
        self.vehicle = vehicle
        self.terms = UgvTerms()
        self._weights = weights
        self._dt = scenario.dt
        self._tolerance = ugv.goal_tolerance
        self._goals = [(float(x), float(y)) for x, y in ugv.goals]
        self._route = route_of(ugv)

    @property
    def underway(self) -> bool:
        """Whether a goal is still to be reached."""
        return self._reached < len(self._goals)

    @property
    def has_goals(self) -> bool:
        """Whether it was given any goal."""
        return bool(self._goals)

    def _goal(self) -> tuple[float, float]:
        if not self._goals:
            return 0.0, 0.0
        return self._goals[min(self._reached, len(self._goals) - 1)]

    def _way(self, x: float, y: float) -> float:
        """Distance to the goal [m]."""
        goal_x, goal_y = self._goal()
        return norm(x - goal_x, y - goal_y)

    def begin(self, moment: Moment) -> None:
        """Forget the last episode."""
        self.terms = UgvTerms()
        self._reached = 0
        self._progress = 0.0
        self._arrivals = 0
        self._turn(*moment.position[self.vehicle])

    def _turn(self, x: float, y: float) -> None:
        """Turn to the next goal where one is reached: the rule of the paper's driver."""
        before = self._reached
        self._reached, self._to_go = turn(self._route, before, self._tolerance, x, y)
        self._arrivals = self._reached - before

    def advance(self, moment: Moment) -> None:
        """Take in the next tick."""
        x, y = moment.position[self.vehicle]
        if self.underway:
            self._progress = self._to_go - self._way(x, y)
            self._turn(x, y)
        else:
            self._progress, self._arrivals = 0.0, 0

    def row(self, moment: Moment) -> UgvRow:
        """What it observes."""
        x, y = moment.position[self.vehicle]
        vx, vy = moment.velocity[self.vehicle]
        goal_x, goal_y = self._goal()
        return UgvRow(moment.time, x, y, vx, vy, float(self.underway), goal_x, goal_y)

    def state(self, moment: Moment) -> UgvState:
        """The truth of it."""
        x, y = moment.position[self.vehicle]
        vx, vy = moment.velocity[self.vehicle]
        goal_x, goal_y = self._goal()
        return UgvState(x, y, vx, vy, float(self.underway), goal_x, goal_y)

    def reward(self, moment: Moment, ticks_lost: int) -> float:
        """What it is paid for this tick; the terms stay in `terms`. It is not its task to keep sight."""
        w, (u_x, u_y) = self._weights, moment.acceleration[self.vehicle]
        self.terms = UgvTerms._make(
            ugv_terms(
                w.progress, w.goal, w.effort, self._progress, self._arrivals, u_x, u_y, self._dt
            )
        )
        return total(self.terms)

    def info(self) -> dict[str, float]:
        """Facts of its own that are in no row."""
        return {"goals_reached": self._reached}

    def metrics(self, moment: Moment) -> dict[str, float]:
        """How it truly stands, for people."""
        return {"goals_reached": self._reached, "way_to_goal": self._to_go} | {
            f"reward_{name}": term for name, term in self.terms._asdict().items()
        }


Seat = UavSeat | UgvSeat


def all_arrived(seats: Sequence[Seat]) -> bool:
    """Whether every UGV that has goals has reached them all; never where none has any."""
    busy = [seat for seat in seats if isinstance(seat, UgvSeat) and seat.has_goals]
    return bool(busy) and not any(seat.underway for seat in busy)


def seats(scenario: Scenario, weights: RewardWeights) -> list[Seat]:
    """A seat for each vehicle, in name order."""
    names = [vehicle.name for vehicle in scenario.vehicles]
    uavs = [name for name in names if name in {uav.name for uav in scenario.uav}]
    return [
        UgvSeat(scenario, weights, vehicle, k)
        if isinstance(vehicle, Ugv)
        else UavSeat(scenario, weights, vehicle.name, k, uavs.index(vehicle.name))
        for k, vehicle in enumerate(scenario.vehicles)
    ]
