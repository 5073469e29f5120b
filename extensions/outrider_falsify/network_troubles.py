"""Network adversary: blackouts, and delays and losses of the UAV's commands."""

from bus.ticks import TICK_TOLERANCE
from outrider_falsify.attack_records import RING, Run, Scratch, View
from outrider_falsify.conditions import BLACKOUTS, DISTURBANCES, Conditions
from outrider_falsify.lost_trajectories import Pending, loses
from outrider_falsify.opponents import UAV, UGV
from outrider_falsify.rng import RngState, next_share
from sim.compiling.compile import compiled
from sim.models.safety import SafetyBounds
from sim.models.trajectories import keep_trajectory
from sim.models.vehicles import norm


@compiled
def _delay_command(
    conditions: Conditions, scratch: Scratch, random: RngState, tick: int, dt: float
) -> int:
    """Return the tick whose command leaves now; -1 if none does."""
    trouble = scratch.trouble[0]
    if conditions.disturbance == DISTURBANCES.single_losses and next_share(random) < 0.02:
        return -1
    if conditions.disturbance == DISTURBANCES.silences:
        if trouble.silent == 0 and next_share(random) < 0.02:
            trouble.silent = 1 + int(next_share(random) * max(1, round(conditions.silence / dt)))
        if trouble.silent > 0:
            trouble.silent -= 1
            return -1
    if conditions.disturbance == DISTURBANCES.late:
        if next_share(random) < 0.01:
            trouble.late = int(next_share(random) * 6)
        return int(max(-1, tick - trouble.late))
    return tick


@compiled
def start_blackout(
    conditions: Conditions, bounds: SafetyBounds, scratch: Scratch, random: RngState, tick: int
) -> None:
    """Start a blackout occasionally, with at least one detection since the last blackout."""
    trouble, now, longest = (
        scratch.trouble[0],
        scratch.now,
        round(conditions.blackout_time / bounds.dt),
    )
    if trouble.blackout > 0 or trouble.seen == 0 or tick <= 20 or longest == 0:
        return
    if conditions.blackout == BLACKOUTS.periodic:
        trouble.blackout = longest
    elif conditions.blackout == BLACKOUTS.random and next_share(random) < 0.02:
        trouble.blackout = 1 + int(next_share(random) * longest)
    elif conditions.blackout == BLACKOUTS.when_far:
        x, y = now[UAV].p_x - now[UGV].p_x, now[UAV].p_y - now[UGV].p_y
        if norm(x, y) > 0.6 * conditions.r_v and next_share(random) < 0.2:
            trouble.blackout = longest


@compiled
def _lose_trajectory(run: Run, view: View) -> bool:
    """Store the trajectory of a command in the world; return true if the adversary loses it."""
    bounds, conditions, adversaries = run.bounds, run.conditions, run.scratch.adversaries
    tick, d_ticks = view.tick, bounds.delay_ticks
    allowed = int(conditions.max_command_interval / bounds.dt + TICK_TOLERANCE)
    backup, under = run.memory.plan[0], run.memory.pending.sent
    left = backup.turn + backup.cruise + backup.brake
    pending = Pending(tick, d_ticks, allowed, view.distance / conditions.r_v, left)
    kind = run.scratch.roles[0].losses
    lost, adversaries[UAV].losing = loses(kind, run.random, adversaries[UAV].losing, pending)
    keep_trajectory(run.state.trajectories[0, UAV], under[(tick + d_ticks) % under.shape[0]], tick)
    return lost


@compiled
def send_command(
    run: Run, view: View, u_x: float, u_y: float, u_z: float, carries_trajectory: bool
) -> None:
    """Send the UAV's command [m/s²], with or without a trajectory; the adversary may delay or drop it."""
    scratch, bounds = run.scratch, run.bounds
    uav = run.state.vehicles[0, UAV]
    sent = scratch.ring[view.tick % RING]
    sent[0], sent[1], sent[2], sent[3] = u_x, u_y, 1.0 if carries_trajectory else 0.0, u_z
    then = -1
    if scratch.trouble[0].away == 0:
        then = _delay_command(run.conditions, scratch, run.random, view.tick, bounds.dt)
    if carries_trajectory and _lose_trajectory(run, view):
        then = -1
    sent, uav.outgoing_tick = scratch.ring[then % RING], then
    uav.outgoing[0], uav.outgoing[1] = sent[0], sent[1]
    uav.vertical.outgoing = sent[3]
    uav.outgoing_trajectory = then + bounds.delay_ticks if sent[2] > 0.0 else -1
    uav.outgoing_trajectories = 1 if sent[2] > 0.0 else 0
