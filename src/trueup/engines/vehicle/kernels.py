# SPDX-License-Identifier: Apache-2.0
"""One compiled step of a vehicle: steering, drive, and a chassis that rolls where it points or on tyres that slide.

The chassis on tyres is a single-track model whose tyre forces saturate (R. Rajamani, Vehicle Dynamics and Control, ch. 2,
13); its lateral equations are solved implicitly, since they are stiff at low speed.
"""

from __future__ import annotations

import math

from trueup.arrays import Array
from trueup.compiled import njit
from trueup.evidence import STANDARD_ERRORS
from trueup.rounding import ROUNDED

COLUMNS = (
    "wheelbase", "max_steering", "drive_delay", "drive_lag", "steering_delay", "steering_lag", "steering_rate_limit",
    "steering_slack", "command_offset", "steering_left", "steering_right", "steering_falloff", "steering_scale",
    "angle_offset", "acceleration_limit", "wheel_scale", "throttle_dead", "drive", "drive_fade", "braking", "friction",
    "speed_loss", "curve_loss", "understeer", "yaw_rate_limit", "yaw_acceleration_limit", "relaxation", "grip",
    "front_compliance", "friction_limit", "weight_in_front", "yaw_inertia", "pose_ahead", "pose_turn", "push_lasts",
    "trim_lasts", "speed_kept", "position_noise", "heading_noise", "localisation_latency", "speed_gain", "braking_limit",
    "turns", "rear_compliance", "slip_relaxation", "veer", "pose_left", "pose_at", "steering_dead",
)  # fmt: skip
"""The numbers of one vehicle, in the order in which a row (n,) holds them. Without `drive` its commands are speeds, which its
wheels have at once; with `speed_gain` they are speeds that a controller of the vehicle pursues, `drive` (m/s) for a command
of one. With `turns` its steering is a turn rate, as two driven wheels make it; without `grip` or `rear_compliance` (its
reciprocal) its wheels roll where they point. What else is absent is written as its table says."""
(
    WHEELBASE, MAX_STEERING, DRIVE_DELAY, DRIVE_LAG, STEERING_DELAY, STEERING_LAG, STEERING_RATE,
    STEERING_SLACK, COMMAND_OFFSET, STEERING_LEFT, STEERING_RIGHT, STEERING_FALLOFF, STEERING_SCALE,
    ANGLE_OFFSET, ACCELERATION_LIMIT, WHEEL_SCALE, THROTTLE_DEAD, DRIVE, DRIVE_FADE, BRAKING, FRICTION,
    SPEED_LOSS, CURVE_LOSS, UNDERSTEER, YAW_RATE_LIMIT, YAW_ACCELERATION_LIMIT, RELAXATION, GRIP,
    FRONT_COMPLIANCE, FRICTION_LIMIT, WEIGHT_IN_FRONT, YAW_INERTIA, POSE_AHEAD, POSE_TURN, PUSH_LASTS,
    TRIM_LASTS, SPEED_KEPT, POSITION_NOISE, HEADING_NOISE, LATENCY, SPEED_GAIN, BRAKING_LIMIT,
    TURNS, REAR_COMPLIANCE, SLIP_RELAXATION, VEER, POSE_LEFT, POSE_AT, STEERING_DEAD,
) = range(49)  # fmt: skip

(
    X, Y, HEADING, SPEED, TURNING, SIDEWAYS, LAGGED, SLACK, WHEEL, ANGLE, MOTOR, PUSH, TRIM, FRONT_SLIP, REAR_SLIP,
    STATE,
) = range(16)  # fmt: skip
"""Where the numbers of a state stand, and how many they are. Pose of the rear axle, or by throttle on tyres of the centre of
mass; speed of the wheels and sideways (m/s), yaw rate (rad/s); steering after lag, slack and rate limit; wheel angle that the
tyres have taken up (rad); throttle after lag; and what the vehicle showed beyond the model just before: an acceleration
(m/s^2: battery, slope) and a wheel angle (rad); slip angles as the tyres have taken them up (rad)."""

