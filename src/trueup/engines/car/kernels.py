# SPDX-License-Identifier: Apache-2.0
"""Compiled loops of the car: servo with lag and play, sliding tyres, drive and losses; stretches begun from the past.

Single-track model with tyres whose force saturates (R. Rajamani, Vehicle Dynamics and Control, ch. 2, 13); the lateral
equations are solved implicitly, since they are stiff at low speed.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

(
    WHEELBASE, STEERING_DELAY, STEERING_LAG, STEERING_RATE, STEERING_PLAY, STEERING_LEFT, STEERING_RIGHT, STEERING_BEND,
    STEERING_OFFSET, RELAXATION, UNDERSTEER, GRIP, FRICTION_LIMIT, WEIGHT_IN_FRONT, YAW_INERTIA, THROTTLE_DELAY,
    THROTTLE_LAG, THROTTLE_DEAD, DRIVE, DRIVE_FADE, BRAKING, FRICTION, SPEED_LOSS, CURVE_LOSS, POSE_AHEAD,
    PUSH_LASTS, TRIM_LASTS, SPEED_KEPT, POSE_TURN,
) = range(29)  # fmt: skip
"""Columns of a row: the car, then QUANTITIES in their order."""

READ = 5
"""What is read off: x, y (m) and heading (rad) of the tracked point; speed (m/s); yaw rate (rad/s)."""
STATE = 12
SERVO, WHEEL, ANGLE, MOTOR, FORWARD, SIDEWAYS, TURNING, X, Y, HEADING, PUSH, TRIM = range(STATE)
"""Steering after lag, after play; wheel angle that the tyres have taken up (rad); throttle after lag; velocities of the
centre of mass (m/s, m/s, rad/s); its pose; and what the car showed beyond the model just before: an acceleration (m/s^2:
battery, slope, floor) and a wheel angle (rad: a servo that stopped short, play)."""

_MOST_TRIM = 0.1  # rad
_STIFFEST = 1e-3  # rad s^2/m
_SHORTEST = 1e-6  # m
_SLOW = 0.05  # m/s: below, tyres are treated as at this speed
_TRUST = 0.7  # share of the tracked heading's turn that the last seconds showed
_TRIM_SEEN, _TRIM_FADES = 0.4, 1.2  # s: an unexplained wheel angle is seen, and changes, within a second
_ONE_LOOK = 0.25  # s: speeds seen within this time come from the same samples
_FORGETS = 1.0  # s
_MOVES = 0.2  # m/s: slower, the direction of motion says nothing


@njit(cache=True, nogil=True, error_model="numpy")
def delayed(signal: Array, k: float) -> float:
    """A signal on the grid at a fraction of a step, held at both ends."""
    if k <= 0.0:
        return signal[0]
    i = int(k)
    if i + 1 >= len(signal):
        return signal[len(signal) - 1]
    return signal[i] + (k - i) * (signal[i + 1] - signal[i])


@njit(cache=True, nogil=True, error_model="numpy")
def secant(grip: float, limit: float, angle: float) -> float:
    """Force over slip angle of a tyre with limit * tanh(grip * angle / limit)."""
    x = abs(grip * angle / limit)
    return grip * math.tanh(x) / x if x > 1e-4 else grip


@njit(cache=True, nogil=True, error_model="numpy")
def step_actuators(p: Array, dt: float, throttle: float, steering: float, shares: Array, s: Array) -> None:
    """Servo and motor follow their delayed commands; the wheels follow the servo after its play."""
    most = dt * p[STEERING_RATE]
    s[SERVO] += min(max(shares[0] * (steering - s[SERVO]), -most), most)
    s[MOTOR] += shares[1] * (throttle - s[MOTOR])
    s[WHEEL] = min(max(s[WHEEL], s[SERVO] - p[STEERING_PLAY]), s[SERVO] + p[STEERING_PLAY])


@njit(cache=True, nogil=True, error_model="numpy")
def steered(p: Array, wheel: float) -> float:
    """Wheel angle in rad for a command after lag and play."""
    command = wheel + p[STEERING_OFFSET]
    angle = (p[STEERING_LEFT] if command > 0.0 else p[STEERING_RIGHT]) * command
    return angle * (1.0 - p[STEERING_BEND] * command * command)


@njit(cache=True, nogil=True, error_model="numpy")
def motor_push(p: Array, throttle: float, speed: float) -> float:
    """Acceleration by the motor: none within the dead zone; forward less, the faster it turns (its own voltage)."""
    if throttle > p[THROTTLE_DEAD]:
        return p[DRIVE] * (throttle - p[THROTTLE_DEAD]) * max(1.0 - p[DRIVE_FADE] * speed, 0.0)
    return p[DRIVE] * p[BRAKING] * min(throttle + p[THROTTLE_DEAD], 0.0)


@njit(cache=True, nogil=True, error_model="numpy")
def resistance(p: Array, s: Array) -> float:
    """Deceleration for each m/s that the car is faster, in 1/s: losses, and the motor's own voltage."""
    curvature = s[TURNING] / max(s[FORWARD], _SLOW)
    fade = p[DRIVE] * p[DRIVE_FADE] * max(s[MOTOR] - p[THROTTLE_DEAD], 0.0)
    return p[SPEED_LOSS] + p[CURVE_LOSS] * curvature * curvature + fade


