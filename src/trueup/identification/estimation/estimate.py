# SPDX-License-Identifier: Apache-2.0
"""Parameters from regressors and torque: least squares, weighted, robust, with instruments; honest standard deviations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from trueup.arrays import Array, Integers
from trueup.errors import IdentificationError
from trueup.identification.estimation.moments import RIDGE, moments_of, solve, weighted_fit
from trueup.identification.rows import Rows
from trueup.noise import spread
from trueup.rounding import NEGLIGIBLE, TINY

_HUBER = 1.345
"""Standard deviations beyond which an error counts linearly: 95 % efficient for normal errors. Huber, 1964."""
_TUKEY = 4.685
"""Standard deviations from which on an error does not count at all, and ever less before: 95 % efficient for normal errors.
A. Beaton and J. Tukey, Technometrics 16(2), 1974.
"""
Robust = Literal["huber", "tukey"]
"""Whether samples that a model misses count linearly or stop to count."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """Parameters (p,) with their covariance (p, p); zero for columns that were not fitted."""

    parameters: Array
    covariance: Array
    active: Integers
    """Indices of the columns that were fitted."""
    noise: Array
    """(n,) standard deviation of the torque error of each joint on the training data."""
    weights: Array
    """(n,) of the joints."""
    trust: tuple[Array, ...] | None = None
    """(S, n) of each Rows: how much each sample counted in a robust fit; None where all count alike."""

    @property
    def deviations(self) -> Array:
        """(p,) standard deviations."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))


def least_squares(
    rows: Sequence[Rows], active: Sequence[int] | Integers, weights: Array | None = None, *, prior: Array | None = None,
    strength: float = RIDGE, robust: Robust | None = None, trust: Sequence[Array] | None = None,
) -> Estimate:  # fmt: skip
    """The fit of some columns; ordinary where `weights` (n,) are not given.

    `prior` (p,) and `strength` draw what the data cannot tell of bodies towards a value. `robust` weighs samples down that
    the model misses, see `_trusted`; `trust` is what an earlier robust fit found of these rows: it stays, or is where
    "tukey" begins. Raises IdentificationError where there are fewer samples than parameters.
    """
    act = np.asarray(active, dtype=np.int64)
    n, count = len(rows[0].values), sum(r.length for r in rows)
    if count * n <= len(act):
        raise IdentificationError(f"{count} samples of {n} joints are too few for {len(act)} parameters")
    joint_weights = np.ones(n) if weights is None else np.asarray(weights, dtype=float)
    start = np.zeros(rows[0].p) if prior is None else prior

    def solved(doubt: Sequence[Array] | None) -> tuple[Array, Array, Array]:
        return _solved(rows, act, joint_weights, start, strength, doubt)

    bent = np.ones(n)
    if robust is not None:
        trust, bent = _trusted(rows, lambda doubt: solved(doubt)[0], robust, trust)
    parameters, normal, drawn = solved(trust)
    errors = _errors(rows, parameters)
    noise = np.sqrt(sum(np.sum(e**2, axis=0) for e in errors) / count)
    if robust is not None and trust is not None:
        normal = solved([bent * t for t in trust])[1]
    covariance = _sandwich(rows, act, joint_weights, errors, trust, normal) + np.outer(drawn, drawn)
    return Estimate(parameters, covariance, act, noise, joint_weights, None if trust is None else tuple(trust))


def with_missed_form(estimate: Estimate, rows: Sequence[Rows], prior: Array, strength: float) -> Estimate:
    """The robust estimate with deviations that count what a model of another form than the robot bends.

    What it misses about reversals (friction of another form) is large and of one sign with the acceleration there: samples
    that it misses count linearly, and would not at all for Tukey's function. Where errors are chance both estimates agree to
    a few percent of their deviations, and where they are not, one of them at least is bent: J. Hausman, "Specification tests
    in econometrics", Econometrica 46(6), 1978. By as much they are unsure.
    """
    other = least_squares(
        rows, estimate.active, estimate.weights, prior=prior, strength=strength, robust="tukey", trust=estimate.trust
    )
    apart = other.parameters - estimate.parameters
    return replace(estimate, covariance=estimate.covariance + np.outer(apart, apart))