SLOW = 0.05
"""In m/s: tyres are treated as rolling at least so fast, since slip angles have no meaning at rest."""
_STIFFEST = 1e-3  # rad s^2/m: an understeer that is more negative than the rear grip allows ends here
SWINGS = 1e-2
"""In s: longest step of a vehicle that swings on tyres which take up slip with the way rolled, about once a second: longer
implicit steps would calm it. Chosen where finer ones change nothing that drives show."""
LASTS = 1.2
"""In s: what a car shows beyond its model (slope, battery, play) changes within about a second; chosen on JetRacer."""


@njit(cache=True, nogil=True, error_model="numpy")
def toward(value: float, wanted: float, most: float) -> float:
    """`wanted`, or as far toward it as `most` allows."""
    return value + min(max(wanted - value, -most), most)


@njit(cache=True, nogil=True, error_model="numpy")
def share_of(lag: float, dt: float) -> float:
    """How much of a step toward its goal a first-order lag makes in dt."""
    return 1.0 - math.exp(-dt / lag) if lag > ROUNDED else 1.0


@njit(cache=True, nogil=True, error_model="numpy")
def beyond(command: float, dead: float) -> float:
    """What of a command moves a wheel, or turns it: nothing within its dead zone, beyond it what is more."""
    return command - min(max(command, -dead), dead)


@njit(cache=True, nogil=True, error_model="numpy")
def step_actuators(p: Array, dt: float, drive: float, steering: float, shares: Array, s: Array) -> None:
    """Motor and steering follow their delayed commands; `shares` (2,) are `share_of` their lags."""
    if p[TURNS] > 0.0 and p[THROTTLE_DEAD] > 0.0:
        left, right = beyond(drive - 0.5 * steering, p[THROTTLE_DEAD]), beyond(drive + 0.5 * steering, p[THROTTLE_DEAD])
        drive, steering = 0.5 * (left + right), right - left
    if p[DRIVE] > 0.0:
        s[MOTOR] += shares[0] * (drive - s[MOTOR])
    else:
        s[SPEED] = toward(s[SPEED], s[SPEED] + shares[0] * (drive - s[SPEED]), p[ACCELERATION_LIMIT] * dt)
    steering = min(max(beyond(steering, p[STEERING_DEAD]), -p[MAX_STEERING]), p[MAX_STEERING])
    s[LAGGED] += shares[1] * (steering - s[LAGGED])
    gap = 0.5 * p[STEERING_SLACK]
    s[SLACK] = min(max(s[SLACK], s[LAGGED] - gap), s[LAGGED] + gap)
    s[WHEEL] = toward(s[WHEEL], s[SLACK], p[STEERING_RATE] * dt)


@njit(cache=True, nogil=True, error_model="numpy")
def steered(p: Array, wheel: float) -> float:
    """Wheel angle in rad for a command after lag, slack and rate limit."""
    command = wheel + p[COMMAND_OFFSET]
    angle = (p[STEERING_LEFT] if command > 0.0 else p[STEERING_RIGHT]) * command
    return p[STEERING_SCALE] * angle * (1.0 - p[STEERING_FALLOFF] * command * command) + p[ANGLE_OFFSET]


@njit(cache=True, nogil=True, error_model="numpy")
def step_chassis(p: Array, dt: float, s: Array) -> None:
    """Velocities and pose one step on, with the wheels and the motor where they are."""
    if p[TURNS] > 0.0:
        spinning(p, dt, s)
    elif p[GRIP] > 0.0 or p[REAR_COMPLIANCE] > 0.0:
        parts = math.ceil(dt / SWINGS - ROUNDED)
        for _ in range(parts):
            on_tyres(p, dt / parts, s)
    else:
        rolling(p, dt, s)


