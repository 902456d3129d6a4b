# SPDX-License-Identifier: Apache-2.0
"""Speeds of commands, which controllers with a speed fed forward add to them.

A controller kp (position - q) + kd (speed - dq) asks a servo with these gains for position + kd / kp speed: its command leads
by kd / kp (K. J. Astrom and T. Hagglund, Advanced PID Control, 2006, on the set point's weight in the derivative).
"""

from __future__ import annotations

import numpy as np

from trueup.arrays import Array
from trueup.inspection.relations import ALIKE
from trueup.recording import Channel
from trueup.samples import correlation, in_force


def paces(command: Channel, pace: Channel | None) -> Array:
    """(T, k) speeds of commanded positions (T, k) in their units a second: as logged where these are their rate, else the
    rate itself, over a sample to either side.
    """
    values = np.nan_to_num(in_force(command.values))
    if len(values) < 2:
        return np.zeros_like(values)
    rates = np.gradient(values, command.time, axis=0)
    for column, label in enumerate(command.labels):
        if pace is None or label not in pace.labels or pace.unit_of(label) != f"{command.unit_of(label)}/s":
            continue
        told = np.nan_to_num(pace.select([label]).at(command.time, hold=True)[:, 0])
        if correlation(told, rates[:, column]) > ALIKE:  # a greatest speed is commanded, too
            rates[:, column] = told
    return rates
