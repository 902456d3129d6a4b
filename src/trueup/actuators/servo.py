# SPDX-License-Identifier: Apache-2.0
"""The law of a position servo: firmware, DC motor, gears. Needs nothing but Python, so that it can be used anywhere.

    servo = Servo(LAW)
    servo.reset(position)
    while True:  # before each step of a simulation of `step` seconds
        servo.step(command, position, speed, step, external)
        # servo.torque to the joint; servo.damping and servo.friction are the joint's viscous and largest dry friction

It knows no engine. The joint must have the armature LAW.armature, and dry friction that may hold it up to `friction`.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple


class Law(NamedTuple):
    """A servo in numbers; all at the joint, SI units."""

    stiffness: float
    """N m/rad, of the firmware's proportional gain and the motor together."""
    armature: float = 0.0
    """kg m2, of the rotor through the gears."""
    back_emf: float = 0.0
    """N m s/rad by which the motor, while it is on, pushes less the faster it turns: k_t^2 / R."""
    coulomb: float = 0.0
    """N m."""
    viscous: float = 0.0
    """N m s/rad, also while the motor is off."""
    quadratic: float = 0.0
    """N m s2/rad2."""
    static: float = 0.0
    """N m by which friction is larger at rest."""
    stribeck_speed: float = 0.05
    """rad/s at which that has faded to 1/e."""
    load_motor: float = 0.0
    load_external: float = 0.0
    """Shares of the motor's and of the load's torque whose difference adds to friction: what presses the teeth together."""
    load_static: float = 0.0
    """By how much of itself that is larger at rest."""
    voltage_limit: float = math.inf
    """N m that full duty gives at rest: the motor's voltage ends there."""
    force_limit: float = math.inf
    """N m that the motor's current is limited to, at any speed."""
    sag: float = 0.0
    """By how much of it the supply breaks down at full duty and stall: its resistance over the motor's."""
    dead_band: float = 0.0
    """rad, end to end, in which the firmware sees no error."""
    punch: float = 0.0
    """N m that it gives at least once it sees one."""
    derivative: float = 0.0
    """N m s/rad, on the change of the error."""
    rate_gain: float = 0.0
    """N m s/rad, of firmware that damps the speed by a ratio: it follows the square root of the proportional setting."""
    integral: float = 0.0
    """N m/(rad s), on the error summed up, which never exceeds full duty."""
    zero: float = 0.0
    """rad, by how much its sensor reads too little."""
    delay: float = 0.0
    """s until a command acts."""
    speed_limit: float = math.inf
    """rad/s, of the set point that follows the command (profile velocity)."""
    acceleration_limit: float = math.inf
    """rad/s2 (profile acceleration)."""


REMEMBERED = ("place", "pace", "sum of errors", "last error", "begun", "load", "load told")
"""The numbers that a servo remembers, in the order of its state: place and pace of its set point, sum of errors, last error,
whether it has begun; the load's torque that it was told last, and whether it was told one."""


def set_point(command: float, place: float, pace: float, top: float, most: float, step: float) -> tuple[float, float]:
    """Place and pace one step on of a set point that follows a command within a limit of speed, and `most` change of it."""
    left = command - place
    if math.isinf(most):
        pace = min(max(left / step, -top), top)
    else:
        # The speed from which it can still stop there, a step ahead: sqrt(2 a d) made for steps.
        brake = most * (math.sqrt(0.25 + 2.0 * abs(left) / (most * step)) - 0.5)
        wanted = math.copysign(min(brake, top), left)
        pace += min(max(wanted - pace, -most), most)
        if abs(left) <= most * step and abs(pace) <= 1.001 * most:
            pace = left / step
    return place + pace * step, pace


def demand(law: Law, factor: float, state: list[float], command: float, position: float, step: float) -> float:
    """N m that the firmware asks of the motor at rest; `factor` is its gain over the one that the law stands for.

    The dead band is the compliance margin and the punch the least power of Dynamixel AX servos (J. Tan et al.,
    Simulation-based design of dynamic controllers for humanoid balancing, IROS 2016, Figure 8). `state` is changed.
    """
    if state[4] == 0.0:
        state[0], state[1], state[2] = position, 0.0, 0.0
    if math.isinf(law.speed_limit) and math.isinf(law.acceleration_limit):
        state[0] = command
    else:
        state[0], state[1] = set_point(
            command, state[0], state[1], law.speed_limit, law.acceleration_limit * step, step
        )
    error = state[0] - position - law.zero
    change = (error - state[3]) / step if state[4] > 0.0 else 0.0
    state[3], state[4] = error, 1.0
    seen = max(abs(error) - 0.5 * law.dead_band, 0.0)
    pull = math.copysign(factor * law.stiffness * seen + (law.punch if seen > 0.0 else 0.0), error)
    pull += law.derivative * change
    if law.integral > 0.0:
        most = law.voltage_limit if law.voltage_limit < math.inf else 1e9
        state[2] = min(max(state[2] + law.integral * math.copysign(seen, error) * step, -most), most)
        pull += state[2]
    return min(max(pull, -law.voltage_limit), law.voltage_limit)