def _trusted(
    rows: Sequence[Rows],
    solved: Callable[[Sequence[Array] | None], Array],
    robust: Robust,
    trust: Sequence[Array] | None,
) -> tuple[Sequence[Array], Array]:
    """(S, n) of each Rows how much each sample counts, and (n,) by how much less the sum of a joint's scores changes with
    parameters than such weights say: their sum in the bread of a sandwich would leave it too thin.

    The mean slope of scores over the mean weight: P. Huber, "Robust regression", Annals of Statistics 1(5), 1973. Errors that
    stop to count do so from a fit whose errors count linearly, which has one minimum, by its spread: V. Yohai, "High
    breakdown-point and high efficiency robust estimates for regression", Annals of Statistics 15(2), 1987.
    """
    bends, rounds = list[Array](), 8  # each with weights by the errors of the one before
    for _ in range(0 if trust is not None and robust == "tukey" else rounds):
        sizes = [np.abs(e) / _spread(e) for e in _errors(rows, solved(trust))]
        trust, bends = [_huber(u) for u in sizes], [u < _HUBER for u in sizes]
    if robust == "tukey":
        spreads = [_TUKEY * _spread(e) for e in _errors(rows, solved(trust))]
        for _ in range(rounds):
            squares = [
                np.minimum((e / s) ** 2, 1.0) for e, s in zip(_errors(rows, solved(trust)), spreads, strict=True)
            ]
            trust, bends = [(1.0 - u) ** 2 for u in squares], [(1.0 - u) * (1.0 - 5.0 * u) for u in squares]
    total = sum(t.sum(axis=0) for t in trust or ())
    return trust or [], sum(b.sum(axis=0) for b in bends) / np.maximum(total, TINY)


def _errors(rows: Sequence[Rows], parameters: Array) -> list[Array]:
    """(S, n) of each Rows what parameters (p,) leave of the torque."""
    return [r.torque - r.predict(parameters) for r in rows]


def weighted_least_squares(
    rows: Sequence[Rows], active: Sequence[int] | Integers, *, prior: Array | None = None
) -> Estimate:
    """Least squares with each joint weighed by its own error variance, found by repetition."""
    moments = moments_of(rows)
    start = (np.zeros(rows[0].p) if prior is None else prior) * moments.scale
    variance = weighted_fit(moments, np.asarray(active, dtype=np.int64), start, RIDGE)[1]
    weights = 1.0 / variance / np.mean(1.0 / variance)
    return least_squares(rows, active, weights, prior=prior)


def with_doubtful_torque(estimate: Estimate, rows: Sequence[Rows], doubts: Array) -> Estimate:
    """The estimate with deviations that count how far the torque of each joint is known: `doubts` (n,), relative.

    Parameters are linear in torque: each joint's share of them is as doubtful as its torque constant.
    """
    moments, act = moments_of(rows), estimate.active
    gram = moments.weighted(estimate.weights)[0].sum(axis=0)[np.ix_(act, act)]
    cross = (estimate.weights * doubts)[:, None] * moments.cross.sum(axis=0)[:, act]
    shares = np.zeros((len(doubts), rows[0].p))
    shares[:, act] = solve(gram[None], cross, np.zeros(len(act)), RIDGE) / np.maximum(moments.scale[act], TINY)
    return replace(estimate, covariance=estimate.covariance + shares.T @ shares)


def instrumental(
    rows: Sequence[Rows], instruments: Sequence[Rows], active: Sequence[int] | Integers, weights: Array | None = None
) -> Array:
    """(p,) parameters that noise in the regressor does not bias, from instruments: a regressor with independent noise.

    Rows of the same motion repeated, or of a simulated one, serve. Janot, Vandanjon & Gautier, "A generic instrumental
    variable approach for industrial robot identification", IEEE TCST 22(1), 2014, eq. 17.
    """
    act = np.asarray(active, dtype=np.int64)
    left, right = crossed(rows, instruments, act)
    joint_weights = np.ones(left.shape[1]) if weights is None else weights
    parameters = np.zeros(rows[0].p)
    gram, cross = np.einsum("kjab,j->ab", left, joint_weights), np.einsum("kja,j->a", right, joint_weights)
    parameters[act] = np.linalg.lstsq(gram, cross, rcond=NEGLIGIBLE)[0]
    return parameters


def crossed(rows: Sequence[Rows], instruments: Sequence[Rows], active: Integers) -> tuple[Array, Array]:
    """(K, n, m, m) instruments with regressors, (K, n, m) with torque, of `active` columns (m,), for each Rows and joint."""
    m, n = len(active), len(rows[0].values)
    place = np.full(rows[0].p, -1)
    place[active] = np.arange(m)
    left, right = np.zeros((len(rows), n, m, m)), np.zeros((len(rows), n, m))
    for k, (r, z) in enumerate(zip(rows, instruments, strict=True)):
        for j, (c, v, w) in enumerate(zip(r.columns, r.values, z.values, strict=True)):
            own = np.flatnonzero(place[c] >= 0)
            at = place[c[own]]
            left[k, j][np.ix_(at, at)] = w[own] @ v[own].T
            right[k, j, at] = w[own] @ r.torque[:, j]
    return left, right


