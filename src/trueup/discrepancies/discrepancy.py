# SPDX-License-Identifier: Apache-2.0
"""What a discrepancy must offer: unitless residuals between a recording and its simulations."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from trueup.engines.simulator import Rollout
from trueup.recording import Recording

Array = NDArray[np.float64]


class Discrepancy(Protocol):
    """Compares one recording with b simulations of it."""

    def residual(self, real: Recording, simulated: Rollout) -> Array:
        """(b, m), unitless, 0 where nothing was measured, NaN in rows whose simulation failed."""
        ...

    def scale(self, channel: str, labels: tuple[str, ...]) -> Array:
        """(k,) what counts as one unit of residual, in the channel's unit (the noise)."""
        ...