def drive(
    law: Law, factor: float, on: bool, state: list[float], command: float, position: float, speed: float,
    external: float, step: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Torque in N m at the joint, damping in N m s/rad, and largest dry friction in N m.

    Of what grows with speed half is in the torque, at the speed before the step, and half is the damping, at the speed after
    it: so errors shrink with the square of the step (J. Crank and P. Nicolson, Proc. Cambridge Phil. Society 43, 1947).

    DC motor: torque = U k_t / R - k_t^2 / R speed (the same paper, eq. 7), less where the supply breaks down with the
    current it is asked for. Friction: Coulomb and Stribeck (Armstrong-Helouvry et al., Automatica 30(7), 1994), growing with
    what presses the gears together (Duclusaud et al., Extended Friction Models for the Physics Simulation of Servo
    Actuators, ICRA 2025, models M4 and M5). `external` is the torque in N m with which all else turned the joint at the
    instant before. `state` is changed.
    """
    torque, emf = 0.0, 0.0
    if on:
        torque = demand(law, factor, state, command, position, step)
        emf = law.back_emf + law.rate_gain * math.sqrt(factor)
        if law.sag > 0.0 and law.voltage_limit < math.inf:
            duty = torque / law.voltage_limit
            torque, emf = torque / (1.0 + law.sag * duty * duty), emf / (1.0 + law.sag * duty * duty)
        if abs(torque - emf * speed) > law.force_limit:
            torque, emf = math.copysign(law.force_limit, torque - emf * speed), 0.0
    else:
        state[4] = 0.0
    if state[6] > 0.0:  # a simulation shows it as it was a step before: as a line goes on it is now
        external, state[5] = 2.0 * external - state[5], external
    else:
        state[5], state[6] = external, 1.0
    pressed = abs(law.load_motor * (torque - emf * speed) - law.load_external * external)
    pace = abs(speed) / law.stribeck_speed
    slow = math.exp(-pace * pace)
    friction = law.coulomb + pressed + slow * (law.static + law.load_static * pressed)
    half = 0.5 * (emf + law.viscous + law.quadratic * abs(speed))
    return torque - half * speed, half, friction


class Servo:
    """A servo in use. `gain` is its proportional setting over the one that the law stands for."""

    def __init__(self, law: Law, gain: float = 1.0) -> None:
        self.law, self.gain = law, gain
        self.reset(0.0)

    def reset(self, position: float) -> None:
        """Begins anew, at rest with `position` (rad) as command."""
        self._state = [0.0] * len(REMEMBERED)
        self._told = deque([(-math.inf, position)])
        self._time = 0.0
        self.torque = self.damping = self.friction = 0.0

    def step(self, command: float | None, position: float, speed: float, step: float, external: float = 0.0) -> None:
        """Sets torque, damping and friction for the next `step` s; a command of None or NaN switches the motor off.

        position in rad, speed in rad/s, external in N m: with what gravity and the rest of the robot turn the joint
        (in MuJoCo -data.qfrc_bias at the joint).
        """
        on = command is not None and not math.isnan(command)
        if command is not None and on:
            self._told.append((self._time, command))
        self.torque, self.damping, self.friction = drive(
            self.law, self.gain, on, self._state, self._acting(step), position, speed, external, step
        )
        self._time += step

    def _acting(self, step: float) -> float:
        """Mean of the command that acts after its delay, over a step that has the present in its middle.

        A force at an instant moves a body as one would that began half a step earlier: so delays do not grow with the step.
        """
        begin = self._time - self.law.delay - 0.5 * step
        while len(self._told) > 1 and self._told[1][0] <= begin:
            self._told.popleft()
        area, last, value = 0.0, begin, self._told[0][1]
        for time, later in list(self._told)[1:]:
            if time >= begin + step:
                break
            area, last, value = area + (time - last) * value, time, later
        return (area + (begin + step - last) * value) / step