@njit(cache=True, nogil=True, error_model="numpy")
def step_car(p: Array, dt: float, s: Array) -> None:
    """Velocities and pose one step on, with the wheels and the motor where they are."""
    # Side forces grow with the way rolled, not with time (relaxation length: H. B. Pacejka, Tire and Vehicle Dynamics).
    way = dt * max(s[FORWARD], _SLOW)
    taken_up = (1.0 - math.exp(-way / max(p[RELAXATION], _SHORTEST))) * (steered(p, s[WHEEL]) - s[ANGLE])
    angle = s[ANGLE] + 0.5 * taken_up + s[TRIM]
    s[ANGLE] += taken_up
    s[TRIM] *= 1.0 - dt / _TRIM_FADES
    front = p[WHEELBASE] * (1.0 - p[WEIGHT_IN_FRONT])  # centre of mass to axles
    rear = p[WHEELBASE] * p[WEIGHT_IN_FRONT]
    inertia = p[YAW_INERTIA] * front * rear
    speed, u, r = max(s[FORWARD], _SLOW), s[SIDEWAYS], s[TURNING]
    share = p[WEIGHT_IN_FRONT]
    # Understeer, 1 / front grip - 1 / rear grip, is seen long before the grips are.
    front_grip = 1.0 / max(1.0 / p[GRIP] + p[UNDERSTEER], _STIFFEST)
    cf = secant(front_grip * share, p[FRICTION_LIMIT] * share, angle - math.atan((u + front * r) / speed))
    cr = secant(p[GRIP] * (1.0 - share), p[FRICTION_LIMIT] * (1.0 - share), -math.atan((u - rear * r) / speed))
    # Implicit in u and r: u' = cf a_f + cr a_r - v r, J r' = front cf a_f - rear cr a_r, with the tyres' secants held.
    turn = (front * cf - rear * cr) / speed
    a11, a12 = 1.0 + dt * (cf + cr) / speed, dt * (turn + speed)
    a21, a22 = dt * turn / inertia, 1.0 + dt * (front * front * cf + rear * rear * cr) / (speed * inertia)
    b1, b2 = u + dt * cf * angle, r + dt * front * cf * angle / inertia
    determinant = a11 * a22 - a12 * a21
    s[SIDEWAYS], s[TURNING] = (b1 * a22 - a12 * b2) / determinant, (a11 * b2 - a21 * b1) / determinant
    middle_u, middle_r = 0.5 * (u + s[SIDEWAYS]), 0.5 * (r + s[TURNING])
    slip = angle - (s[SIDEWAYS] + front * s[TURNING]) / speed
    curvature = s[TURNING] / speed
    pull = (
        motor_push(p, s[MOTOR], s[FORWARD])
        - p[FRICTION]
        - (p[SPEED_LOSS] + p[CURVE_LOSS] * curvature * curvature) * s[FORWARD]
    )
    pull += s[PUSH] - cf * slip * math.sin(angle) + s[TURNING] * s[SIDEWAYS]
    s[FORWARD] = max(s[FORWARD] + dt * pull, 0.0)
    middle = s[HEADING] + 0.5 * dt * middle_r
    s[X] += dt * (s[FORWARD] * math.cos(middle) - middle_u * math.sin(middle))
    s[Y] += dt * (s[FORWARD] * math.sin(middle) + middle_u * math.cos(middle))
    s[HEADING] += dt * middle_r


