# SPDX-License-Identifier: Apache-2.0
"""The one rule by which a structure is kept: what was left out of the fit must be predicted clearly better with it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.rounding import ROUNDED, TINY

FEWEST_PARTS = 6
"""Parts that are left out in turn, at least: of fewer the spread is itself hardly known."""
STANDARD_ERRORS = 2.0
"""A gain on left-out data counts from this many of its standard errors on: one chance in twenty of being none. L. Breiman,
J. Friedman, R. Olshen, C. Stone, Classification and Regression Trees, 1984, section 3.4.3, prefer the simpler of two
models within one; two, because several structures are asked about in turn. Every choice of structure uses this number; a
servo's may also hold by one, where no recording speaks against it (`actuators/choose.py`)."""
HALVED = 0.5
"""Of an error: what may be left of it where something is said to be wrong, or another, and that is mended in a trial. Chance,
noise and models of a slightly other form do not halve what they did not cause. A model explains a robot of whose errors more
than that is noise, and changes that halve or double read better as factors than in percent."""
EXCERPT = 20.0
"""s of motion that a rough fit looks at: what is wrong in it, parallel or lacking, is so in every motion."""


@dataclass(frozen=True)
class Evidence:
    """How much better left-out data are predicted with a structure than without it."""

    gain: float
    """Mean over blocks of ln(error without / error with): 0.1 is an error about a tenth lower."""
    standard_error: float
    """Of the gain, from its spread over blocks; infinite with fewer than two blocks."""

    @property
    def holds(self) -> bool:
        """Whether the structure stays: what rounding alone gains, block by block alike, is no evidence."""
        return self.gain > max(STANDARD_ERRORS * self.standard_error, ROUNDED)

    @property
    def halves(self) -> bool:
        """Whether it holds, and left-out errors are half as large: enough to say so unasked."""
        return self.holds and self.gain > -np.log(HALVED)

    def in_words(self) -> str:
        """What becomes of left-out errors with the structure: "lower by 18 % (standard error 5 %)", or by a factor of 13;
        "the same" where rounding alone tells them apart.
        """
        if not np.isfinite(self.gain):
            return "without bound"
        if max(abs(self.gain), self.standard_error) <= ROUNDED:
            return "the same"
        size = float(np.exp(abs(self.gain)))
        if size >= 1.0 / HALVED:
            change = f"by a factor of {size:.2g}"
        else:
            change = f"by {100.0 * (1.0 - 1.0 / size if self.gain > 0.0 else size - 1.0):.2g} %"
        return f"{'lower' if self.gain >= 0.0 else 'higher'} {change} ({self._doubt()})"

    def _doubt(self) -> str:
        if not np.isfinite(self.standard_error):
            return "nothing tells how sure that is"
        size = float(np.exp(self.standard_error))
        return (
            f"standard error {f'a factor of {size:.2g}' if size >= 1.0 / HALVED else f'{100.0 * (size - 1.0):.2g} %'}"
        )


def evidence(without: Array, with_it: Array, weights: Array | None = None) -> Evidence:
    """What left-out errors (B,), one a block, say of a structure: errors of the fit without it and of the fit with it.

    A block is whatever was left out together (a recording, a stretch of time, a kind of motion). Blocks count alike however
    large their errors are, so that a recording which nothing explains does not rule; with `weights` (B,) they count by these:
    stretches of one log by their squared errors, so that one in which nothing happens says little. An infinite error with
    the structure refutes it. The standard error is that of a ratio estimator: W. Cochran, Sampling Techniques, 1977, eq. 6.9.
    """
    B = len(without)
    share = np.full(B, 1.0 / max(B, 1)) if weights is None else weights / max(float(weights.sum()), TINY)
    ratio = np.log(np.maximum(without, TINY)) - np.log(np.maximum(with_it, TINY))
    gain = float(share @ ratio)
    if B < 2 or not np.isfinite(ratio).all():
        return Evidence(gain, float("inf"))
    return Evidence(gain, float(np.sqrt(B / (B - 1) * np.sum((share * (ratio - gain)) ** 2))))


def together(first: Evidence, parts: int, second: Evidence, more: int) -> Evidence:
    """The evidence of several recordings and of some more, which count alike."""
    gain = (parts * first.gain + more * second.gain) / (parts + more)
    error = np.hypot(parts * first.standard_error, more * second.standard_error) / (parts + more)
    return Evidence(float(gain), float(error))


def chance() -> float:
    """That a gain of `STANDARD_ERRORS` is none, to either side: about one in twenty."""
    return math.erfc(STANDARD_ERRORS / math.sqrt(2.0))


def without_each(parts: Array) -> Array:
    """(K, ...) sums of all parts (K, ...) but one each: what a fit sees that leaves the parts out in turn."""
    return parts.sum(axis=0) - parts


def jackknife(each: Array) -> Array:
    """(...) standard deviations of estimates, from those (K, ...) made without one block of data each.

    It counts how long errors last, and what the model misses: B. Efron, R. Tibshirani 1993, section 11.5.
    """
    return np.sqrt((len(each) - 1) / len(each) * np.sum((each - np.mean(each, axis=0)) ** 2, axis=0))


def half_interval(blocks: float = math.inf, share: float = 0.95) -> float:
    """How many standard deviations an interval reaches to either side that holds this share of what is drawn, where these
    are known from so many blocks: Student's distribution, the normal one where they are known.
    """
    from scipy.special import stdtrit

    return float(stdtrit(blocks - 1, 0.5 + 0.5 * share))


def explained(residual: Array | None) -> bool:
    """Whether a model replays the recordings to about their noise, by residuals (m,) in units of it: elsewhere the last
    percent is not worth minutes.
    """
    return residual is not None and HALVED**2 * float(np.mean(residual**2)) < 1.0
