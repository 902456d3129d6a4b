# SPDX-License-Identifier: Apache-2.0
"""Where a run begins: the state at an instant from what was commanded and seen until then, and nothing later."""

from __future__ import annotations

import math

import numpy as np

from trueup.arrays import Array, Integers
from trueup.compiled import njit
from trueup.engines.vehicle.kernels import (
    ANGLE,
    ANGLE_OFFSET,
    COMMAND_OFFSET,
    DRIVE,
    DRIVE_DELAY,
    FRONT_COMPLIANCE,
    GRIP,
    HEADING,
    LAGGED,
    LASTS,
    MAX_STEERING,
    POSE_LEFT,
    POSE_TURN,
    PUSH,
    PUSH_LASTS,
    REAR_COMPLIANCE,
    RELAXATION,
    SIDEWAYS,
    SLACK,
    SPEED,
    SPEED_KEPT,
    STEERING_DEAD,
    STEERING_DELAY,
    STEERING_FALLOFF,
    STEERING_LEFT,
    STEERING_RATE,
    STEERING_RIGHT,
    STEERING_SCALE,
    TRIM,
    TRIM_LASTS,
    TURNING,
    TURNS,
    UNDERSTEER,
    VEER,
    WEIGHT_IN_FRONT,
    WHEEL,
    WHEEL_SCALE,
    WHEELBASE,
    X,
    Y,
    ahead_or_back,
    beyond,
    clearly,
    in_steady_curve,
    resistance,
    share_of,
    steered,
    step_actuators,
    step_chassis,
    toward,
    tracked_ahead,
)  # fmt: skip
from trueup.rounding import NEGLIGIBLE
from trueup.tracking.past import MOVES

_ROUNDS, _MOST_BENT = 3, 0.5  # of solving for a bent steering, whose share of the angle stays above this


@njit(cache=True, nogil=True, error_model="numpy")
def delayed(values: Array, column: int, last: int, at: float, before: float) -> float:
    """A signal given at each instant of a grid up to `last`, at a fraction of an instant; `before` until the first."""
    if at >= last:
        return values[last, column]
    if at < 0.0:
        return values[0, column] + min(-at, 1.0) * (before - values[0, column])
    i = int(at)
    return values[i, column] + (at - i) * (values[i + 1, column] - values[i, column])


@njit(cache=True, nogil=True, error_model="numpy")
def advance(p: Array, dt: float, commands: Array, k: int, shares: Array, s: Array) -> None:
    """The actuators one step on from grid instant k, under commands (G, 2): throttle or speed, and steering."""
    last = len(commands) - 1
    drive = delayed(commands, 0, last, k - p[DRIVE_DELAY] / dt, commands[0, 0])
    steering = delayed(commands, 1, last, k - p[STEERING_DELAY] / dt, commands[0, 1])
    step_actuators(p, dt, drive, steering, shares, s)


@njit(cache=True, nogil=True, error_model="numpy")
def compare_speed(m: Array, dt: float, slows: float, faster: float) -> None:
    """One more instant of weighted least squares for a steady push and an error of the speed at the start of the past.

    m (7,): speed by now for a push of one (s), share that is left of a speed at the start, moments of these two, and of
    them with `faster` (m/s), by how much the car is faster than the model. What was long ago is forgotten.
    """
    m[0] += dt * (1.0 - m[0] * slows)
    m[1] -= dt * m[1] * slows
    m[2:] *= math.exp(-dt / LASTS)
    m[2] += dt * m[0] * m[0]
    m[3] += dt * m[0] * m[1]
    m[4] += dt * m[1] * m[1]
    m[5] += dt * m[0] * faster
    m[6] += dt * m[1] * faster


