# SPDX-License-Identifier: Apache-2.0
"""Where the residuals of one channel of one recording lie in the vector of all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.arrays import Array
from trueup.discrepancies.discrepancy import Mask


def labelled(segments: Sequence[Segment]) -> tuple[list[str], NDArray[np.intp]]:
    """The labels of all segments, and (m,) the number of its label for each residual."""
    names = list(dict.fromkeys(label for segment in segments for label in segment.labels))
    rows = [np.broadcast_to([names.index(x) for x in s.labels], (s.samples, len(s.labels)))[s.mask] for s in segments]
    return names, np.concatenate(rows)


@dataclass(frozen=True)
class Segment:
    """Where one channel of one recording lies in the residual vector: what is compared of (T, k), flattened."""

    trial: int
    recording: int
    channel: str
    labels: tuple[str, ...]
    unit: str
    first: int
    samples: int
    scale: Array
    """(k,) one unit of residual in `unit`."""
    compared: Mask | None = None
    """(T, k) which samples are compared; the others have no residual. None: all are."""

    @property
    def mask(self) -> Mask:
        """(T, k) which samples are compared."""
        return np.ones((self.samples, len(self.labels)), dtype=bool) if self.compared is None else self.compared

    @property
    def count(self) -> int:
        """How many residuals it has."""
        return self.samples * len(self.labels) if self.compared is None else int(self.compared.sum())

    @property
    def columns(self) -> slice:
        """Its part of the residual vector."""
        return slice(self.first, self.first + self.count)

    @property
    def units(self) -> Array:
        """(count,) one unit of each residual, in `unit`."""
        return np.broadcast_to(self.scale, (self.samples, len(self.labels)))[self.mask]

    def shaped(self, residual: Array) -> Array:
        """(..., T, k) of a residual vector (..., m), 0 at samples that are not compared (`mask` says which)."""
        part, shape = residual[..., self.columns], (self.samples, len(self.labels))
        if self.compared is None:
            return part.reshape(*part.shape[:-1], *shape)
        out = np.zeros((*part.shape[:-1], *shape))
        out[..., self.compared] = part
        return out


def places(whole: Sequence[Segment], part: Sequence[Segment], trials: Sequence[int]) -> NDArray[np.intp]:
    """Where the residuals of the beginnings of some trials lie among those of all: `trials` numbers, among all, those of the
    part.
    """
    of = {(s.trial, s.channel): s.first for s in whole}
    return np.concatenate([of[trials[s.trial], s.channel] + np.arange(s.count) for s in part])
