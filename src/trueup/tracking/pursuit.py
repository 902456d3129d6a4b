# SPDX-License-Identifier: Apache-2.0
"""A first look at how a car pursues a commanded speed and turns its wheels: limits, lags and delays are scanned."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from trueup.arrays import Array
from trueup.rounding import NEGLIGIBLE
from trueup.tracking.past import MOVES, Past

_BEYOND = 10.0  # times what is scanned, limits and gains end: one that is never met may come nearer without end


@dataclass(frozen=True)
class Scan:
    """What is scanned; of delays, lags and rates the ranges that servos and small drives have."""

    length: float = 3.0
    """s, of a piece that begins with what was seen."""
    most: int = 60
    """Pieces that are looked at."""
    coarse: int = 2
    """Steps of the past in one of the scan."""
    gains: tuple[float, ...] = tuple(np.geomspace(0.3, 20.0, 8).tolist())
    """1/s."""
    limits: tuple[float, ...] = tuple(np.geomspace(0.4, 30.0, 8).tolist())
    """m/s^2."""
    finer: tuple[float, ...] = (0.7, 0.85, 1.0, 1.2, 1.4)
    """Around the best of these."""
    delays: tuple[float, ...] = (0.0, 0.1, 0.25)
    """s."""
    scales: tuple[float, ...] = (0.94, 1.0, 1.06)
    """Around the usual speed for a command of one."""
    rates: tuple[float, ...] = tuple(np.geomspace(20.0, 0.2, 9).tolist())
    """Of the steering, in units of its command, 1/s; of those that tell the same the first."""
    lags: tuple[float, ...] = (0.0, 0.05, 0.1, 0.2, 0.4)
    """s, of the steering."""
    waits: tuple[float, ...] = (0.0, 0.03, 0.06, 0.1, 0.15, 0.2, 0.3)
    """s, its delays."""


@dataclass(frozen=True, eq=False)
class _Piece:
    """What was seen of speed and turn rate (T,), NaN where nothing was, every `step` s, and commands (before + T, 2)."""

    commands: Array
    speed: Array
    turning: Array
    step: float
    before: int
    """Steps of commands that led to where it begins."""

    def command(self, k: int, late: NDArray[np.intp], column: int) -> Array:
        """(n,) what was commanded `late` (n,) steps before step k."""
        return self.commands[np.maximum(self.before + k - late, 0), column]


def pursuit(drives: Sequence[Past], wheelbase: float) -> dict[str, float]:
    """Start values of speed and steering; nothing where the car never drives.

    Each combination is run under the recorded commands from what was seen when a piece began, all at once; the one that is
    nearest to what was seen counts, by the mean of absolute differences.
    """
    scan = Scan()
    pieces = [piece for past in drives for piece in _pieces(past, scan)]
    if not pieces:
        return {}
    pieces = [pieces[k] for k in np.unique(np.linspace(0, len(pieces) - 1, scan.most).round().astype(int))]
    return _speed(pieces, scan) | _steering(pieces, wheelbase, scan)


def _pieces(past: Past, scan: Scan) -> list[_Piece]:
    per = round(scan.length / past.step)
    known = np.flatnonzero(past.known[past.earliest :]) + past.earliest
    firsts: list[int] = []
    for k in known.tolist():
        if not firsts or k >= firsts[-1] + per:
            firsts.append(k)
    seen = np.where(past.known[:, None], past.seen[:, 3:], np.nan)
    pieces = []
    for k in firsts:
        cut, before = slice(k, k + per, scan.coarse), min(k, per) // scan.coarse
        commands = past.commands[k - before * scan.coarse : k + per : scan.coarse]
        pieces.append(_Piece(commands, seen[cut, 0], seen[cut, 1], past.step * scan.coarse, before))
    return pieces


def _speed(pieces: Sequence[_Piece], scan: Scan) -> dict[str, float]:
    """Acceleration = gain * (scale * speed commanded - speed), within its limits."""
    told = np.concatenate([p.commands[p.before :, 0] for p in pieces])
    seen = np.concatenate([p.speed for p in pieces])
    moved = (np.abs(told) > 0.0) & np.isfinite(seen)
    if not moved.any():
        return {}
    usual = float(np.median(seen[moved] / told[moved]))
    off, best = _nearest(
        pieces, product(scan.gains, scan.limits, scan.limits, scan.delays, [usual * s for s in scan.scales])
    )
    ranges = [(min(x) / _BEYOND, max(x) * _BEYOND) for x in (scan.gains, scan.limits, scan.limits)]
    while True:  # until a round comes no nearer
        around = [np.clip(np.multiply(x, scan.finer), *r).tolist() for x, r in zip(best[:3], ranges, strict=True)]
        delays = [max(best[3] + d, 0.0) for d in (-0.04, 0.0, 0.04)]
        nearer, found = _nearest(pieces, product(*around, delays, [best[4] * s for s in (0.98, 1.0, 1.02)]))
        if not nearer < off:
            break
        off, best = nearer, found
    names = ("speed_gain", "acceleration_limit", "braking_limit", "speed_delay", "speed_scale")
    return dict(zip(names, best, strict=True))


def _nearest(pieces: Sequence[_Piece], tried: Iterable[tuple[float, ...]]) -> tuple[float, list[float]]:
    """Of (gain, greatest acceleration and deceleration, delay, scale) those whose speeds are nearest to what was seen, after
    the sum by which they are off.
    """
    options = np.array(list(tried))
    gain, up, down, delay, scale = options.T
    off = np.zeros(len(options))
    for p in pieces:
        late, v = np.round(delay / p.step).astype(int), np.full(len(options), p.speed[0])
        for k in range(len(p.speed) - 1):
            wanted = scale * p.command(k, late, 0)
            v = v + p.step * np.clip(gain * (wanted - v), -down, up)
            off += np.nan_to_num(np.abs(v - p.speed[k + 1]))
    best = int(np.argmin(off))
    return float(off[best]), options[best].tolist()


def _steering(pieces: Sequence[_Piece], wheelbase: float, scan: Scan) -> dict[str, float]:
    """Turn rate = speed / wheelbase * (gain * wheel + offset), the wheel late, slow and limited in its speed.

    With a wheelbase of 0 the turn rate itself is commanded.
    """
    options = np.array(list(product(scan.waits, scan.lags, scan.rates)))
    delay, lag, rate = options.T
    wheels, turned, ways = [], [], []
    for p in pieces:
        late, share = np.round(delay / p.step).astype(int), 1.0 - np.exp(-p.step / np.maximum(lag, 1e-3))
        lagged = wheel = np.full(len(options), p.commands[0, 1])
        for k in range(-p.before, len(p.speed) - 1):
            lagged = lagged + share * (p.command(k, late, 1) - lagged)
            wheel = wheel + np.clip(lagged - wheel, -rate * p.step, rate * p.step)
            if k < 0:
                continue
            if p.speed[k + 1] > MOVES or (wheelbase == 0.0 and np.isfinite(p.turning[k + 1])):
                wheels.append(wheel)
                turned.append(p.turning[k + 1])
                ways.append(p.speed[k + 1] / wheelbase if wheelbase > 0.0 else 1.0)
    if len(wheels) < len(pieces) or np.ptp(wheels) == 0.0:
        return {}
    X, y, way = np.array(wheels), np.array(turned), np.array(ways)  # (m, n), (m,), (m,)
    # Least squares of gain and offset for each option at once, by its normal equations.
    a, b, c = (X * way[:, None] * X * way[:, None]).sum(0), (X * (way**2)[:, None]).sum(0), float((way**2).sum())
    f, g = (X * (way * y)[:, None]).sum(0), float((way * y).sum())
    determinant = np.maximum(a * c - b * b, NEGLIGIBLE)
    gain, offset = (f * c - g * b) / determinant, (a * g - b * f) / determinant
    best = int(np.argmin(np.abs(way[:, None] * (gain * X + offset) - y[:, None]).sum(0)))
    names = ("turn_delay", "turn_lag", "turn_change_limit")
    if wheelbase > 0.0:
        names = ("steering_delay", "steering_lag", "steering_rate_limit")
    return dict(zip(names, options[best].tolist(), strict=True))
