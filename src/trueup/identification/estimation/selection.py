# SPDX-License-Identifier: Apache-2.0
"""Which effects, weights and trust in the model file predict best what was left out: blocked cross-validation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueup.identification.estimation.moments import RIDGE, Moments, solve
from trueup.identification.estimation.neighbours import Neighbours

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

PAYS = 0.004
"""The least gain in the logarithm of the squared error for which the model is made larger."""
_SURE = 1.0
"""Standard errors by which a gain must exceed zero."""
_EXPONENTS = (1.0, 0.5, 0.0)
_STRENGTHS = (RIDGE, 1e-6, 1e-5, 1e-4, 1e-3)
_DRAWN = (1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0)
_LOOSER, _FAR = (0.1, 0.01, 0.001), 0.05
"""Shares of the pull of effects to zero that are tried, and the gain for which they are taken: less than that was lost
again on motion of another kind (ten random arms)."""
_FREE = 0.5 * PAYS
"""What a stronger pull to possible bodies may cost in the logarithm of the squared error."""


@dataclass(frozen=True, eq=False)
class Choice:
    """A model: which columns, how joints are weighed, how much the prior counts; and how well it predicts."""

    active: Mask
    """(p,)."""
    exponent: float
    """Joints are weighed by noise variance ** -exponent: 1 is weighted, 0 is ordinary least squares."""
    strength: float
    """Of the ridge that draws bodies towards the prior."""
    variance: Array
    """(n,) error variance of each joint, (N m)^2: what the weights are made of."""
    loss: float = float("inf")
    errors: Array | None = None
    """(K, n) squared errors of the blocks, each predicted from all others."""

    @property
    def weights(self) -> Array:
        """(n,) weights of the joints, 1 on average."""
        weights = self.variance**-self.exponent
        return weights / weights.mean()


@dataclass(frozen=True)
class Alternative:
    """Columns that may be added together, and the columns that they take the place of."""

    name: str
    columns: tuple[int, ...]
    instead: tuple[int, ...] = ()


def evaluated(moments: Moments, prior: Array, choice: Choice) -> Choice:
    """The choice with its errors on blocks that were left out, and its loss."""
    act = np.flatnonzero(choice.active)
    part = moments.only(act)
    gram, cross = part.weighted(choice.weights)
    x = solve(gram.sum(axis=0) - gram, cross.sum(axis=0) - cross, prior[..., act], part.ridge(choice.strength))
    errors = part.errors(x)
    return replace(choice, loss=loss_of(errors), errors=errors)


def loss_of(errors: Array) -> float:
    """Half the logarithm of the pooled squared error, half the mean one of the joints: no joint is given up for another."""
    each = errors.sum(axis=0)
    return float(0.5 * np.log(each.sum()) + 0.5 * np.mean(np.log(np.maximum(each, 1e-300))))


def weighed(moments: Moments, prior: Array, choice: Choice, passes: int = 4) -> Choice:
    """The choice with error variances that fit it, found by repeated weighted least squares."""
    act = np.flatnonzero(choice.active)
    part = moments.only(act)
    for _ in range(passes):
        gram, cross = (x.sum(axis=0) for x in part.weighted(choice.weights))
        x = solve(gram, cross, prior[act], part.ridge(choice.strength))
        floor = 1e-12 * moments.square.sum() / moments.count.sum()
        variance = np.maximum(part.errors(x).sum(axis=0) / moments.count.sum(), floor)
        choice = replace(choice, variance=variance)
    return choice


def grown(
    moments: Moments, prior: Array, choice: Choice, alternatives: Sequence[Alternative],
    told: Callable[[str, float], None] | None = None,
) -> Choice:  # fmt: skip
    """The choice enlarged, one alternative at a time, always by the one that predicts best, as long as that pays."""
    rest = list(alternatives)
    while rest:
        tried = _with_each(moments, prior, choice, rest)
        sure = [_surely_better(t, choice) for t in tried]
        best = min((k for k, good in enumerate(sure) if good), key=lambda k: tried[k].loss, default=None)
        if best is None or tried[best].loss > choice.loss - PAYS:
            return choice
        if told is not None:
            told(rest[best].name, choice.loss - tried[best].loss)
        # What does not pay alone now will hardly pay beside the best one.
        rest = [a for k, a in enumerate(rest) if k != best and tried[k].loss < choice.loss - 0.5 * PAYS]
        choice = tried[best]
    return choice


def _with_each(moments: Moments, prior: Array, choice: Choice, rest: Sequence[Alternative]) -> list[Choice]:
    """The choice with each of the alternatives, evaluated; single columns all at once."""
    made = [replace(choice, active=_with(choice.active, a)) for a in rest]
    single = [k for k, a in enumerate(rest) if len(a.columns) == 1 and not a.instead]
    if len(single) > 1:
        columns = np.array([rest[k].columns[0] for k in single])
        errors = _beside(moments, prior, choice).larger(columns)
        for k, error in zip(single, errors, strict=True):
            made[k] = replace(made[k], loss=loss_of(error), errors=error)
    others = set(range(len(rest))) - set(single if len(single) > 1 else [])
    for k in others:
        made[k] = evaluated(moments, prior, made[k])
    return made


def _beside(moments: Moments, prior: Array, choice: Choice) -> Neighbours:
    return Neighbours.of(moments, np.flatnonzero(choice.active), choice.weights, prior, choice.strength)


def trimmed(moments: Moments, prior: Array, choice: Choice, columns: Sequence[int]) -> Choice:
    """The choice without those of `columns` that predict nothing, taken away one by one, the least useful first."""
    rest = [k for k in columns if choice.active[k]]
    while rest:
        places = np.searchsorted(np.flatnonzero(choice.active), rest)
        errors = _beside(moments, prior, choice).smaller(places)
        losses = [loss_of(error) for error in errors]
        best = int(np.argmin(losses))
        if losses[best] > choice.loss:
            return choice
        gone = replace(choice, active=_without(choice.active, rest[best]), loss=losses[best], errors=errors[best])
        # All that do no harm alone are candidates; the rest is settled.
        rest = [k for k, loss in zip(rest, losses, strict=True) if loss <= choice.loss + PAYS and k != rest[best]]
        choice = gone
    return choice


def balanced(moments: Moments, prior: Array, choice: Choice) -> Choice:
    """The choice with the weighting and the trust in the prior that predict best."""
    choice = evaluated(moments, prior, weighed(moments, prior, choice))
    tried = [evaluated(moments, prior, replace(choice, exponent=e)) for e in _EXPONENTS]
    choice = min(tried, key=lambda c: c.loss)
    tried = [evaluated(moments, prior, replace(choice, strength=s)) for s in _STRENGTHS]
    best = min(tried, key=lambda c: c.loss)
    return best if best.loss < choice.loss - 0.5 * PAYS else choice


def drawn(moments: Moments, priors: Array, choice: Choice) -> Choice:
    """The choice drawn as strongly to possible bodies as predicts no worse what is left out; `priors` (K, p) did not see it.

    Blocks of one log hardly ask what other motion will: directions that the log tells badly cost little here, and there much.
    """
    free = evaluated(moments, priors, replace(choice, strength=RIDGE))
    tried = [evaluated(moments, priors, replace(choice, strength=s)) for s in _DRAWN]
    best = min(free, *tried, key=lambda c: c.loss)
    good = [c for c in (free, *tried) if c.loss <= best.loss + _FREE]
    return replace(choice, strength=good[-1].strength)


def loosened(moments: Moments, prior: Array, choice: Choice) -> tuple[Moments, Choice, float]:
    """Moments and choice with effects drawn less to zero where that predicts far better, and the share of the pull left.

    The pull serves motion that the log does not show; a log that loses much by it tells its effects by itself.
    """
    left = 1.0
    for share in _LOOSER:
        new = evaluated(moments.loosened(share), prior, choice)
        if new.loss > choice.loss - _FAR or not _surely_better(new, choice):
            break
        left, choice = share, new
    return moments.loosened(left), choice, left


def _surely_better(new: Choice, old: Choice) -> bool:
    return surely_smaller(new.errors, old.errors)


def pays(new: Choice, old: Choice) -> bool:
    """Whether the one predicts better than the other by as much as a larger model must, and surely."""
    return new.loss < old.loss - PAYS and _surely_better(new, old)


def surely_smaller(new: Array | None, old: Array | None, sure: float = _SURE) -> bool:
    """Whether the gain exceeds `sure` times its standard error over the blocks (K, n): no single stretch of time decides."""
    if new is None or old is None:
        return True
    gain = 0.5 * (old - new).sum(axis=1) / old.sum()
    gain += 0.5 * ((old - new) / old.sum(axis=0)).mean(axis=1)
    return bool(gain.mean() > sure * gain.std(ddof=1) / np.sqrt(len(gain)))


def _with(active: Mask, alternative: Alternative) -> Mask:
    mask = active.copy()
    mask[list(alternative.instead)] = False
    mask[list(alternative.columns)] = True
    return mask


def _without(active: Mask, column: int) -> Mask:
    mask = active.copy()
    mask[column] = False
    return mask
