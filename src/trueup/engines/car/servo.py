# SPDX-License-Identifier: Apache-2.0
"""A first look at the steering servo: how late, how slow and how limited it is, from the curves that were driven."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from numba import njit
from numpy.typing import NDArray

from trueup.engines.car.past import Drive
from trueup.recording import Recording
from trueup.trial import Trial

Array = NDArray[np.float64]

_STEP = 0.01  # s
_EVERY = 5  # steps between the samples that are compared
_MOVES = 0.5  # of the usual speed: slower, curvature is mostly noise
_DELAYS = (0.0, 0.03, 0.06, 0.1, 0.15, 0.2, 0.3, 0.4)  # s
_LAGS = (0.02, 0.05, 0.1, 0.15, 0.25, 0.4)  # s
_RATES = (8.0, 5.0, 3.0, 2.0, 1.3, 0.8, 0.5, 0.3, 0.2, 0.12)  # 1/s
_BETTER = 0.85  # an explanation is taken in place of a simpler one if it leaves this share of the error


def servo_look(recordings: Sequence[Recording]) -> dict[str, float]:
    """Start values of steering_delay and steering_lag, and of steering_rate where a limit explains clearly more.

    Curvature = a + b z is fitted for the command z after each delay, lag and rate limit of a grid. `recordings` prepared.
    Nothing where the drives say no more than usual values do.
    """
    drives = [Drive.of(Trial.of(r, ["position", "heading"]), _STEP) for r in recordings]
    usual = _error(drives, 0.03, 0.05, np.inf)
    if not np.isfinite(usual):
        return {}
    late = min((_error(drives, d, lag, np.inf), d, lag) for d, lag in product(_DELAYS, _LAGS))
    limited = min(
        (_error(drives, d, lag, rate), d, lag, rate) for d, lag, rate in product(_DELAYS[1::2], _LAGS[::2], _RATES)
    )
    if limited[0] < _BETTER * late[0]:
        return {"steering_delay": limited[1], "steering_lag": limited[2], "steering_rate": limited[3]}
    return {"steering_delay": late[1], "steering_lag": late[2]} if late[0] < _BETTER * usual else {}


def _error(drives: Sequence[Drive], delay: float, lag: float, rate: float) -> float:
    """Root mean square of the curvature that is left (1/m), outliers cut; NaN where too little was driven."""
    found, wanted = [], []
    for drive in drives:
        speed = drive.seen[:, 3]
        known = drive.known & (drive.pasts > 20)
        if not known.any():
            continue
        usual = float(np.percentile(speed[known], 70))
        k = np.arange(drive.earliest, len(speed) - 1, _EVERY)
        k = k[known[k] & (speed[k] > max(_MOVES * usual, 0.3))]
        servo = _followed(drive.commands[:, 1], delay / _STEP, 1.0 - np.exp(-_STEP / lag), rate * _STEP)
        found.append(servo[k])
        wanted.append(drive.seen[k, 5] / speed[k])
    z, curvature = (np.concatenate(parts) if parts else np.zeros(0) for parts in (found, wanted))
    if len(z) < 100 or np.std(z) < 1e-3:
        return float("nan")
    table = np.stack([np.ones(len(z)), z, np.abs(z) * z], axis=1)
    off = table @ np.linalg.lstsq(table, curvature, rcond=None)[0] - curvature
    return float(np.sqrt(np.mean(np.minimum(off**2, 9.0 * 2.2 * np.median(off**2)))))


@njit(cache=True, nogil=True, error_model="numpy")
def _followed(command: Array, late: float, share: float, most: float) -> Array:
    """(G,) where a servo is that follows its delayed command by `share` of what is left in each step, `most` at most."""
    out = np.empty(len(command))
    now = command[0]
    for k in range(len(command)):
        i = min(max(int(k - late), 0), len(command) - 1)
        now += min(max(share * (command[i] - now), -most), most)
        out[k] = now
    return out
