"""The adversary of the network: blackouts, and what becomes of the UAV's commands."""

from bus.ticks import TICK_TOLERANCE
from outrider_falsify.attack_records import RING, Room, Run, View
from outrider_falsify.conditions import BLACKOUTS, DISTURBANCES, Conditions
from outrider_falsify.draws import Words, next_share
from outrider_falsify.lost_motions import Pending, loses
from outrider_falsify.opponents import UAV, UGV
from sim.compiling.compile import compiled
from sim.models.motion import keep_motion
from sim.models.safety import SafetyBounds
from sim.models.vehicles import norm


@compiled
def _delay_command(conditions: Conditions, room: Room, random: Words, tick: int, dt: float) -> int:
    """Return the tick whose command sets out in this one; -1: none does."""
    trouble = room.trouble[0]
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
def darken(
    conditions: Conditions, bounds: SafetyBounds, room: Room, random: Words, tick: int
) -> None:
    """Begin a blackout now and then, with a detection at least since the last one."""
    trouble, now, longest = room.trouble[0], room.now, round(conditions.blackout_time / bounds.dt)
    if trouble.dark > 0 or trouble.seen == 0 or tick <= 20 or longest == 0:
        return
    if conditions.blackout == BLACKOUTS.periodic:
        trouble.dark = longest
    elif conditions.blackout == BLACKOUTS.random and next_share(random) < 0.02:
        trouble.dark = 1 + int(next_share(random) * longest)
    elif conditions.blackout == BLACKOUTS.when_far:
        x, y = now[UAV].p_x - now[UGV].p_x, now[UAV].p_y - now[UGV].p_y
        if norm(x, y) > 0.6 * conditions.r_v and next_share(random) < 0.2:
            trouble.dark = longest


@compiled
def _lose_motion(run: Run, view: View) -> bool:
    """Keep the motion that a command carries in the world; return true if the adversary loses it."""
    bounds, conditions, plots = run.bounds, run.conditions, run.room.plots
    tick, d_ticks = view.tick, bounds.delay_ticks
    allowed = int(conditions.outage / bounds.dt + TICK_TOLERANCE)
    held, under = run.memory.plan[0], run.memory.pending.sent
    left = held.turn + held.cruise + held.brake
    pending = Pending(tick, d_ticks, allowed, view.distance / conditions.r_v, left)
    kind = run.room.roles[0].losses
    lost, plots[UAV].losing = loses(kind, run.random, plots[UAV].losing, pending)
    keep_motion(run.state.motions[0, UAV], under[(tick + d_ticks) % under.shape[0]], tick)
    return lost


@compiled
def send_command(run: Run, view: View, u_x: float, u_y: float, carrying: bool) -> None:
    """Let the UAV's command set out [m/s²], with a motion or bare, or one of before, or none."""
    room, bounds = run.room, run.bounds
    uav = run.state.vehicles[0, UAV]
    sent = room.ring[view.tick % RING]
    sent[0], sent[1], sent[2] = u_x, u_y, 1.0 if carrying else 0.0
    then = -1
    if room.trouble[0].away == 0:
        then = _delay_command(run.conditions, room, run.random, view.tick, bounds.dt)
    if carrying and _lose_motion(run, view):
        then = -1
    sent, uav.outgoing_tick = room.ring[then % RING], then
    uav.outgoing[0], uav.outgoing[1] = sent[0], sent[1]
    uav.outgoing_motion = then + bounds.delay_ticks if sent[2] > 0.0 else -1
    uav.outgoing_motions = 1 if sent[2] > 0.0 else 0