@njit(cache=True, nogil=True, error_model="numpy")
def compare_speed(m: Array, dt: float, slows: float, faster: float) -> None:
    """One more instant of weighted least squares for a steady push and an error of the speed at the start of the past.

    m (7,): speed by now for a push of one (s), share that is left of a speed at the start, moments of these two, and of
    them with `faster` (m/s), by how much the car is faster than the model. What was long ago is forgotten.
    """
    m[0] += dt * (1.0 - m[0] * slows)
    m[1] -= dt * m[1] * slows
    share = dt / _ONE_LOOK
    m[2:] *= math.exp(-dt / _FORGETS)
    m[2] += share * m[0] * m[0]
    m[3] += share * m[0] * m[1]
    m[4] += share * m[1] * m[1]
    m[5] += share * m[0] * faster
    m[6] += share * m[1] * faster


@njit(cache=True, nogil=True, error_model="numpy")
def explained_speed(m: Array) -> tuple[float, float]:
    """The push (m/s^2) that the moments of `compare_speed` tell, and by how much (m/s) the car is faster by now."""
    determinant = max(m[2] * m[4] - m[3] * m[3], 1e-12)
    push = (m[5] * m[4] - m[6] * m[3]) / determinant
    return push, push * m[0] + (m[2] * m[6] - m[3] * m[5]) / determinant * m[1]


@njit(cache=True, nogil=True, error_model="numpy")
def begin(
    p: Array, dt: float, commands: Array, seen: Array, k0: int, past: int, settle: int, shares: Array, s: Array
) -> float:
    """The state at grid instant k0 from what was commanded and seen until then; returns the heading's misalignment.

    commands (G, 2) throttle, steering; seen (G, 6) x, y, heading, forward and sideways speed of the tracked point, yaw
    rate. The model is run over the last `past` steps: how much slower or faster the car was tells PUSH (and, as far as
    SPEED_KEPT says, the speed now: with less noise than the last samples, but later), and in which direction it went
    beside its heading tells how the tracked heading is turned. `settle` steps of commands come before. The function is
    longer than others because it is one pass over the past.
    """
    first = k0 - past
    s[:] = 0.0
    s[SERVO] = s[WHEEL] = delayed(commands[:, 1], first - settle - p[STEERING_DELAY] / dt)
    s[MOTOR] = delayed(commands[:, 0], first - settle - p[THROTTLE_DELAY] / dt)
    drift, bent, counted, share = 0.0, 0.0, 0, 1.0 - math.exp(-dt / _TRIM_SEEN)
    moments, forward = np.zeros(7), seen[k0, 3]
    moments[1] = moments[4] = 1.0
    for k in range(first - settle, k0):
        step_actuators(p, dt, delayed(commands[:, 0], k - p[THROTTLE_DELAY] / dt),
                       delayed(commands[:, 1], k - p[STEERING_DELAY] / dt), shares, s)  # fmt: skip
        if k < first:
            continue
        if k == first:
            s[FORWARD], s[TURNING] = max(seen[k, 3], 0.0), seen[k, 5]
            s[SIDEWAYS] = seen[k, 4] - p[POSE_AHEAD] * s[TURNING]
            s[ANGLE] = steered(p, s[WHEEL])
        step_car(p, dt, s)
        compare_speed(moments, dt, resistance(p, s), seen[k + 1, 3] - s[FORWARD])
        if seen[k, 3] > _MOVES:
            curvature = seen[k + 1, 5] / max(seen[k + 1, 3], _MOVES) - s[TURNING] / max(s[FORWARD], _MOVES)
            bent += share * (p[WHEELBASE] * curvature - bent)
            drift += (seen[k, 4] - s[SIDEWAYS] - p[POSE_AHEAD] * s[TURNING]) / seen[k, 3]
            counted += 1
    turned = p[POSE_TURN]
    if past * dt > 0.5 and counted > past // 2:
        turned += _TRUST * (drift / counted - p[POSE_TURN])
        push, faster = explained_speed(moments)
        at_once = (forward - s[FORWARD]) / max(moments[0], 0.1)
        s[PUSH] = p[PUSH_LASTS] * (at_once + p[SPEED_KEPT] * (push - at_once))
        forward += p[SPEED_KEPT] * (s[FORWARD] + faster - forward)
        s[TRIM] = min(max(p[TRIM_LASTS] * bent, -_MOST_TRIM), _MOST_TRIM)
    if past == 0:
        s[TURNING] = seen[k0, 5]
        s[ANGLE] = steered(p, s[WHEEL])
        s[SIDEWAYS] = seen[k0, 4] - p[POSE_AHEAD] * s[TURNING]
    s[FORWARD] = max(forward, 0.0)
    s[HEADING] = seen[k0, 2] + turned
    s[X] = seen[k0, 0] - p[POSE_AHEAD] * math.cos(s[HEADING])
    s[Y] = seen[k0, 1] - p[POSE_AHEAD] * math.sin(s[HEADING])
    return turned


