# SPDX-License-Identifier: Apache-2.0
"""Plays a recorded command channel back, held between its samples."""

from __future__ import annotations

import numpy as np

from trueup.arrays import Array
from trueup.controllers.controller import Observation
from trueup.recording import Channel
from trueup.rounding import SAME_INSTANT
from trueup.samples import in_force


class Playback:
    """A Controller that repeats a recorded command for each of b copies, in place of a missing one the last before it."""

    def __init__(self, command: Channel, copies: int, *, period: float = 0.002, start: float | None = None) -> None:
        self.period = period
        self._command = command.replace(values=in_force(command.values))
        self._copies = copies
        self._start = float(command.time[0]) if start is None else start

    def reset(self, observation: Observation) -> None:
        """Nothing to forget: the command depends on time alone."""

    def command(self, observation: Observation) -> Array:
        """(b, k) the last command sent at or before this instant."""
        return self.ahead(np.array([observation.time]))[:, 0]

    def ahead(self, times: Array) -> Array:
        """See Foretold: (b, n, k)."""
        k = np.searchsorted(self._command.time, self._start + times + SAME_INSTANT, side="right") - 1
        return np.repeat(self._command.values[np.maximum(k, 0)][None], self._copies, axis=0)
