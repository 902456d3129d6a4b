# SPDX-License-Identifier: Apache-2.0
"""What counts as one unit of error when a car is predicted: more, the longer ago the prediction began."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from trueup.engines.car.rollout import CarSimulator
from trueup.engines.car.tracking import usual_speed
from trueup.engines.simulator import Rollout
from trueup.recording import Recording

Array = NDArray[np.float64]

_UNIT = {"position": 0.02, "heading": 0.04}  # m and rad, a second ahead
_SPEED = 1.5  # m/s: of faster cars, the unit of position grows in proportion
_AT_ONCE = 0.25  # share of it at once; the rest grows with time


class Ahead:
    """A Discrepancy for a CarSimulator: (predicted - tracked) over a unit that grows in proportion to the time ahead.

    Without it the last moments of each stretch, where errors are largest, would decide everything, and what acts at once
    (delays, the servo's lag and play) would be bent to mend them.
    """

    def __init__(self, simulator: CarSimulator, drives: Sequence[Recording] = ()) -> None:
        self._simulator = simulator
        # A fast car's position is off by metres where its heading is as well predicted as a slow one's.
        speeds = [s for s in (usual_speed(d.channel("position")) for d in drives) if np.isfinite(s)]
        self._larger = max(1.0, float(np.median(speeds)) / _SPEED) if speeds else 1.0

    def scale(self, channel: str, labels: tuple[str, ...]) -> Array:
        """(k,) the unit a second ahead, in m or rad."""
        return np.full(len(labels), _UNIT.get(channel, 1.0) * (self._larger if channel == "position" else 1.0))

    def residual(self, real: Recording, simulated: Rollout) -> Array:
        """See Discrepancy."""
        parts = []
        for name, values in simulated.channels.items():
            o = simulated.trial.observed[name]
            channel = real.channel(name).select(o.labels)
            where = np.minimum(np.searchsorted(channel.time, o.time - 1e-9), len(channel.time) - 1)
            measured = channel.values[where]
            unit = _AT_ONCE + (1.0 - _AT_ONCE) * self._simulator.ahead(simulated.trial, o.time)
            residual = (values - measured) / (unit[:, None] * self.scale(name, o.labels))
            residual[:, ~np.isfinite(measured)] = 0.0
            parts.append(residual.reshape(len(values), -1))
        return np.concatenate(parts, axis=1)
