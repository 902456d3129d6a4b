# SPDX-License-Identifier: Apache-2.0
"""How far a walking robot sways, and how often such sway is a fall: what a few runs that stood tell of falls."""

from __future__ import annotations

import numpy as np

from trueup.arrays import Array
from trueup.rounding import PRINTED

_SETTLED, _STEPS = 2.5, 30.0  # s until steps have grown; steps of 15 s, of which the logarithm counts


def sway(time: Array, angles: Array, tips: tuple[float, float]) -> float:
    """How far a run that stood swayed, squared, as a share of `tips`: roll and pitch (T, 2) at `time` (T,) since the start.

    0 for runs without a second of walk.
    """
    walked = (time > _SETTLED) & np.isfinite(angles).all(axis=1)
    if not walked.any() or np.ptp(time[walked]) < 1.0:
        return 0.0
    return float(np.square(angles[walked].std(axis=0) / tips).sum())


def passing(shares: Array) -> Array:
    """The chance of a fall in 15 s for shares of `sway`, of any shape.

    Sway that wanders like normal noise passes `tips` with exp(-tip^2 / (2 deviation^2)) a step (S. O. Rice, Bell System
    Technical Journal 24, 1945, section 3.3).
    """
    return -np.expm1(-_STEPS * np.exp(-0.5 / np.maximum(shares, PRINTED)))
