# SPDX-License-Identifier: Apache-2.0
"""Which of several ways a run ends, by what was asked of it: what few runs say together, with its doubt."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from trueup.arrays import Array
from trueup.rounding import CERTAIN

_ROUNDS, _STILL = 60, 1e-6  # of Newton's method, and a step that is none


@dataclass(frozen=True, eq=False)
class Prior:
    """Of the coefficients of the log odds of each of w ways to end early, against none: normal, each by itself."""

    mean: Array
    """(w, c)"""
    deviation: Array
    """(w, c)"""


@dataclass(frozen=True, eq=False)
class Risks:
    """A multinomial logit: log odds of w competing ways to end early, linear in c things asked, after what was seen.

    Risks that compete must be told apart, or one hides what lowers the other (R. Prentice et al., Biometrics 34, 1978). The
    posterior is normal about its largest value (Laplace's approximation).
    """

    coefficients: Array
    """(w, c)"""
    covariance: Array
    """(w c, w c), the coefficients of a way together."""

    @classmethod
    def of(cls, asked: Array, ended: Array, runs: Array, prior: Prior) -> Self:
        """From rows (r, c) of what was asked, and how many of the (r,) runs ended in each way (r, w).

        Raises ValueError where more ended than were made.
        """
        x, y, n = (np.asarray(a, dtype=np.float64) for a in (asked, ended, runs))
        if (y.sum(axis=1) > n + 1e-9).any():
            raise ValueError(f"more runs ended than were made: {y.sum(axis=1)} of {n}")
        ways, count = prior.mean.shape

        def height(at: Array) -> float:
            logs = np.clip(x @ at.T, -CERTAIN, CERTAIN)
            far = np.sum(((at - prior.mean) / prior.deviation) ** 2)
            return float(np.sum(y * logs) - n @ np.log1p(np.exp(logs).sum(axis=1)) - 0.5 * far)

        at, covariance = prior.mean.copy(), np.diag(prior.deviation.ravel() ** 2)
        for _ in range(_ROUNDS):
            shares = _shares(np.clip(x @ at.T, -CERTAIN, CERTAIN))
            slope = (y - n[:, None] * shares).T @ x - (at - prior.mean) / prior.deviation**2
            curve = np.diag(1.0 / prior.deviation.ravel() ** 2)
            for i in range(ways):
                for j in range(ways):
                    weight = n * shares[:, i] * (float(i == j) - shares[:, j])
                    curve[i * count : (i + 1) * count, j * count : (j + 1) * count] += x.T @ (x * weight[:, None])
            covariance = np.asarray(np.linalg.inv(curve), dtype=np.float64)
            step, part, here = (covariance @ slope.ravel()).reshape(ways, count), 1.0, height(at)
            while height(at + part * step) < here and part > _STILL:
                part *= 0.5
            at = at + part * step
            if np.abs(part * step).max() < _STILL:
                break
        return cls(at, covariance)

    def shares(self, asked: Array) -> Array:
        """(b, w) in which runs end so, for rows (b, c), with the likeliest coefficients."""
        return _shares(np.clip(asked @ self.coefficients.T, -CERTAIN, CERTAIN))

    def sample_shares(self, asked: Array, draws: int, rng: np.random.Generator) -> Array:
        """(draws, b, w) of `shares`, each with coefficients from the posterior."""
        noise = rng.standard_normal((draws, self.coefficients.size)) @ np.linalg.cholesky(self.covariance).T
        each = (self.coefficients.ravel() + noise).reshape(draws, *self.coefficients.shape)
        return _shares(np.clip(np.einsum("dwc,bc->dbw", each, asked), -CERTAIN, CERTAIN))

    def learned(self, asked: Array, about: Array, weights: Array, runs: float = 1.0) -> Array:
        """(b,) by how much the variance of the share that ends early in any way, at rows `about` (k, c), is expected to fall.

        For so many runs at each row (b, c) of `asked`; the variances are added with `weights` (k,). Local optimality for what
        is asked for, here nonlinear in the coefficients (H. Chernoff, Annals of Mathematical Statistics 24, 1953).
        """
        ways = len(self.coefficients)
        there = self.shares(about)
        kept = 1.0 - there.sum(axis=1, keepdims=True)
        slopes = ((there * kept)[:, :, None] * about[:, None, :]).reshape(len(about), -1)
        less = np.empty(len(asked))
        for row, (x, shares) in enumerate(zip(asked, self.shares(asked), strict=True)):
            seen = np.kron(np.eye(ways), x)
            told = runs * (np.diag(shares) - np.outer(shares, shares)) + 1e-12 * np.eye(ways)
            through = self.covariance @ seen.T
            gone = through @ np.linalg.solve(np.linalg.inv(told) + seen @ through, through.T)
            less[row] = weights @ np.einsum("ki,ij,kj->k", slopes, gone, slopes)
        return less


def _shares(logs: Array) -> Array:
    """(..., w) from log odds against none of the ways."""
    odds = np.exp(logs)
    return odds / (1.0 + odds.sum(axis=-1, keepdims=True))
