# SPDX-License-Identifier: Apache-2.0
"""Linear learners: of one input, of all, with shrunken coefficients, and by the least median of squares."""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls

from trueup.arrays import Array
from trueup.grounding.predictors import Affine
from trueup.noise import spread
from trueup.rounding import ROUNDED, TINY

RESOLUTION = 1e-3
"""Of the spread of inputs: what moves less is as still as it can be seen to be. Coefficients are those of inputs that are
known to this only (C. Bishop, "Training with noise is equivalent to Tikhonov regularization", Neural Computation 7, 1995).

Commands of a gait often depend on one another (legs that move alike), but for the digits that were written: without this, a
line learns from these digits, and a command that is off by as little moves its predictions by more than joints ever moved.
"""


def standard(X: Array) -> tuple[Array, Array]:
    """(d,), (d,) mean and standard deviation of inputs (n, d); 1 where an input does not move."""
    scale = X.std(axis=0)
    return X.mean(axis=0), np.where(scale > ROUNDED * np.maximum(np.abs(X).max(axis=0), TINY), scale, 1.0)


def least_squares(X: Array, Y: Array, rng: np.random.Generator) -> Affine:
    """Least squares of inputs that are known to `RESOLUTION`."""
    centre, scale = standard(X)
    W = _ridge((X - centre) / scale, Y - Y.mean(axis=0))
    return _affine(W, Y.mean(axis=0), centre, scale)


def _ridge(Z: Array, V: Array) -> Array:
    """(d, k) coefficients of standardised inputs Z (n, d), each with a noise of `RESOLUTION` added, for outputs V (n, k)."""
    U, s, Vt = np.linalg.svd(Z, full_matrices=False)
    return Vt.T @ (_inverted(s, len(Z))[:, None] * (U.T @ V))


def _inverted(s: Array, n: int) -> Array:
    """(r,) the inverse of singular values of n rows, less where these are about `RESOLUTION` or below."""
    return s / (s**2 + RESOLUTION**2 * n)


def simple(X: Array, Y: Array, rng: np.random.Generator) -> Affine:
    """For each output the one input that explains most."""
    centre, scale = standard(X)
    Z, V = (X - centre) / scale, Y - Y.mean(axis=0)
    slopes = Z.T @ V / np.maximum(np.sum(Z**2, axis=0), TINY)[:, None]
    best = np.argmax(np.abs(slopes) * np.sqrt(np.sum(Z**2, axis=0))[:, None], axis=0)
    W, k = np.zeros_like(slopes), np.arange(Y.shape[1])
    W[best, k] = slopes[best, k]
    return _affine(W, Y.mean(axis=0), centre, scale)


def pace(X: Array, Y: Array, rng: np.random.Generator) -> Affine:
    """Coefficients in orthogonal directions, each shrunk to what is expected given all of them.

    After Y. Wang and I. H. Witten, "Modeling for optimal probability prediction", ICML 2002 (PACE regression): sizes of
    the true coefficients, in units of their standard error, follow a mixing distribution that is estimated from the
    coefficients seen, by non-negative least squares on their distribution function (Wang 2000, chapter 5). Here
    directions are those of the singular values and the estimate is the posterior mean.
    """
    centre, scale = standard(X)
    Z, V = (X - centre) / scale, Y - Y.mean(axis=0)
    U, s, Vt = np.linalg.svd(Z, full_matrices=False)
    seen = U.T @ V  # (r, k)
    freedom = max(len(X) - len(s) - 1, 1)
    sigma = np.sqrt(np.maximum(np.sum((V - U @ seen) ** 2, axis=0) / freedom, TINY))
    shrunk = np.stack([_posterior_mean(z) for z in (seen / sigma).T], axis=1) * sigma
    return _affine(Vt.T @ (_inverted(s, len(X))[:, None] * shrunk), Y.mean(axis=0), centre, scale)


def _posterior_mean(z: Array) -> Array:
    """(r,) expected means of normal numbers z (r,) of unit deviation, from a mixture over sizes estimated from them."""
    from scipy.stats import norm

    size = np.abs(z)
    top = max(float(size.max()), 1.0)
    # Sizes among which their distribution is estimated.
    grid = np.concatenate([[0.0], np.geomspace(0.1, top + 1.0, 59)])
    at = np.sort(size)
    chance = norm.cdf(at[:, None] - grid) - norm.cdf(-at[:, None] - grid)  # P(|Z| <= at) for each true size
    share, _ = nnls(chance, (np.arange(len(at)) + 0.5) / len(at))
    up, down = (norm.pdf(size[:, None] - sign * grid) * share for sign in (1.0, -1.0))
    weight = np.sum(up + down, axis=1)
    known = weight > 1e-200  # far beyond all of the mixture a coefficient stays as it is
    mean = np.where(known, np.sum((up - down) * grid, axis=1) / np.where(known, weight, 1.0), size)
    return np.sign(z) * np.minimum(mean, size)


def least_median(X: Array, Y: Array, rng: np.random.Generator) -> Affine:
    """The fit to a random subset with the least median of squared residuals, then least squares without outliers.

    P. J. Rousseeuw, "Least median of squares regression", JASA 79, 1984, with his reweighting: residuals beyond 2.5
    deviations, these from the median with his correction for small samples, do not count.
    """
    judged = 2000  # rows by which a subset is judged
    centre, scale = standard(X)
    Z = np.concatenate([np.ones((len(X), 1)), (X - centre) / scale], axis=1)
    n, p = Z.shape
    few = rng.choice(n, min(n, judged), replace=False)
    subsets = np.stack([rng.choice(n, min(p + 1, n), replace=False) for _ in range(500)])
    A = Z[subsets]  # (m, p + 1, p)
    gram = np.einsum("mij,mik->mjk", A, A) + 1e-8 * np.eye(p)
    W = np.empty((p, Y.shape[1]))
    for k, y in enumerate(Y.T):
        fits = np.linalg.solve(gram, np.einsum("mij,mi->mj", A, y[subsets])[:, :, None])[:, :, 0]
        spreads = spread(y[few, None] - Z[few] @ fits.T)
        best = fits[int(np.argmin(spreads))]
        deviation = (1.0 + 5.0 / max(n - p, 1)) * spreads.min()
        good = np.abs(y - Z @ best) <= 2.5 * deviation
        if good.sum() > p:
            middle, seen = y[good].mean(), Z[good, 1:]
            slopes = _ridge(seen - seen.mean(axis=0), y[good, None] - middle)[:, 0]
            W[:, k] = np.append(middle - seen.mean(axis=0) @ slopes, slopes)
        else:
            W[:, k] = best
    return Affine(W[1:] / scale[:, None], W[0] - centre / scale @ W[1:])


def _affine(W: Array, middle: Array, centre: Array, scale: Array) -> Affine:
    """From standardised inputs and centred outputs to plain ones."""
    slopes = W / scale[:, None]
    return Affine(slopes, middle - centre @ slopes)
