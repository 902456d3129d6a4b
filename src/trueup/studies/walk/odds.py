# SPDX-License-Identifier: Apache-2.0
"""How often each of several candidates fails, from few runs of each: what ranks them tells as much as its own runs.

A logistic regression with a deviation of its own for each candidate, since no ranking is perfect.
"""

from __future__ import annotations

import numpy as np
from scipy.special import expit

from trueup.arrays import Array

_OFFSETS, _SLOPES, _DEVIATIONS = np.linspace(-10.0, 5.0, 61), np.linspace(0.0, 10.0, 31), np.linspace(0.0, 3.0, 7)
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(7)
_PARTS = _WEIGHTS / _WEIGHTS.sum()


def expected_shares(signal: Array, failed: Array, runs: Array) -> Array:
    """(r,) in which candidates are expected to fail that did so in `failed` of their `runs`, at least one each.

    Log odds = offset + slope x signal + a deviation of each candidate's own, with the posterior summed over a grid. Offset
    and slope have the weakly informative Cauchy priors of A. Gelman, A. Jakulin, M. G. Pittau and Y.-S. Su, Annals of
    Applied Statistics 2(4), 2008 (scales 10 and 2.5), the slope is not negative; the candidates' deviation a half normal
    one (scale 1). Signals are best scaled to a standard deviation of 1/2, which these priors are meant for.

    Raises ValueError without runs.
    """
    z, f, n = (np.asarray(x, dtype=np.float64) for x in (signal, failed, runs))
    if not len(z) or not (n > 0.0).all() or not np.isfinite(z).all():
        raise ValueError("odds are read from candidates with a finite signal and at least one run each")
    lines = _OFFSETS[:, None] + _SLOPES * (z - np.average(z, weights=n)).reshape(-1, 1, 1)
    shares = expit(lines[..., None, None] + _DEVIATIONS[:, None] * _NODES)  # (r, 61, 31, 7, nodes)
    each = shares ** f.reshape(-1, 1, 1, 1, 1) * (1.0 - shares) ** (n - f).reshape(-1, 1, 1, 1, 1)
    alone = each @ _PARTS
    prior = -np.log1p((_OFFSETS[:, None, None] / 10.0) ** 2) - np.log1p((_SLOPES[:, None] / 2.5) ** 2)
    logs = np.log(np.maximum(alone, 1e-300)).sum(axis=0) + prior - 0.5 * _DEVIATIONS**2
    weights = np.exp(logs - logs.max())
    own = ((each * shares) @ _PARTS) / np.maximum(alone, 1e-300)
    return (weights / weights.sum() * own).sum(axis=(1, 2, 3))