def _solved(
    rows: Sequence[Rows], act: Integers, weights: Array, prior: Array, strength: float, doubt: Sequence[Array] | None
) -> tuple[Array, Array, Array]:
    """(p,) parameters; the inverse of the normal matrix (len(act), len(act)) of what the data alone tell; (p,) how far from
    what these tell the parameters are that are drawn to zero (A. E. Hoerl and R. W. Kennard, Technometrics 12(1), 1970: the
    bias of a ridge), of which repeated logs would show nothing.
    """
    parts = rows if doubt is None else [r.scaled(np.sqrt(d)) for r, d in zip(rows, doubt, strict=True)]
    moments = moments_of(parts)
    gram, cross = (x.sum(axis=0) for x in moments.weighted(weights))
    scale = moments.scale[act]
    ridge = moments.ridge(strength)[act]
    x = solve(gram[np.ix_(act, act)], cross[act], prior[act] * scale, ridge)
    inverse = np.divide(1.0, scale, out=np.zeros(len(act)), where=scale > 0.0)
    parameters = np.zeros(len(prior))
    parameters[act] = x * inverse
    size = np.trace(gram[np.ix_(act, act)]) / len(act)
    # What draws effects to zero tells nothing of them, though it makes them look certain.
    alone = moments.with_shrinkage(0.0).weighted(weights)[0].sum(axis=0)[np.ix_(act, act)]
    normal = np.linalg.inv(alone + size * np.diag(ridge))
    drawn = np.zeros(len(prior))
    drawn[act] = inverse * (normal @ (moments.shrink[act] * np.diag(alone) * x))
    return parameters, normal * inverse[:, None] * inverse, drawn


def _spread(errors: Array) -> Array:
    """(n,) robust standard deviations, from the median."""
    return np.maximum(spread(errors), TINY)


def _huber(errors: Array) -> Array:
    return np.minimum(1.0, _HUBER / np.maximum(np.abs(errors), TINY))


def _sandwich(
    rows: Sequence[Rows], act: Integers, weights: Array, errors: Sequence[Array], doubt: Sequence[Array] | None,
    normal: Array,
) -> Array:  # fmt: skip
    """(p, p) covariance that allows for errors that last: normal @ (long-run variance of the scores) @ normal, as the
    squares of normal @ scores: products of large numbers that cancel would leave variances below zero.

    Newey & West, "A simple, positive semi-definite, heteroskedasticity and autocorrelation consistent covariance
    matrix", Econometrica 55(3), 1987: the Bartlett kernel, written as overlapping sums of `window` scores.
    """
    p, place = rows[0].p, np.full(rows[0].p, -1)
    place[act] = np.arange(len(act))
    squares, count = np.zeros((len(act), len(act))), sum(r.length for r in rows)
    window = max(_memory(e) for e in errors)
    for k, r in enumerate(rows):
        score = np.zeros((len(act), r.length))
        for j, (c, v) in enumerate(zip(r.columns, r.values, strict=True)):
            own = place[c] >= 0
            error = weights[j] * errors[k][:, j] * (1.0 if doubt is None else doubt[k][:, j])
            score[place[c[own]]] += v[own] * error
        total = np.cumsum(np.pad(score, ((0, 0), (window, window))), axis=1)
        sums = normal @ (total[:, window:] - total[:, :-window])
        squares += sums @ sums.T / window
    covariance = np.zeros((p, p))
    # As many samples were used up as parameters were fitted, in steps of the errors' memory.
    spent = min(len(act) / max(count * len(rows[0].values) / window, 1.0), 0.8)
    covariance[np.ix_(act, act)] = squares / (1.0 - spent)
    return covariance


def lasting_density(errors: Sequence[Array], rate: float) -> Array:
    """(n,) two-sided power density of errors (S, n) at low frequencies, (N m)^2/Hz: what hides parameters, white or not.

    By the overlapping sums of `_sandwich`.
    """
    window, count = max(_memory(e) for e in errors), sum(len(e) for e in errors)
    sums = (np.cumsum(np.pad(e, ((window, window), (0, 0))), axis=0) for e in errors)
    power = sum(np.sum((s[window:] - s[:-window]) ** 2, axis=0) for s in sums)
    return np.asarray(power) / (window * count * rate)


def _memory(errors: Array) -> int:
    """Samples over which errors (S, n) forget: four times the time in which their correlation falls below a half."""
    S = len(errors)
    centred = errors - errors.mean(axis=0)
    spectrum = np.abs(np.fft.rfft(centred, 2 * S, axis=0)) ** 2
    correlation = np.fft.irfft(spectrum, axis=0)[:S]
    correlation /= np.maximum(correlation[0], TINY)
    below = [int(np.argmax(c < 0.5)) or 1 for c in correlation.T]
    return int(np.clip(4 * max(below), 1, max(S // 8, 1)))
