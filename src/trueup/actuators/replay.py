# SPDX-License-Identifier: Apache-2.0
"""A servo with what it carries, replayed: the law compiled, in MuJoCo's step (implicitfast) with one degree of freedom."""

from __future__ import annotations

from types import FunctionType
from typing import Any

import mujoco
import numpy as np

from trueup.actuators import servo
from trueup.actuators.bench import Run
from trueup.actuators.servo import REMEMBERED, Law
from trueup.arrays import Array, Mask
from trueup.articulated.lone_joint import friction_force
from trueup.compiled import njit
from trueup.rounding import whole_steps
from trueup.trial import STEP

HARDEST: float = mujoco.mjMAXIMP
"""Impedance of MuJoCo's dry friction, as far as it goes."""


def _compiled(function: FunctionType, **names: object) -> Any:
    """A function of the delivered law, compiled, with other compiled ones under the names by which it calls them."""
    return njit(nogil=True)(FunctionType(function.__code__, {**function.__globals__, **names}, function.__name__))


_demand = _compiled(servo.demand, set_point=_compiled(servo.set_point))
compiled_drive = _compiled(servo.drive, demand=_demand)


@njit(nogil=True)
def _replay(
    law: Law, gain: float, time: Array, value: Array, integral: Array, on: Mask, moment: float, hangs: float,
    inertia: float, starts: Array, every: int, step: float, file: bool, out: Array,
) -> None:  # fmt: skip
    """Writes positions (steps + 1,) to `out`; begins anew after `every` steps, from one of `starts` (k, 2) after the other.

    The load's torque is that of the step before, as a simulation shows it. The command is the mean over a step that has its
    instant in the middle, as positions have it to which a force at an instant leads: so delays do not grow with the step.
    That of a `file` acts for the whole of the step that it comes before, and all of its damping at the speed after the step.
    """
    n = len(time)
    q, v = starts[0]
    state = np.zeros(len(REMEMBERED))
    external = -moment * np.sin(q - hangs)
    mass, at, now = inertia + law.armature, 0, 0
    late = law.delay if file else law.delay + 0.5 * step
    share = 2.0 if file else 1.0
    bent = (
        law.quadratic if file else 0.0
    )  # by which d torque / d speed is more than torque / speed: MuJoCo takes the slope
    begin = -late
    while at + 1 < n and time[at + 1] <= begin:
        at += 1
    before = integral[at] + value[at] * (begin - time[at])
    out[0] = q
    for s in range(1, len(out)):
        t = s * step - late
        while at + 1 < n and time[at + 1] <= t:
            at += 1
        area = integral[at] + value[at] * (t - time[at])
        wanted, before = (area - before) / step, area
        while now + 1 < n and time[now + 1] <= (s - 1) * step:
            now += 1
        torque, damping, dry = compiled_drive(law, gain, on[now], state, wanted, q, v, external, step)
        external = -moment * np.sin(q - hangs)
        total = torque - damping * v + external
        if dry > 0.0:
            total += friction_force(total / mass, mass, -v / step, (1.0 - HARDEST) / HARDEST / mass, dry)
        v += step * total / (mass + step * (share * damping + bent * abs(v)))
        q += step * v
        out[s] = q
        if s % every == 0 and s // every < len(starts):
            q, v = starts[s // every]
            external = -moment * np.sin(q - hangs)
            state[6] = 0.0


def replay(law: Law, run: Run, step: float = STEP, window: float = np.inf, *, file: bool = False) -> Array:
    """(T,) rad, where the servo with this law would have been at the run's samples; NaN where the law is unstable.

    With a `window` in s it begins anew from where it was measured to be, each time that has passed. `file`: as MuJoCo replays
    the MJCF of a law that a file can hold.
    """
    steps = max(whole_steps(run.time[-1], step) + 1, 2)
    out = np.empty(steps + 1)
    bench, every = run.bench, max(round(min(window / step, steps + 1)), 1)
    starts = run.states(np.arange(0, steps + 1, every, dtype=np.float64) * step)
    _replay(
        law, run.gain, run.command_time, run.command, run.integral, run.on, bench.moment, bench.hangs_at,
        bench.about_axis, starts, every, step, file, out,
    )  # fmt: skip
    return np.interp(run.time, step * np.arange(steps + 1), out)