@njit(cache=True, nogil=True, error_model="numpy")
def read(p: Array, turned: float, s: Array, out: Array) -> None:
    """What is measured in a state: out (READ,)."""
    out[0] = s[X] + p[POSE_AHEAD] * math.cos(s[HEADING])
    out[1] = s[Y] + p[POSE_AHEAD] * math.sin(s[HEADING])
    out[2] = s[HEADING] - turned
    out[3], out[4] = s[FORWARD], s[TURNING]


@njit(cache=True, nogil=True, error_model="numpy")
def predict_rows(
    rows: Array, dt: float, commands: Array, seen: Array, starts: Indices, pasts: Indices, settle: int, first: Indices,
    times: Array, out: Array,
) -> None:  # fmt: skip
    """Stretches for all rows (b, n): stretch j begins at grid instant starts[j] and is read at times[first[j]:first[j+1]].

    commands (G, 2), seen (G, 6) on the grid; pasts (S,) how many steps of the past are known; times since the start of
    their stretch, ascending; out (b, len(times), READ). Commands count at any time, what was seen only until the start.
    """
    s, shares, here, before = np.empty(STATE), np.empty(2), np.empty(READ), np.empty(READ)
    for i in range(rows.shape[0]):
        p = rows[i]
        shares[0] = 1.0 - math.exp(-dt / p[STEERING_LAG]) if p[STEERING_LAG] > 1e-6 else 1.0
        shares[1] = 1.0 - math.exp(-dt / p[THROTTLE_LAG]) if p[THROTTLE_LAG] > 1e-6 else 1.0
        for j in range(len(starts)):
            turned = begin(p, dt, commands, seen, starts[j], pasts[j], settle, shares, s)
            read(p, turned, s, here)
            before[:] = here
            k = 0
            for n in range(first[j], first[j + 1]):
                while times[n] > k * dt + 1e-9:
                    before[:] = here
                    step_actuators(p, dt, delayed(commands[:, 0], starts[j] + k - p[THROTTLE_DELAY] / dt),
                                   delayed(commands[:, 1], starts[j] + k - p[STEERING_DELAY] / dt), shares, s)  # fmt: skip
                    step_car(p, dt, s)
                    read(p, turned, s, here)
                    k += 1
                part = 1.0 - (k - times[n] / dt)
                for c in range(READ):
                    out[i, n, c] = before[c] + part * (here[c] - before[c]) if k > 0 else here[c]
