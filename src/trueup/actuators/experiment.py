# SPDX-License-Identifier: Apache-2.0
"""The experiment with one servo by regression: what errors, speeds and loads say of its gains, and what they cannot say.

J. Tan, Z. Xie, B. Boots and C. K. Liu, "Simulation-based design of dynamic controllers for humanoid balancing", IROS 2016,
eq. 2: 0 = I q'' + kp (q - q_ref) + kd q' + kc sgn(q'), here with gravity and divided by kp, so that what is measured stands
alone: the error is (I / kp) q'' + (m g l / kp) sin(q) + (kd / kp) q' + (kc / kp) sgn(q').
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from trueup.actuators.bench import Run
from trueup.arrays import Array
from trueup.evidence import half_interval, jackknife
from trueup.instant import MOVING, moving_cubic, rate_noise, samples_of_cubic, usual_step
from trueup.rounding import TINY


@dataclass(frozen=True)
class Value:
    """A number with its 95 % interval."""

    name: str
    value: float
    low: float
    high: float
    unit: str

    @property
    def sure(self) -> bool:
        """Whether it differs from nothing."""
        return bool(self.low > 0.0 or self.high < 0.0)


@dataclass(frozen=True)
class Experiment:
    """What the regression says."""

    ratios: tuple[Value, ...]
    """kd / kp, kc / kp, I / kp, and, with gravity, m g l / kp: these need to know nothing of the load."""
    gains: tuple[Value, ...]
    """kp, kd and kc, where the load is known and its torque is seen in the error; else empty."""
    explained: float
    """Share of the error's variance that the regression explains."""
    cannot: tuple[str, ...]
    """What the experiment cannot fix, in words."""


def experiment(runs: Sequence[Run], full_error: float = np.inf) -> Experiment:
    """Regression over all instants at which the servo moves, is on and not at its limit (`full_error`, rad).

    Intervals by leaving out stretches in turn (the jackknife).
    """
    parts = [_rows(run, full_error) for run in runs]
    table = np.concatenate(parts)
    heavy = any(run.bench.moment > 0.0 for run in runs)
    names = ["kd / kp", "kc / kp", "I / kp", *(["m g l / kp"] if heavy else [])]
    units = ["s", "rad", "s2", "rad"]
    blocks = 12  # stretches of all recordings together that are left out in turn
    if len(table) < 10 * blocks:
        return Experiment(
            (), (), 0.0, ("the servo hardly moves: send it to and fro between two angles, slow and fast",)
        )
    known = all(run.bench.known for run in runs)
    columns = slice(1, 5 if heavy else 4)
    x, y = table[:, columns], table[:, 0]
    whole = _solve(x, y)
    edges = np.linspace(0, len(y), blocks + 1).astype(int)
    keep = [np.r_[0:a, b : len(y)] for a, b in pairwise(edges)]
    ratios = _intervals(whole, [_solve(x[k], y[k]) for k in keep])
    told = tuple(_value(n, row, u) for n, row, u in zip(names, ratios, units, strict=False))
    explained = 1.0 - float(np.var(y - x @ whole) / max(np.var(y), TINY))
    cannot = []
    gains: tuple[Value, ...] = ()
    if not known:
        cannot.append(
            "kp, kd and kc in N m: the load is unknown, only their ratios are seen; give --mass and --length, or --inertia"
        )
    else:
        load = table[:, [5, 1, 2]]
        both = _intervals(_absolute(load, y), [_absolute(load[k], y[k]) for k in keep])
        named = (("kp", "N m/rad"), ("kd", "N m s/rad"), ("kc", "N m"))
        gains = tuple(_value(n, row, u) for (n, u), row in zip(named, both, strict=True))
        if not gains[0].sure:
            cannot.append(
                "kp in N m/rad: the torque of the load is lost in the error, so that only ratios are known; "
                "a heavier load, or one against gravity, would fix it"
            )
            gains = ()
    cannot.append("whether kd is back-EMF or viscous friction, unless the motor is also switched off while it moves")
    return Experiment(told, gains, explained, tuple(cannot))


def _value(name: str, row: Array, unit: str) -> Value:
    value, low, high = (float(x) for x in row)
    return Value(name, value, low, high, unit)


def _solve(x: Array, y: Array) -> Array:
    return np.asarray(np.linalg.lstsq(x, y, rcond=None)[0], dtype=np.float64)


def _absolute(load: Array, y: Array) -> Array:
    """kp, kd, kc from columns of the load's torque, speed and its sign."""
    torque, speed, sign = _solve(load, y)
    return np.array([1.0 / torque, speed / torque, sign / torque], dtype=np.float64)


def _intervals(whole: Array, each: Sequence[Array]) -> Array:
    """(n, 3) values and ends of their 95 % intervals."""
    half = half_interval(len(each)) * jackknife(np.stack(each))
    return np.asarray(np.stack([whole, whole - half, whole + half], axis=1), dtype=np.float64)


def _rows(run: Run, full_error: float) -> Array:
    """(n, 6) error, speed, its sign, acceleration, sine of the angle from hanging, torque of the load."""
    dt = usual_step(run.time)
    grid = np.arange(0.0, run.time[-1], dt)
    if len(grid) <= samples_of_cubic(dt):
        return np.zeros((0, 6))
    q, v, a = moving_cubic(np.interp(grid, run.time, run.position), dt)
    at = run.given(grid)
    error = run.gain * (run.command[at] - q)
    good = run.on[at] & (np.abs(v) > MOVING * rate_noise(dt) * run.noise) & (np.abs(error) < full_error)
    rise = np.sin(q - run.bench.hangs_at)
    load = run.bench.about_axis * a + run.bench.moment * rise
    return np.stack([error, v, np.sign(v), a, rise, load], axis=1)[good]
