# SPDX-License-Identifier: Apache-2.0
"""How often a robot fails, read from how often its doubtful simulators do, as far as the robot's own runs say.

Simulators that are wrong in many ways still rank what fails; how much failing in them means how much on the robot, the
robot has to say: a logistic regression with a deviation of its own for each candidate, since the ranking is not perfect.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.special import expit

from trueup.arrays import Array

_OFFSETS, _SLOPES, _DEVIATIONS = np.linspace(-10.0, 5.0, 61), np.linspace(0.0, 10.0, 31), np.linspace(0.0, 3.0, 7)
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(7)
_PARTS = _WEIGHTS / _WEIGHTS.sum()


@dataclass(frozen=True, eq=False)
class Odds:
    """Log odds of failing = offset + slope x signal + a deviation of each candidate's own, after the robot's runs.

    The posterior is summed over a grid. Offset and slope have the weakly informative Cauchy priors of A. Gelman, A. Jakulin,
    M. G. Pittau and Y.-S. Su, Annals of Applied Statistics 2(4), 2008 (scales 10 and 2.5), the slope is not negative; the
    candidates' deviation a half normal one (scale 1). `signal` is the logarithm of a simulated share, so that a unit of
    it is a factor of e.
    """

    centre: float
    weights: Array
    """(61, 31, 7) of the grid of offsets, slopes and deviations."""
    told: Array
    """(r,) expected shares of the candidates that were run, their own runs counted."""

    @classmethod
    def of(cls, signal: Array, failed: Array, runs: Array) -> Self:
        """From candidates (r,) that failed in so many of their runs (at least one) on the robot.

        Raises ValueError without runs.
        """
        z, f, n = (np.asarray(x, dtype=np.float64) for x in (signal, failed, runs))
        if not len(z) or not (n > 0.0).all() or not np.isfinite(z).all():
            raise ValueError(
                "odds are read from candidates with a finite signal and at least one run on the robot each"
            )
        centre = float(np.average(z, weights=n))
        shares = _shares(z - centre)  # (r, 61, 31, 7, nodes)
        each = shares ** f.reshape(-1, 1, 1, 1, 1) * (1.0 - shares) ** (n - f).reshape(-1, 1, 1, 1, 1)
        alone = each @ _PARTS
        prior = -np.log1p((_OFFSETS[:, None, None] / 10.0) ** 2) - np.log1p((_SLOPES[:, None] / 2.5) ** 2)
        logs = np.log(np.maximum(alone, 1e-300)).sum(axis=0) + prior - 0.5 * _DEVIATIONS**2
        weights = np.exp(logs - logs.max())
        weights /= weights.sum()
        own = ((each * shares) @ _PARTS) / np.maximum(alone, 1e-300)
        return cls(centre, weights, (weights * own).sum(axis=(1, 2, 3)))

    def __call__(self, signal: Array) -> Array:
        """(b,) expected shares in which candidates fail on the robot that it has not run."""
        return ((_shares(np.asarray(signal) - self.centre) @ _PARTS) * self.weights).sum(axis=(1, 2, 3))

    @property
    def slope(self) -> float:
        """By how much the log odds are expected to rise with the signal."""
        return float((self.weights.sum(axis=(0, 2)) * _SLOPES).sum())


def _shares(apart: Array) -> Array:
    """(r, 61, 31, 7, nodes) of the grid, for signals (r,) less their centre."""
    lines = _OFFSETS[:, None] + _SLOPES * apart.reshape(-1, 1, 1)
    return expit(lines[..., None, None] + _DEVIATIONS[:, None] * _NODES)