@njit(cache=True, nogil=True, error_model="numpy")
def as_tracked(k: int, speed: float, ring: Array, sums: Array) -> float:
    """The model's speed at the end of step k, as the car's is tracked: by a line through the means of the last steps.

    ring (n,) these means, one written over the oldest by now; sums (2,) theirs, and with their places 0 to n - 1. A tracked
    speed lags where it changes (`Past.lag`), and as much by how the model's is taken here.
    """
    n = len(ring)
    oldest, ring[k % n] = ring[k % n], speed
    sums[0] -= oldest
    sums[1] += (n - 1) * speed - sums[0]
    sums[0] += speed
    return sums[0] / n + 6.0 * (sums[1] - 0.5 * (n - 1) * sums[0]) / (n * n - 1.0)


@njit(cache=True, nogil=True, error_model="numpy")
def explained_speed(m: Array) -> tuple[float, float]:
    """The push (m/s^2) that the moments of `compare_speed` tell, and by how much (m/s) the car is faster by now."""
    determinant = max(m[2] * m[4] - m[3] * m[3], NEGLIGIBLE)
    push = (m[5] * m[4] - m[6] * m[3]) / determinant
    return push, push * m[0] + (m[2] * m[6] - m[3] * m[5]) / determinant * m[1]


@njit(cache=True, nogil=True, error_model="numpy")
def out_of_steady_curve(p: Array, dt: float, commands: Array, k0: int, k1: int, shares: Array, s: Array) -> None:
    """Tyres that slip at grid instant k1 where the commands since k0 have brought them, out of a steady curve."""
    s[SPEED] = commands[k0, 0]
    in_steady_curve(p, s)
    for k in range(k0, k1):
        advance(p, dt, commands, k, shares, s)
        step_chassis(p, dt, s)


@njit(cache=True, nogil=True, error_model="numpy")
def wheel_for(p: Array, angle: float) -> float:
    """The command after lag, slack and rate limit that turns the wheels to `angle` (rad): `steered` the other way round."""
    straight = (angle - p[ANGLE_OFFSET]) / p[STEERING_SCALE]
    share = straight / (p[STEERING_LEFT] if straight > 0.0 else p[STEERING_RIGHT])
    found = share
    for _ in range(_ROUNDS):
        found = share / max(1.0 - p[STEERING_FALLOFF] * found * found, _MOST_BENT)
    return min(max(found, -p[MAX_STEERING]), p[MAX_STEERING]) - p[COMMAND_OFFSET]


@njit(cache=True, nogil=True, error_model="numpy")
def as_it_turns(p: Array, speed: float, turn: float, s: Array) -> None:
    """Wheels of which no command tells are where the car turns at `turn` (rad/s), driving at `speed` (m/s); tyres that take
    up an angle with the way rolled are behind those that still turn. On two driven wheels what was commanded has become this.
    """
    if p[TURNS] > 0.0:
        s[LAGGED] = s[SLACK] = s[WHEEL] = wheel_for(p, turn - p[VEER] * p[WHEEL_SCALE] * speed)
        s[ANGLE] = steered(p, s[WHEEL])
        return
    v, behind = p[WHEEL_SCALE] * speed, 0.0
    if p[GRIP] > 0.0 or p[REAR_COMPLIANCE] > 0.0:
        angle = math.atan(p[WHEELBASE] * turn / v) + (p[FRONT_COMPLIANCE] + p[WHEELBASE] * p[UNDERSTEER]) * v * turn
        behind = p[RELAXATION] / v
    else:
        angle = math.atan(p[WHEELBASE] * turn * (1.0 + p[UNDERSTEER] * v * v) / v)
    wheel = wheel_for(p, angle)
    s[WHEEL] = toward(wheel, s[SLACK], p[STEERING_RATE] * behind)
    if s[WHEEL] == s[SLACK]:  # it had the time to be where its command has it
        wheel = s[WHEEL]
    s[ANGLE] = steered(p, wheel)