@njit(cache=True, nogil=True, error_model="numpy")
def rolling(p: Array, dt: float, s: Array) -> None:
    """Wheels that do not slip: omega* = v tan(delta) / (L (1 + K v^2)), its clamp (beta_4), its rate limit (beta_5), pose.

    The pose moves on a circle, exactly, while speed and yaw rate last a step.
    """
    speed, turned = s[SPEED], s[TURNING]
    s[ANGLE] = steered(p, s[WHEEL])
    if p[DRIVE] > 0.0:
        s[SPEED] = ahead_or_back(p, s[SPEED] + dt * pull(p, s))
    v = p[WHEEL_SCALE] * s[SPEED]
    turn = v * math.tan(s[ANGLE]) / (p[WHEELBASE] * (1.0 + p[UNDERSTEER] * v * v))
    wanted = min(max(turn, -p[YAW_RATE_LIMIT]), p[YAW_RATE_LIMIT])
    s[TURNING] = toward(s[TURNING], wanted, p[YAW_ACCELERATION_LIMIT] * dt)
    if p[DRIVE] > 0.0:
        v, turn = p[WHEEL_SCALE] * 0.5 * (speed + s[SPEED]), 0.5 * (turned + s[TURNING])
    else:
        turn = s[TURNING]
    along_circle(v, turn, dt, s)


@njit(cache=True, nogil=True, error_model="numpy")
def spinning(p: Array, dt: float, s: Array) -> None:
    """Two driven wheels: the turn rate is what the commanded one has become, at any speed, also at rest or backwards; wheels
    of which one is larger turn it with the way driven besides.
    """
    speed, turn = s[SPEED], s[TURNING]
    s[ANGLE] = steered(p, s[WHEEL])
    s[TURNING] = s[ANGLE] + p[VEER] * p[WHEEL_SCALE] * s[SPEED] + s[TRIM]
    s[TRIM] *= 1.0 - dt / LASTS
    s[SPEED] += dt * (pull(p, s) + s[PUSH])
    along_circle(p[WHEEL_SCALE] * 0.5 * (speed + s[SPEED]), 0.5 * (turn + s[TURNING]), dt, s)


@njit(cache=True, nogil=True, error_model="numpy")
def along_circle(v: float, turn: float, dt: float, s: Array) -> None:
    """The pose one step on at speed v (m/s) and turn rate (rad/s)."""
    half = 0.5 * turn * dt
    chord = v * dt * (1.0 - half * half / 6.0 if abs(half) < 1e-4 else math.sin(half) / half)
    s[X] += chord * math.cos(s[HEADING] + half)
    s[Y] += chord * math.sin(s[HEADING] + half)
    s[HEADING] += turn * dt


@njit(cache=True, nogil=True, error_model="numpy")
def tyres(p: Array) -> tuple[float, float, float, float]:
    """Cornering stiffness over mass of both axles (m/s^2 per rad), and how far they are from the centre of mass (m)."""
    share = p[WEIGHT_IN_FRONT]
    behind = 1.0 / p[GRIP] if p[GRIP] > 0.0 else p[REAR_COMPLIANCE]
    # Understeer, 1 / front grip - 1 / rear grip, is seen long before the grips are.
    ahead = max(behind + p[FRONT_COMPLIANCE] + p[WHEELBASE] * p[UNDERSTEER], _STIFFEST)
    return share / ahead, (1.0 - share) / behind, p[WHEELBASE] * (1.0 - share), p[WHEELBASE] * share


@njit(cache=True, nogil=True, error_model="numpy")
def within(z: float) -> float:
    """At which share of a step its slope has to be taken for exp(-z) of a decaying value to be left: from the middle where
    tyres are soft to the end where they are stiff (exponential fitting: W. Liniger, R. A. Willoughby, SIAM J. Numer. Anal.
    7(1), 1970).
    """
    return 0.5 + z / 12.0 if z < 1e-2 else 1.0 / -math.expm1(-z) - 1.0 / z


