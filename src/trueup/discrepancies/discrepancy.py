# SPDX-License-Identifier: Apache-2.0
"""What a discrepancy must offer: unitless residuals between a recording and its simulations, and which of them count."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, runtime_checkable

import numpy as np

from trueup.arrays import Array, Mask
from trueup.engines.simulator import Rollout
from trueup.recording import Recording
from trueup.rounding import SAME_INSTANT
from trueup.trial import Trial


class Discrepancy(Protocol):
    """Compares one recording with b simulations of it."""

    def residual(self, real: Recording, simulated: Rollout) -> Array:
        """(b, m), unitless, a place for each observed number, channel by channel; NaN in rows whose simulation failed.

        Where nothing is compared (see `compared`) anything may stand: it is not looked at.
        """
        ...

    def scale(self, channel: str, labels: tuple[str, ...]) -> Array:
        """(k,) what counts as one unit of residual, in the channel's unit (the noise)."""
        ...


@runtime_checkable
class Masked(Protocol):
    """A discrepancy that does not compare sample by sample: it says which places of its residuals hold something."""

    def compared(self, real: Recording, trial: Trial) -> Mask:
        """(m,) True where `residual` of a simulation of `trial` compares something."""
        ...


def compared(discrepancy: Discrepancy, real: Recording, trial: Trial) -> Mask:
    """(m,) which residuals count: those the discrepancy names, else those of samples that were measured.

    It follows from the recording alone, so that every candidate is judged by the same samples.
    """
    if isinstance(discrepancy, Masked):
        return discrepancy.compared(real, trial)
    parts = [np.isfinite(measured_at(real, n, o.labels, o.time)).ravel() for n, o in trial.observed.items()]
    return np.concatenate(parts)


def by_samples(
    discrepancy: Discrepancy,
    real: Recording,
    simulated: Rollout,
    apart: Callable[[str, tuple[str, ...], Array, Array], Array] = lambda name, labels, measured, values: (
        values - measured
    ),
) -> Array:
    """(b, m) residuals sample by sample: how far the simulated (b, T, k) are `apart` from the measured (T, k), over their
    scale. `apart` is told the channel and its labels.
    """
    parts = []
    for name, values in simulated.channels.items():
        observed = simulated.trial.observed[name]
        measured = measured_at(real, name, observed.labels, observed.time)
        difference = apart(name, observed.labels, measured, values) / discrepancy.scale(name, observed.labels)
        parts.append(difference.reshape(len(values), -1))
    return np.concatenate(parts, axis=1)


def measured_at(real: Recording, channel: str, labels: tuple[str, ...], time: Array) -> Array:
    """(T, k) measured samples at instants that are a subset of the channel's own; no interpolation."""
    whole = real.channel(channel)
    selected = whole if whole.labels == labels else whole.select(labels)  # which copies and checks a whole run
    where = np.searchsorted(selected.time, time - SAME_INSTANT)
    return selected.values[np.minimum(where, len(selected.time) - 1)]
