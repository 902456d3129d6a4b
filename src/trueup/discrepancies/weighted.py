# SPDX-License-Identifier: Apache-2.0
"""Residuals in units of the measurement noise, which is estimated from the recordings themselves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from trueup.arrays import Array
from trueup.discrepancies.discrepancy import by_samples
from trueup.engines.simulator import Rollout
from trueup.noise import estimate_noise
from trueup.recording import Recording


class Weighted:
    """(simulated - measured) / noise, channel by channel and label by label.

    Dividing by the noise, and not by the signal's size, is what makes a small but precise channel count as much as it
    knows: with several channels this is the maximum-likelihood weighting for independent Gaussian noise.
    """

    def __init__(self, noise: Mapping[str, Mapping[str, float]]) -> None:
        self._noise = {channel: dict(per) for channel, per in noise.items()}

    @classmethod
    def estimated(cls, recordings: Sequence[Recording], channels: Sequence[str]) -> Weighted:
        """Noise of each label: the median of its estimates over the recordings, never zero."""
        found: dict[str, dict[str, list[float]]] = {}
        for recording in recordings:
            for name in channels:
                if recording.has(name):
                    channel = recording.channel(name)
                    for label, value in zip(channel.labels, estimate_noise(channel.values, channel.time), strict=True):
                        if np.isfinite(value):
                            found.setdefault(name, {}).setdefault(label, []).append(float(value))
        noise = {}
        for name, labels in found.items():
            per = {label: float(np.median(values)) for label, values in labels.items()}
            # A label that never moved shows no noise; the quietest moving one of its channel stands in for it.
            typical = [v for v in per.values() if v > 0]
            floor = 0.1 * float(np.median(typical)) if typical else 1e-3
            noise[name] = {label: max(v, floor) for label, v in per.items()}
        return cls(noise)

    def scale(self, channel: str, labels: tuple[str, ...]) -> Array:
        """(k,) noise standard deviations in the channel's unit."""
        per = self._noise.get(channel, {})
        return np.array([per.get(label, 1.0) for label in labels])

    def noise(self, channel: str, labels: tuple[str, ...]) -> Array:
        """(k,) as `scale`; NaN where nothing was measured that shows it."""
        per = self._noise.get(channel, {})
        return np.array([per.get(label, np.nan) for label in labels])

    def residual(self, real: Recording, simulated: Rollout) -> Array:
        """See Discrepancy."""
        return by_samples(self, real, simulated)