@njit(cache=True, nogil=True, error_model="numpy")
def on_tyres(p: Array, dt: float, s: Array) -> None:
    """Tyres that take up a new wheel angle, or any slip, with the way rolled, and slide where their force ends."""
    # Side forces grow with the way rolled, not time (relaxation length: H. B. Pacejka, Tire and Vehicle Dynamics, ch. 1).
    v, u, r = p[WHEEL_SCALE] * s[SPEED], s[SIDEWAYS], s[TURNING]
    speed = max(abs(v), SLOW)
    taken_up = share_of(p[RELAXATION], dt * speed) * (steered(p, s[WHEEL]) - s[ANGLE])
    angle = s[ANGLE] + 0.5 * taken_up + s[TRIM]
    s[ANGLE], s[TRIM] = s[ANGLE] + taken_up, s[TRIM] * (1.0 - dt / LASTS)
    front_grip, rear_grip, front, rear = tyres(p)
    share, inertia = p[WEIGHT_IN_FRONT], p[YAW_INERTIA] * front * rear
    aside = (u + front * r) / speed
    straight, bend = math.atan(aside), 1.0 / (1.0 + aside * aside)
    angle *= min(max(v / SLOW, -1.0), 1.0)  # at rest wheels turn nothing
    w = share_of(p[SLIP_RELAXATION], dt * speed)
    f, b = (1.0 - w) * s[FRONT_SLIP], (1.0 - w) * s[REAR_SLIP]
    cf = math.cos(angle) * secant(front_grip, p[FRICTION_LIMIT] * share, f + w * (angle - straight))
    cr = secant(rear_grip, p[FRICTION_LIMIT] * (1.0 - share), b - w * math.atan((u - rear * r) / speed))
    f += w * (angle - straight + bend * aside)
    # With the tyres' secants held: u' = cf a_f + cr a_r - v r, J r' = front cf a_f - rear cr a_r, with slips
    # a_f = f - w bend (u + front r) / speed, a_r = b - w (u - rear r) / speed. Implicit in u and r (see `within`).
    wf, wr = w * bend * cf / speed, w * cr / speed
    part = within(dt * max(wf + wr, (front * front * wf + rear * rear * wr) / inertia))
    h = part * dt
    turn = front * wf - rear * wr
    a11, a12 = 1.0 + h * (wf + wr), h * (turn + v)
    a21, a22 = h * turn / inertia, 1.0 + h * (front * front * wf + rear * rear * wr) / inertia
    b1, b2 = u + h * (cf * f + cr * b), r + h * (front * cf * f - rear * cr * b) / inertia
    determinant = a11 * a22 - a12 * a21
    then_u, then_r = (b1 * a22 - a12 * b2) / determinant, (a11 * b2 - a21 * b1) / determinant
    drag = cf * (f - w * bend * (then_u + front * then_r) / speed) * math.tan(angle) - then_r * then_u
    s[SIDEWAYS], s[TURNING] = u + (then_u - u) / part, r + (then_r - r) / part
    s[FRONT_SLIP] = f - w * bend * (s[SIDEWAYS] + front * s[TURNING]) / speed
    s[REAR_SLIP] = b - w * (s[SIDEWAYS] - rear * s[TURNING]) / speed
    if p[DRIVE] > 0.0:
        s[SPEED] = ahead_or_back(p, s[SPEED] + dt * (pull(p, s) + s[PUSH] - drag))
        v, rear = 0.5 * (v + p[WHEEL_SCALE] * s[SPEED]), 0.0
    middle_r = 0.5 * (r + s[TURNING])
    middle, sideways = s[HEADING] + 0.5 * dt * middle_r, 0.5 * (u + s[SIDEWAYS]) - rear * middle_r
    s[X] += dt * (v * math.cos(middle) - sideways * math.sin(middle))
    s[Y] += dt * (v * math.sin(middle) + sideways * math.cos(middle))
    s[HEADING] += dt * middle_r


@njit(cache=True, nogil=True, error_model="numpy")
def tracked_ahead(p: Array) -> float:
    """How far (m) the tracked point lies before the one whose pose a state holds."""
    on_tyres = p[DRIVE] > 0.0 and not p[TURNS] > 0.0
    return p[POSE_AHEAD] + (p[WHEELBASE] * (p[POSE_AT] - p[WEIGHT_IN_FRONT]) if on_tyres else 0.0)


