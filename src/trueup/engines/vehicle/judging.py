# SPDX-License-Identifier: Apache-2.0
"""What counts as one unit of error when a vehicle is predicted: more, the longer ago the prediction began."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from trueup.arrays import Array, Mask
from trueup.discrepancies.discrepancy import measured_at
from trueup.engines.simulator import Rollout
from trueup.engines.vehicle.rollout import VehicleSimulator
from trueup.recording import Recording
from trueup.tracking.cleaned import usual_speed
from trueup.trial import Trial


class Ahead:
    """A Discrepancy for a VehicleSimulator: (predicted - tracked) over a unit that grows with the time ahead.

    Without it the last moments of each stretch, where errors are largest, would decide everything, and what acts at once
    (delays, the servo's lag and play) would be bent to mend them.
    """

    unit: ClassVar[Mapping[str, float]] = {"position": 0.02, "heading": 0.04}
    """m and rad, a second ahead."""
    usual: ClassVar[float] = 1.5
    """m/s: of faster cars, the unit of position grows in proportion."""
    at_once: ClassVar[float] = 0.25
    """Share of the unit at once; the rest grows with time."""

    def __init__(self, simulator: VehicleSimulator, drives: Sequence[Recording] = ()) -> None:
        self._simulator = simulator
        # A fast car's position is off by metres where its heading is as well predicted as a slow one's.
        speeds = [s for s in (usual_speed(d.channel("position")) for d in drives) if np.isfinite(s)]
        self._larger = max(1.0, float(np.median(speeds)) / self.usual) if speeds else 1.0

    def scale(self, channel: str, labels: tuple[str, ...]) -> Array:
        """(k,) the unit a second ahead, in m or rad."""
        return np.full(len(labels), self.unit.get(channel, 1.0) * (self._larger if channel == "position" else 1.0))

    def residual(self, real: Recording, simulated: Rollout) -> Array:
        """See Discrepancy."""
        parts = []
        for name, values in simulated.channels.items():
            o = simulated.trial.observed[name]
            ahead = self._simulator.ahead(simulated.trial, o.time)[:, None]
            unit = (self.at_once + (1.0 - self.at_once) * ahead) * self.scale(name, o.labels)
            parts.append(((values - measured_at(real, name, o.labels, o.time)) / unit).reshape(len(values), -1))
        return np.concatenate(parts, axis=1)

    def compared(self, real: Recording, trial: Trial) -> Mask:
        """(m,) what was measured and predicted."""
        parts = []
        for name, o in trial.observed.items():
            predicted = np.isfinite(self._simulator.ahead(trial, o.time))[:, None]
            parts.append((np.isfinite(measured_at(real, name, o.labels, o.time)) & predicted).ravel())
        return np.concatenate(parts)
