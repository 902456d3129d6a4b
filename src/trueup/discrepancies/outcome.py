# SPDX-License-Identifier: Apache-2.0
"""What came of a run, in a few numbers: for calibrating on outcomes where the course of events cannot be compared."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from trueup.arrays import Array, Mask
from trueup.discrepancies.discrepancy import measured_at
from trueup.engines.simulator import Rollout
from trueup.errors import RecordingError
from trueup.recording import Recording
from trueup.trial import Trial

FEATURES: Mapping[str, Callable[[Array, Array], Array]] = MappingProxyType(
    {
        "last": lambda time, values: values[..., -1, :],
        "mean": lambda time, values: np.nanmean(values, axis=-2),
        "spread": lambda time, values: np.nanstd(values, axis=-2),
        "largest": lambda time, values: np.nanmax(values, axis=-2),
        "smallest": lambda time, values: np.nanmin(values, axis=-2),
        "largest at": lambda time, values: time[np.nanargmax(values, axis=-2)] - time[0],
        "way": lambda time, values: np.nansum(np.abs(np.diff(values, axis=-2)), axis=-2),
        "length": lambda time, values: np.nansum(np.linalg.norm(np.diff(values, axis=-2), axis=-1), axis=-1)[..., None],
    }
)
"""Name -> numbers of (T,) time in s and (..., T, k) values: (..., k), or (..., 1) where the labels count together."""


@dataclass(frozen=True)
class Feature:
    """One feature of one channel, and what difference in it counts as one."""

    channel: str
    kind: str
    """One of FEATURES."""
    unit: float = 1.0
    """What counts as one unit of residual, in the channel's unit (s for 'largest at')."""
    labels: tuple[str, ...] = ()
    """Which columns; () for all."""


class Outcome:
    """A Discrepancy: differences of features over their units, at the front of the channel's residuals."""

    def __init__(self, features: Sequence[Feature]) -> None:
        """Raises RecordingError for a feature that does not exist."""
        for feature in features:
            if feature.kind not in FEATURES:
                raise RecordingError(f"feature '{feature.kind}' is unknown; features are: {', '.join(FEATURES)}")
        self._features = tuple(features)

    def scale(self, channel: str, labels: tuple[str, ...]) -> Array:
        """(k,) see Discrepancy: the first feature's unit."""
        units = [f.unit for f in self._features if f.channel == channel]
        return np.full(len(labels), units[0] if units else 1.0)

    def residual(self, real: Recording, simulated: Rollout) -> Array:
        """See Discrepancy. Raises RecordingError where a channel has fewer samples than features."""
        parts = []
        for name, values in simulated.channels.items():
            observed = simulated.trial.observed[name]
            measured = measured_at(real, name, observed.labels, observed.time)
            known = np.isfinite(measured).all(axis=1)
            part = np.zeros((len(values), measured.size))
            numbers = self._differences(name, observed.labels, observed.time[known], measured[known], values[:, known])
            if numbers.shape[1] > part.shape[1]:
                raise RecordingError(f"channel '{name}' has {part.shape[1]} samples, fewer than features")
            part[:, : numbers.shape[1]] = numbers
            part[~np.isfinite(values).all(axis=(1, 2))] = np.nan
            parts.append(part)
        return np.concatenate(parts, axis=1)

    def compared(self, real: Recording, trial: Trial) -> Mask:
        """See Masked."""
        parts = []
        for name, o in trial.observed.items():
            kinds = [f for f in self._features if f.channel == name]
            each = (1 if f.kind == "length" else len(f.labels or o.labels) for f in kinds)
            parts.append(np.arange(len(o.time) * len(o.labels)) < sum(each))
        return np.concatenate(parts)

    def _differences(self, name: str, labels: tuple[str, ...], time: Array, measured: Array, simulated: Array) -> Array:
        """(b, f) simulated minus measured, in units."""
        found = [np.zeros((len(simulated), 0))]
        for feature in self._features:
            if feature.channel == name:
                columns = [labels.index(label) for label in feature.labels or labels]
                compute = FEATURES[feature.kind]
                both = compute(time, simulated[..., columns]) - compute(time, measured[..., columns])
                found.append(both / feature.unit)
        return np.concatenate(found, axis=1)