@njit(cache=True, nogil=True, error_model="numpy")
def in_steady_curve(p: Array, s: Array) -> None:
    """The state of tyres that have long rolled at this speed and wheel angle."""
    front_grip, rear_grip, front, rear = tyres(p)
    v, angle, share = p[WHEEL_SCALE] * s[SPEED], steered(p, s[WHEEL]), p[WEIGHT_IN_FRONT]
    ahead, behind = share / front_grip, (1.0 - share) / rear_grip
    s[ANGLE], s[TURNING] = angle, v * math.tan(angle) / (front + rear + (ahead - behind) * v * v)
    s[FRONT_SLIP], s[REAR_SLIP] = ahead * v * s[TURNING], behind * v * s[TURNING]
    s[SIDEWAYS] = rear * s[TURNING] - v * s[REAR_SLIP]


@njit(cache=True, nogil=True, error_model="numpy")
def secant(grip: float, limit: float, angle: float) -> float:
    """Force over slip angle of a tyre with limit * tanh(grip * angle / limit)."""
    x = abs(grip * angle / limit)
    return grip * math.tanh(x) / x if x > 1e-2 else grip * (1.0 - x * x / 3.0)


@njit(cache=True, nogil=True, error_model="numpy")
def motor_push(p: Array, throttle: float, speed: float) -> float:
    """Acceleration by the motor: none within the dead zone; forward less, the faster it turns (its own voltage)."""
    if throttle > p[THROTTLE_DEAD]:
        return p[DRIVE] * (throttle - p[THROTTLE_DEAD]) * max(1.0 - p[DRIVE_FADE] * speed, 0.0)
    return p[DRIVE] * p[BRAKING] * min(throttle + p[THROTTLE_DEAD], 0.0)


@njit(cache=True, nogil=True, error_model="numpy")
def pull(p: Array, s: Array) -> float:
    """Acceleration by motor and losses along the vehicle, in m/s^2."""
    curvature = s[TURNING] / max(abs(s[SPEED]), SLOW)
    if p[SPEED_GAIN] > 0.0:
        wanted = p[SPEED_GAIN] * (p[DRIVE] * s[MOTOR] - s[SPEED])
        return (
            min(max(wanted, -p[BRAKING_LIMIT]), p[ACCELERATION_LIMIT])
            - p[CURVE_LOSS] * curvature * curvature * s[SPEED]
        )
    losses = p[FRICTION] + (p[SPEED_LOSS] + p[CURVE_LOSS] * curvature * curvature) * s[SPEED]
    return motor_push(p, s[MOTOR], s[SPEED]) - losses


@njit(cache=True, nogil=True, error_model="numpy")
def clearly(size: float, doubt: float) -> float:
    """A measured size, nothing where noise explains it, all of it where it is large (the non-negative garrote: L. Breiman,
    Technometrics 37(4), 1995).
    """
    return size * max(1.0 - (STANDARD_ERRORS * doubt) ** 2 / (size * size), 0.0) if size != 0.0 else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def ahead_or_back(p: Array, speed: float) -> float:
    """A speed that the vehicle may have: a throttle below zero brakes, a commanded speed below zero drives backwards."""
    return speed if p[SPEED_GAIN] > 0.0 else max(speed, 0.0)


@njit(cache=True, nogil=True, error_model="numpy")
def resistance(p: Array, s: Array) -> float:
    """Deceleration for each m/s that the vehicle is faster, in 1/s: losses, and the motor's own voltage."""
    curvature = s[TURNING] / max(abs(s[SPEED]), SLOW)
    if p[SPEED_GAIN] > 0.0:
        wanted = p[SPEED_GAIN] * (p[DRIVE] * s[MOTOR] - s[SPEED])
        free = -p[BRAKING_LIMIT] < wanted < p[ACCELERATION_LIMIT]
        return p[CURVE_LOSS] * curvature * curvature + (p[SPEED_GAIN] if free else 0.0)
    fade = p[DRIVE] * p[DRIVE_FADE] * max(s[MOTOR] - p[THROTTLE_DEAD], 0.0)
    return p[SPEED_LOSS] + p[CURVE_LOSS] * curvature * curvature + fade
