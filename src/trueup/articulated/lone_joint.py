# SPDX-License-Identifier: Apache-2.0
"""One joint and its drive against a given load, compiled: MuJoCo's step (implicitfast) with a single degree of freedom.

M(t) a = F - load(t), where M is the joint's own entry of the inertia matrix, and the load what all other joints, gravity
and springs ask of it. Dry friction is MuJoCo's soft constraint, whose optimum is known where there is only one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from trueup.arrays import Array, Integers
from trueup.articulated.kernels import firmware_error, set_point
from trueup.compiled import njit


class Drives(NamedTuple):
    """What moves a joint in each of u rows; all (u,), SI units of the joint unless said otherwise."""

    gain: Array
    """Force per unit of control."""
    constant: Array
    by_length: Array
    by_speed: Array
    """Of the actuator's force: what it is at rest, and per unit of its length and of its speed."""
    force_low: Array
    force_high: Array
    gear: Array
    control_low: Array
    control_high: Array
    torque_low: Array
    torque_high: Array
    """Of the joint, what all its actuators together may do."""
    damping: Array
    damping_linear: Array
    damping_square: Array
    """Growth of the damping with speed, and with its square."""
    armature: Array
    friction: Array
    static: Array
    stribeck_speed: Array
    friction_load: Array
    softness: Array
    """Of dry friction: (1 - d) / d of its impedance d, times the joint's inverse inertia in the reference pose."""
    creep_rate: Array
    """1/s, by which dry friction takes speed out of a joint that it holds."""
    dead_band: Array
    """Half width."""
    kick: Array
    """The servo's punch, as an error of the servo."""
    delay: Array
    lead: Array
    offset: Array
    """Zero error of the command."""
    speed_limit: Array
    acceleration_limit: Array
    position: Array
    speed: Array
    """At the start."""
    load: Integers
    """Which of the loads the row has."""


class Command(NamedTuple):
    """A held command: (n,) instants in s since the start, values, and their running integral; its speed, and its integral."""

    time: Array
    value: Array
    integral: Array
    pace: Array
    way: Array


class Load(NamedTuple):
    """Along the measured motion, at (L,) instants in s since the start."""

    time: Array
    stiffness: Array
    """(L,) by how much the torque grows with the joint's position."""
    inertia: Array
    """(g, L) the joint's own entry of the inertia matrix, without armature, for each of g sets of bodies."""
    torque: Array
    """(g, L) what all else asks of the joint."""
    position: Array
    """(g, L) where that is so."""


@njit(cache=True, nogil=True)
def friction_force(free: float, inertia: float, hold: float, softness: float, limit: float) -> float:
    """Dry friction on one degree of freedom that would accelerate by `free` without: MuJoCo's soft constraint, solved.

    It aims at the acceleration `hold`, with the regularisation `softness` = R, within +-`limit`: the optimum of the dual is
    f = (hold - free) / (R + 1 / inertia), clipped.
    """
    return min(max((hold - free) / (softness + 1.0 / inertia), -limit), limit)


@njit(cache=True, nogil=True)
def replay(drives: Drives, command: Command, load: Load, step: float, out: Array) -> None:
    """Writes position and speed of each row after 0, 1, ... steps to out (u, steps + 1, 2).

    Longer than 40 lines because it is one step of a simulation, whose parts share their numbers: as functions of their own,
    to which the drives' arrays are handed, they took eight times as long.
    """
    n, m = len(command.time), len(load.time)
    for i in range(out.shape[0]):
        d = drives
        g, delay, most = d.load[i], d.delay[i], d.acceleration_limit[i] * step
        profiled = not (np.isinf(d.acceleration_limit[i]) and np.isinf(d.speed_limit[i]))
        q, v, place, pace, pushed = d.position[i], d.speed[i], 0.0, 0.0, 0.0
        out[i, 0, 0], out[i, 0, 1] = q, v
        at, k, before = 0, 0, 0.0
        for s in range(out.shape[1]):
            # the mean of the held, delayed command over the step, ahead along its speed
            t = s * step - delay
            while at + 1 < n and command.time[at + 1] <= t:
                at += 1
            area = command.integral[at] + command.value[at] * (t - command.time[at])
            area += d.lead[i] * (command.way[at] + command.pace[at] * (t - command.time[at]))
            wanted, before = (area - before) / step, area
            if s == 0:
                continue
            if profiled:
                if s == 1:
                    place = wanted
                place, pace = set_point(wanted, place, pace, d.speed_limit[i], most, step)
                wanted = place
            wanted -= d.offset[i]
            if d.dead_band[i] > 0.0 or d.kick[i] > 0.0:
                zero = d.constant[i] / d.gain[i]  # of the servo's own sensor
                wanted = q + firmware_error(wanted + zero - q, d.dead_band[i], d.kick[i]) - zero
            wanted = min(max(wanted, d.control_low[i]), d.control_high[i])
            # the drive
            gear = d.gear[i]
            force = d.gain[i] * wanted + d.constant[i] + d.by_length[i] * gear * q + d.by_speed[i] * gear * v
            slope = gear * gear * d.by_speed[i]  # of the torque with speed, which is taken implicitly
            if force <= d.force_low[i] or force >= d.force_high[i]:
                force, slope = min(max(force, d.force_low[i]), d.force_high[i]), 0.0
            push = min(max(gear * force, d.torque_low[i]), d.torque_high[i])
            # the load at the beginning of the step
            now = (s - 1) * step
            while k + 2 < m and load.time[k + 1] <= now:
                k += 1
            share = min(max((now - load.time[k]) / (load.time[k + 1] - load.time[k]), 0.0), 1.0)
            inertia = load.inertia[g, k] + share * (load.inertia[g, k + 1] - load.inertia[g, k]) + d.armature[i]
            asked = load.torque[g, k] + share * (load.torque[g, k + 1] - load.torque[g, k])
            stiff = load.stiffness[k] + share * (load.stiffness[k + 1] - load.stiffness[k])
            asked += stiff * (q - load.position[g, k] - share * (load.position[g, k + 1] - load.position[g, k]))
            # friction, and the step
            pace_now = abs(v)
            rub = (d.damping[i] + (d.damping_linear[i] + d.damping_square[i] * pace_now) * pace_now) * v
            drag = d.damping[i] + (2.0 * d.damping_linear[i] + 3.0 * d.damping_square[i] * pace_now) * pace_now
            total = push - rub - asked
            dry = d.friction[i] + d.friction_load[i] * abs(pushed)
            if d.static[i] > 0.0:
                ratio = v / d.stribeck_speed[i]
                dry += d.static[i] * np.exp(-ratio * ratio)
            if dry > 0.0:
                total += friction_force(total / inertia, inertia, -d.creep_rate[i] * v, d.softness[i], dry)
            v += step * total / (inertia + step * (drag - slope))
            q += step * v
            pushed = push
            out[i, s, 0], out[i, s, 1] = q, v
