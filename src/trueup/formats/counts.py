# SPDX-License-Identifier: Apache-2.0
"""Positions in counts of a servo's encoder (0 ... 4095 a turn), told from the numbers alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trueup.formats.mapping import ChannelColumns

Array = NDArray[np.float64]

_TURN = 4096  # counts of the magnetic encoders in Feetech STS and Dynamixel X servos
_NO_DEGREES = 720.0  # whole numbers beyond two turns of degrees are no degrees

COUNTS_NOTE = (
    "taken as counts of servos, 4096 a turn and 2048 at zero; say so for joints that are zero elsewhere (offset) or turn "
    "the other way (sign)"
)


def are_counts(columns: Sequence[Array]) -> bool:
    """Whether measured positions (each (T,) or (T, k)) are whole numbers within one turn of counts, and no degrees."""
    values = np.concatenate([column.ravel() for column in columns])
    values = values[np.isfinite(values)]
    if not len(values) or np.any(values != np.round(values)):
        return False
    return bool(values.min() >= 0.0 and _NO_DEGREES < values.max() < _TURN)


def in_counts(channel: ChannelColumns) -> ChannelColumns:
    """The channel's columns read as counts: a turn is 4096 of them, and half a turn is where servos have their zero."""
    return replace(channel, scale=(2.0 * math.pi / _TURN,), offset=(-math.pi,), unit="rad")
