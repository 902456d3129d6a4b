# SPDX-License-Identifier: Apache-2.0
"""What the recordings can tell and what they cannot, in words."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from scipy.linalg import qr

from trueup.arrays import Array
from trueup.loop.descent import Fit
from trueup.loop.uncertainty import intervals
from trueup.parameters import Parameter
from trueup.rounding import TINY
from trueup.verdicts import Verdict, advice, judged, vague

NO_EFFECT = 1e-3
UNSEEN = "no effect"
UNTOLD = (UNSEEN, "not identified")
"""Verdicts on what the recordings do not see, or hardly."""


def effects(fit: Fit) -> Array:
    """(n_free,) root mean square change of the residuals when a parameter crosses its box, in noise units."""
    return np.sqrt(np.mean(fit.jacobian**2, axis=0))


def verdicts(fit: Fit, covariance: Array) -> list[Verdict]:
    """One verdict for each free parameter."""
    spread = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    strength = effects(fit)
    low, high = intervals(fit, covariance)
    free = [p for p in fit.space.parameters if not p.frozen]
    values = fit.values[fit.space.free]
    return [
        _verdict(p, u, s, e, v, lo, hi)
        for p, u, s, e, v, lo, hi in zip(free, fit.unit, spread, strength, values, low, high, strict=True)
    ]


def _verdict(
    p: Parameter, unit: float, spread: float, strength: float, value: float, low: float, high: float
) -> Verdict:
    if strength < NO_EFFECT:
        return Verdict(UNSEEN, f"changing it changes nothing in these recordings{advice(p)}")
    return judged(p, unit, spread, value, low, high)


def unseen_directions(fit: Fit, covariance: Array, told: Collection[str] = ()) -> list[str]:
    """Sentences on combinations that the recordings do not see: what can be traded for what without a trace.

    What has no effect stands by itself: any mixture of two such would do, and none says anything. So it is with directions of
    which all mixtures are unseen: each is told by a parameter that no other one of them moves (a reduced basis of a null
    space; G. H. Golub and C. F. Van Loan, Matrix Computations, 2013, 5.4). Parameters that are `told` otherwise (limits) are
    left to the words beside them.
    """
    every = [p for p in fit.space.parameters if not p.frozen]
    here = np.array([p.name not in told for p in every], dtype=bool)
    some = (effects(fit) >= NO_EFFECT) & here
    free = [p for p, seen in zip(every, some, strict=True) if seen]
    variances, directions = np.linalg.eigh(covariance[np.ix_(some, some)])
    slopes = fit.space.unit_slope(fit.values)[some]
    sentences, alone = list[str](), [p for p, left in zip(every, here & ~some, strict=True) if left]
    unseen = directions[:, [vague(max(variance, 0.0) ** 0.5) for variance in variances]]
    for direction in _apart(unseen).T:
        chief = np.flatnonzero(np.abs(direction) > 0.35 * np.abs(direction).max())
        chief = chief[np.argsort(-np.abs(direction[chief]))][:4]
        if len(chief) == 1:
            alone.append(free[chief[0]])
        else:
            sentences.append(_sentence([free[i] for i in chief], direction[chief], slopes[chief]))
    return [*_unseen_alone(alone), *dict.fromkeys(sentences)]


def _unseen_alone(parameters: Sequence[Parameter]) -> list[str]:
    """What is unseen by itself, in a sentence for each motion that would tell it: joints of many drives fill pages else."""
    by_motion: dict[str, dict[str, None]] = {}
    for p in parameters:
        by_motion.setdefault(p.shown_by, {})[p.name] = None
    return [
        f"{', '.join(names)} {'are' if len(names) > 1 else 'is'} not seen by these recordings."
        f"{motion and f' {motion.capitalize()} would tell.'}"
        for motion, names in by_motion.items()
    ]


def _apart(directions: Array) -> Array:
    """(n, k) directions of the same space as orthonormal ones (n, k), each of which alone moves a parameter of its own."""
    count = directions.shape[1]
    if count == 0:
        return directions
    *_, order = qr(directions.T, mode="r", pivoting=True)
    own = order[:count]
    return np.asarray(np.linalg.solve(directions[own].T, directions.T).T, dtype=np.float64)


def _sentence(parameters: list[Parameter], direction: Array, slopes: Array) -> str:
    advice = next((f" {p.shown_by} would tell." for p in parameters if p.shown_by), "")
    names = [p.name for p in parameters]
    if len(parameters) == 2:
        a, b = parameters
        opposed = direction[0] * direction[1] < 0
        factor = abs(direction[0] * slopes[0]) / max(abs(direction[1] * slopes[1]), TINY)
        if a.scale == b.scale == "log":
            what = "product" if opposed else "ratio"
            if a.unit == b.unit and 0.3 < factor < 3:
                what = "sum" if opposed else "difference"
            return f"only the {what} of {names[0]} and {names[1]} is seen by these recordings.{advice}"
        sign = "+" if opposed else "-"
        return f"only the combination {names[0]} {sign} {factor:.2g} x {names[1]} is seen by these recordings.{advice}"
    return f"{', '.join(names[:-1])} and {names[-1]} can be traded for one another without a trace.{advice}"