@njit(cache=True, nogil=True, error_model="numpy")
def beyond_model(p: Array, moments: Array, bent: float, forward: float, s: Array) -> float:
    """What the car showed beyond the model goes on as the model says: PUSH, TRIM, and the speed (m/s) that is returned."""
    push, faster = explained_speed(moments)
    at_once = (forward - s[SPEED]) / moments[0]
    s[PUSH] = p[PUSH_LASTS] * (at_once + p[SPEED_KEPT] * (push - at_once))
    s[TRIM] = p[TRIM_LASTS] * bent
    return forward + p[SPEED_KEPT] * (s[SPEED] + faster - forward)


@njit(cache=True, nogil=True, error_model="numpy")
def place(p: Array, pose: Array, s: Array) -> None:
    """The pose of the model where that of the tracked point is `pose` (x, y, heading, ...)."""
    s[HEADING] = pose[2] + p[POSE_TURN]
    ahead, aside, c, d = tracked_ahead(p), p[POSE_LEFT], math.cos(s[HEADING]), math.sin(s[HEADING])
    s[X] = pose[0] - ahead * c + aside * d
    s[Y] = pose[1] - ahead * d - aside * c


@njit(cache=True, nogil=True, error_model="numpy")
def forward_speed(p: Array, pose: Array) -> float:
    """The speed of the middle of the vehicle, a point of which goes as `pose` says: inside of curves that is slower."""
    return pose[3] + p[POSE_LEFT] * pose[4]


@njit(cache=True, nogil=True, error_model="numpy")
def more_bent(p: Array, turn: float, speed: float, s: Array) -> float:
    """By how much more than the model (rad; rad/s on two wheels) the car turns at `turn` (rad/s); nan for one that stands."""
    if p[TURNS] > 0.0:
        return turn - s[TURNING]
    if min(speed, s[SPEED]) > MOVES:
        return p[WHEELBASE] * (turn / speed - s[TURNING] / s[SPEED])
    return math.nan


@njit(cache=True, nogil=True, error_model="numpy")
def under_commands(
    p: Array, dt: float, commands: Array, seen: Array, first: int, settle: int, log_begin: Integers, shares: Array,
    s: Array,
) -> bool:  # fmt: skip
    """Motor and wheels at grid instant `first`, after `settle` steps of commands, or as many as slow wheels take from side to
    side. Where the log begins within these (log_begin (2,), see Past), wheels are where its first turn rate says; whether
    that is now is returned.
    """
    back = max(first - max(settle, math.ceil(2.0 / (p[STEERING_RATE] * dt))), 0)
    commanded, tracked, rested = log_begin
    unknown = back < commanded and not rested and (forward_speed(p, seen[tracked]) > MOVES or p[TURNS] > 0.0)
    s[LAGGED] = s[SLACK] = s[WHEEL] = beyond(commands[back, 1], p[STEERING_DEAD])
    for k in range(back, first):
        if unknown and k == tracked:
            as_it_turns(p, forward_speed(p, seen[k]), seen[k, 4], s)
        advance(p, dt, commands, k, shares, s)
    if unknown and first == tracked:
        as_it_turns(p, forward_speed(p, seen[first]), seen[first, 4], s)
    return unknown and first == tracked


