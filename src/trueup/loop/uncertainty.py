# SPDX-License-Identifier: Apache-2.0
"""How sure the estimates are: covariance that knows about correlated residuals, and 95 % intervals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from trueup.arrays import Array, Mask
from trueup.evidence import half_interval
from trueup.loop.descent import Fit
from trueup.loop.problem import Problem
from trueup.loop.stretches import seen_as_good, without_each_stretch
from trueup.rounding import NEGLIGIBLE, TINY
from trueup.verdicts import PRIOR

FORETOLD = 0.5  # share of the box: slopes foretell nothing further away
INEXACT = 1e-4  # damping of steps of others to where they settle: slopes are not exact beside the optimum


def unit_covariance(problem: Problem, fit: Fit) -> Array:
    """(n_free, n_free) covariance of the estimate in the unit box: A^-1 B A^-1 (Huber's sandwich).

    A is the curvature of the loss. B holds the residuals' own variance and autocorrelation, series by series, so that
    model errors that last for seconds widen the intervals as they must (Newey and West, Econometrica 55(3), 1987, with
    the autocorrelation estimated from the residuals and tapered). Where trials, or the windows that stand for them,
    are more than the parameters, no interval is narrower than they disagree (K.-Y. Liang and S. L. Zeger, Biometrika 73(1),
    1986): what the start of one did wrong is shared by all that is measured in it. So it is with stretches of one trial that
    begin anew, of which each is left out in turn (`stretches.py`). Where the fit was probed, its `scatter` is added.
    """
    jacobian = fit.jacobian * fit.weights[:, None]
    curvature = fit.jacobian.T @ jacobian
    spread = np.zeros_like(curvature)
    pulls = np.zeros((1 + max((s.trial for s in problem.segments), default=0), len(curvature)))
    for segment in problem.segments:
        slopes = segment.shaped(jacobian.T)
        errors = segment.shaped(fit.residual)
        counts = segment.shaped(fit.weights)
        for j in range(len(segment.labels)):
            spread += _series(slopes[:, :, j].T, errors[:, j], counts[:, j], segment.mask[:, j])
        pulls[segment.trial] += np.einsum("ntk,tk->n", slopes, errors)
    size = max(float(np.trace(spread)) / max(float(np.trace(curvature)), TINY), NEGLIGIBLE)
    inverse = np.linalg.inv(curvature + size * PRIOR * np.eye(len(curvature)))
    covariance = inverse @ (spread + size**2 * PRIOR * np.eye(len(curvature))) @ inverse
    between = np.sum(((pulls - pulls.mean(axis=0)) @ inverse) ** 2, axis=0)
    apart = without_each_stretch(problem, fit, size * PRIOR)
    if apart is not None or len(pulls) > len(curvature):
        between = between if apart is None else apart
        wider = np.sqrt(np.maximum(between / np.maximum(np.diag(covariance), TINY), 1.0))
        covariance *= wider[:, None] * wider
    return covariance if fit.scatter is None else covariance + fit.scatter


def as_wide_as_seen(problem: Problem, fit: Fit) -> Fit:
    """The fit with a `scatter` that has intervals hold all places that were seen to be as good (see `stretches.py`)."""
    reach = seen_as_good(problem, fit)
    if reach is None:
        return fit
    scatter = np.diag(np.maximum(reach - np.diag(unit_covariance(problem, fit)), 0.0))
    return replace(fit, scatter=scatter if fit.scatter is None else scatter + fit.scatter)


def curvature_inverse(fit: Fit, size: float = 1.0) -> Array:
    """(n_free, n_free) inverse of the loss' curvature, turning a slope into a step to the optimum; `size` of its prior."""
    curvature = fit.jacobian.T @ (fit.jacobian * fit.weights[:, None])
    inverse = np.linalg.inv(curvature + size * PRIOR * np.eye(len(curvature)))
    return 0.5 * (inverse + inverse.T)


def start_scatter(problem: Problem, fit: Fit) -> Array:
    """(n_free, n_free) mean squares by which noise at the starts moves a fit that knows nothing of it.

    `problem` is the one that was fitted, with start corrections eliminated since: it knows what these do.
    """
    spread = np.zeros((fit.jacobian.shape[1],) * 2)
    for start in problem.eliminated:
        slopes = fit.jacobian[start.columns] * fit.weights[start.columns, None]
        moved = start.size * (slopes.T @ start.changes)
        spread += moved @ moved.T
    inverse = curvature_inverse(fit)
    return inverse @ spread @ inverse


def intervals(fit: Fit, covariance: Array) -> tuple[Array, Array]:
    """(n_free,) lower and upper ends of the 95 % intervals, in the parameters' units, within their bounds."""
    half = half_interval() * np.sqrt(np.maximum(np.diag(covariance), 0.0))
    free = fit.space.free
    low = fit.space.from_unit(np.clip(fit.unit - half, 0.0, 1.0))[free]
    high = fit.space.from_unit(np.clip(fit.unit + half, 0.0, 1.0))[free]
    return low, high


def _series(slopes: Array, errors: Array, weights: Array, given: Mask) -> Array:
    """(n, n) variance of sum(slopes * errors) for one series (T, n), (T,), with the errors' own autocorrelation.

    Where nothing was measured (not `given`, (T,)) slopes and errors are 0.
    """
    if int(given.sum()) < 3:
        return np.zeros((slopes.shape[1], slopes.shape[1]))
    autocovariance = _autocovariance(errors * weights, given)
    autocovariance /= max(float(np.mean(weights[given] ** 2)), NEGLIGIBLE)
    if len(autocovariance) == 1:
        return autocovariance[0] * (slopes.T @ slopes)
    kernel = np.concatenate([autocovariance[:0:-1], autocovariance])
    size = 1 << int(np.ceil(np.log2(len(slopes) + len(kernel))))
    spectrum = np.fft.rfft(slopes, size, axis=0) * np.fft.rfft(kernel, size)[:, None]
    smoothed = np.fft.irfft(spectrum, size, axis=0)[len(autocovariance) - 1 :][: len(slopes)]
    found = slopes.T @ smoothed
    return 0.5 * (found + found.T)


def _autocovariance(errors: Array, given: Mask) -> Array:
    """(lags,) autocovariance until it is lost in its own noise, tapered so that it stays a covariance.

    Each lag is the mean over the pairs of samples that were measured (E. Parzen, Sankhya A 25, 1963), of which there are
    at most n - lag.
    """
    n = len(errors)
    lags = max(n // 4, 1)
    full = _lagged(errors, lags) / n
    if not given.all():
        full *= (n - np.arange(lags)) / np.maximum(_lagged(given.astype(np.float64), lags), 0.5)
    noise = 2.0 * full[0] / np.sqrt(given.sum())
    # The first lag that is lost in noise ends it: white residuals keep lag zero only.
    below = np.flatnonzero(np.abs(full) < noise)
    lags = int(below[0]) if len(below) else len(full)
    if lags <= 1:
        return full[:1]
    reach = min(2 * lags, len(full))
    return full[:reach] * (1.0 - np.arange(reach) / reach)


def _lagged(series: Array, lags: int) -> Array:
    """(lags,) sums of products of a series (n,) with itself, shifted."""
    size = 1 << int(np.ceil(np.log2(2 * len(series))))
    return np.fft.irfft(np.abs(np.fft.rfft(series, size)) ** 2, size)[:lags]
