# SPDX-License-Identifier: Apache-2.0
"""Friction that no column of any fit here has the form of: what a hidden arm may show that nobody thought of.

It builds up over a travel after each reversal (Dahl), falls with speed as 1 / (1 + v^2), changes with the gear's angle,
brakes a load that drives more than one that is driven, bends down at high speed (Eyring), and wanes while the arm warms up.
"""

from __future__ import annotations

import numpy as np

from trueup.arrays import Array
from trueup.compiled import njit
from trueup.studies.arm.robot import COULOMB, VISCOUS

_TRAVEL = 0.004  # rad
_SLOW = np.array([0.05, 0.05, 0.05, 0.12, 0.12, 0.15])  # rad/s: friction above the plain one has halved here
_BEND = np.array([0.6, 0.6, 0.7, 1.5, 1.5, 2.2])  # rad/s from which viscous friction grows with the logarithm of speed
_WAVES, _PHASE = np.array([3.0, 2.0, 3.0, 1.0, 2.0, 1.0]), np.arange(6.0)
_WARMING = 45.0  # s


def foreign_friction(time: Array, angle: Array, speed: Array, through: Array, warmth: float) -> Array:
    """(S, 6) N m along a motion of the drives at angles (rad) and speeds (S, 6), gears carrying `through` (S, 6) N m.

    `warmth` -1 ... 1 at the start. Dahl, "A solid friction model", 1968; Eyring's theory of flow for the viscous part.
    """
    built = _dahl(np.ascontiguousarray(angle), _TRAVEL)
    level = COULOMB * (1.0 + 0.35 / (1.0 + (speed / _SLOW) ** 2)) * (1.0 + 0.1 * np.cos(_WAVES * angle + _PHASE))
    loss = np.where(through * built > 0.0, 0.03, 0.07) * np.abs(through)
    flow = VISCOUS * _BEND * 1.5 * np.arcsinh(speed / _BEND)
    warm = (1.0 + (warmth - 1.0) * np.exp(-(time - time[0]) / _WARMING))[:, None]
    return (1.0 - 0.1 * warm) * (level + loss) * built + (1.0 - 0.3 * warm) * flow


@njit(cache=True)
def _dahl(angle: Array, travel: float) -> Array:
    """(S, n) in -1 ... 1: nears the sign of the motion exponentially with the way since a reversal; 0 at first."""
    state = np.zeros_like(angle)
    for j in range(angle.shape[1]):
        z = 0.0
        for k in range(1, angle.shape[0]):
            step = angle[k, j] - angle[k - 1, j]
            if step != 0.0:
                sign = 1.0 if step > 0.0 else -1.0
                z = sign + (z - sign) * np.exp(-abs(step) / travel)
            state[k, j] = z
    return state