@njit(cache=True, nogil=True, error_model="numpy")
def over_the_past(
    p: Array, dt: float, commands: Array, seen: Array, first: int, k0: int, compared: int, lag: int, older: bool,
    doubt: float, shares: Array, moments: Array, s: Array,
) -> tuple[float, float]:  # fmt: skip
    """The model from grid instant `first` to k0, beside the car from `compared` on: `moments` of their speeds (see
    `compare_speed`), by how much more the car turned (see `more_bent`), and for how long that was seen, in s.
    Of commands that may be `older` than the log the speed tells once it is seen, with a standard deviation `doubt` (m/s).
    """
    bent, seconds, share, ring, sums = 0.0, 0.0, share_of(LASTS / 3.0, dt), np.zeros(lag), np.zeros(2)
    for k in range(first, k0):
        advance(p, dt, commands, k, shares, s)
        speed = s[SPEED]
        step_chassis(p, dt, s)
        speed = as_tracked(k, 0.5 * (speed + s[SPEED]), ring, sums)
        if older and k + 1 == first + lag:  # told for longer, it was under way when the log began
            more = clearly(forward_speed(p, seen[k + 1]) - speed, doubt)
            s[SPEED], speed, ring, sums[0] = s[SPEED] + more, speed + more, ring + more, sums[0] + lag * more
            sums[1] += 0.5 * lag * (lag - 1.0) * more
        if k + 1 >= max(compared, first + lag):
            compare_speed(moments, dt, resistance(p, s), forward_speed(p, seen[k + 1]) - speed)
        if k + 1 >= compared:
            more = more_bent(p, seen[k + 1, 4], forward_speed(p, seen[k + 1]), s)
            if not math.isnan(more):
                bent += share * (more - bent)
                seconds += dt
    return bent, seconds


@njit(cache=True, nogil=True, error_model="numpy")
def begin(
    p: Array, dt: float, commands: Array, seen: Array, k0: int, past: int, settle: int, lag: int, log_begin: Integers,
    doubt: float, shares: Array, s: Array,
) -> None:  # fmt: skip
    """The state at grid instant k0 from what was commanded and seen until then.

    seen (G, 5) x, y, heading, forward speed of the tracked point (its standard deviation is `doubt`), yaw rate. The model is
    run over the last `past` steps: how much slower or faster the car was tells PUSH (and, as far as SPEED_KEPT says, the
    speed now: with less noise than the last samples, but later), and how much more it turned tells TRIM. `settle` steps of
    commands come before, or what the log holds of them (see `under_commands`). Where no past is seen, tyres that slip are
    where these commands have brought them from a steady curve.
    """
    first, turned = k0 - past, False
    rested = log_begin[2] > 0 and first <= log_begin[1]
    if rested:
        first, past = log_begin[0], k0 - log_begin[0]
    s[:] = 0.0
    slips = past == 0 and p[GRIP] == 0.0 and p[REAR_COMPLIANCE] > 0.0
    if slips:
        s[LAGGED] = s[SLACK] = s[WHEEL] = beyond(commands[max(first - settle, 0), 1], p[STEERING_DEAD])
        out_of_steady_curve(p, dt, commands, max(first - settle, 0), k0, shares, s)
    else:
        turned = under_commands(p, dt, commands, seen, first, settle, log_begin, shares, s)
    moments, forward = np.array([0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0]), forward_speed(p, seen[k0])
    if past > 0 and not turned:
        s[ANGLE] = steered(p, s[WHEEL])
    if past > 0 and not rested:
        s[SPEED], s[TURNING] = forward_speed(p, seen[first]), seen[first, 4]
    compared, older = log_begin[1] if rested else first, rested and log_begin[2] > 1
    bent, driven = over_the_past(p, dt, commands, seen, first, k0, compared, lag, older, doubt, shares, moments, s)
    # A car that stands shows nothing, nor does one whose speed takes longer to see than the past lasts (a fix a second).
    if driven > max(LASTS / 2.0, past * dt / 2.0) and moments[0] > 0.0:
        forward = beyond_model(p, moments, bent, forward, s)
    elif rested:
        forward += p[SPEED_KEPT] * (s[SPEED] - forward)
    if past == 0:
        s[SIDEWAYS] += p[WHEELBASE] * p[WEIGHT_IN_FRONT] * (seen[k0, 4] - s[TURNING]) if slips else 0.0
        s[TURNING], s[ANGLE] = seen[k0, 4], s[ANGLE] if turned else steered(p, s[WHEEL])
    s[SPEED] = ahead_or_back(p, forward) if p[DRIVE] > 0.0 else forward
    place(p, seen[k0], s)
