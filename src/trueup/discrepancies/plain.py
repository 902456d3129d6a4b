# SPDX-License-Identifier: Apache-2.0
"""The plain difference of simulated and measured samples: for losses that are to be quoted in the channel's own unit."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from trueup.arrays import Array
from trueup.discrepancies.discrepancy import by_samples
from trueup.engines.simulator import Rollout
from trueup.recording import Recording


class Plain:
    """A Discrepancy: (simulated - measured) / unit, sample by sample; its rms is the RMSE in units of `unit`."""

    def __init__(self, units: Mapping[str, float] | None = None) -> None:
        """`units`: what counts as one unit of residual, channel by channel, in the channel's unit; 1 where not given."""
        self._units = dict(units or {})

    def scale(self, channel: str, labels: tuple[str, ...]) -> Array:
        """(k,) see Discrepancy."""
        return np.full(len(labels), self._units.get(channel, 1.0))

    def residual(self, real: Recording, simulated: Rollout) -> Array:
        """See Discrepancy."""
        return by_samples(self, real, simulated)
