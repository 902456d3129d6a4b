# SPDX-License-Identifier: Apache-2.0
"""An exact Gaussian process for a few dozen measurements, its three numbers found by marginal likelihood with priors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.linalg import cho_solve, solve_triangular
from scipy.optimize import minimize

from trueup.arrays import Array
from trueup.rounding import ROUNDED


@dataclass(frozen=True)
class Prior:
    """Of a positive number: its logarithm is normal."""

    median: float
    spread: float
    """Standard deviation of the logarithm."""

    def cost(self, log: float) -> float:
        """Minus the log density of the logarithm, less a constant."""
        return 0.5 * ((log - np.log(self.median)) / self.spread) ** 2


@dataclass(frozen=True, eq=False)
class GaussianProcess:
    """A function of mean zero with a Matern 5/2 covariance, after measurements of it.

    C. E. Rasmussen and C. K. I. Williams, Gaussian Processes for Machine Learning, 2006, sections 2.2 and 5.4.1. One
    length for all inputs: with few measurements a length for each is not found. Its prior grows with the root of the
    number of inputs (C. Hvarfner, E. Hellsten and L. Nardi, Vanilla Bayesian optimization performs great in high
    dimensions, ICML 2024).
    """

    at: Array
    """(r, m) where it was measured."""
    amplitude: float
    length: float
    noise: float
    """Standard deviation of one measurement."""
    _root: Array
    _weights: Array

    @classmethod
    def of(cls, at: Array, values: Array, counts: Array | None = None, *, noise: Prior | None = None) -> Self:
        """From values (r,) measured at (r, m), each the mean of `counts` (r,) measurements.

        Amplitude and noise are expected at the size of the values, and at a third of it, within factors of about three.
        Raises ValueError without measurements.
        """
        X, y = np.atleast_2d(np.asarray(at, dtype=np.float64)), np.asarray(values, dtype=np.float64)
        if not len(y) or len(X) != len(y):
            raise ValueError(f"{len(y)} values at {len(X)} places are no measurements of a function")
        each = np.ones(len(y)) if counts is None else np.asarray(counts, dtype=np.float64)
        size = max(float(np.sqrt(np.mean(y**2))), ROUNDED)
        apart = _apart(X, X)
        far = Prior(float(np.exp(np.sqrt(2.0)) * np.sqrt(X.shape[1])), float(np.sqrt(3.0)))
        priors = Prior(size, 1.0), far, noise or Prior(size / 3.0, 1.0)

        def cost(logs: Array) -> float:
            amplitude, length, deviation = np.exp(logs)
            root = _root_of(apart, amplitude, length, deviation, each)
            white = solve_triangular(root, y, lower=True)
            fit = 0.5 * float(white @ white) + float(np.log(np.diag(root)).sum())
            return fit + sum(p.cost(x) for p, x in zip(priors, logs, strict=True))

        middle = np.log([p.median for p in priors])
        starts = [middle + np.array([0.0, shift, 0.0]) for shift in (0.0, -2.0, -4.0)]
        logs = min((minimize(cost, s, method="L-BFGS-B") for s in starts), key=lambda f: f.fun).x
        amplitude, length, deviation = (float(v) for v in np.exp(logs))
        root = _root_of(apart, amplitude, length, deviation, each)
        return cls(X, amplitude, length, deviation, root, cho_solve((root, True), y))

    def __call__(self, at: Array) -> tuple[Array, Array]:
        """(b,), (b,) mean and standard deviation of the function at (b, m); what measuring it would add is not in it."""
        cross = self.amplitude**2 * matern(np.atleast_2d(at), self.at, self.length)
        white = solve_triangular(self._root, cross.T, lower=True)
        variance = self.amplitude**2 - np.einsum("rb,rb->b", white, white)
        return cross @ self._weights, np.sqrt(np.maximum(variance, 0.0))


def matern(a: Array, b: Array, length: float) -> Array:
    """(r, s) correlation between places (r, m) and (s, m), of Matern's kind with smoothness 5/2."""
    return _matern(_apart(a, b) / length)


def _apart(a: Array, b: Array) -> Array:
    return np.asarray(np.sqrt(((a[:, None, :] - b[None, :, :]) ** 2).sum(axis=2)), dtype=np.float64)


def _matern(apart: Array) -> Array:
    x = np.sqrt(5.0) * apart
    return np.asarray((1.0 + x + x**2 / 3.0) * np.exp(-x), dtype=np.float64)


def _root_of(apart: Array, amplitude: float, length: float, noise: float, counts: Array) -> Array:
    """(r, r) Cholesky factor of the measurements' covariance."""
    K = amplitude**2 * _matern(apart / length)
    K[np.diag_indices_from(K)] += noise**2 / counts + 1e-10 * amplitude**2
    return np.asarray(np.linalg.cholesky(K), dtype=np.float64)
