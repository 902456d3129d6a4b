# SPDX-License-Identifier: Apache-2.0
"""Chooses the parameters that the recordings can support: by what they can see, and by the error on what was left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.loop.descent import Fit
from trueup.loop.identifiability import NO_EFFECT, effects
from trueup.loop.problem import Problem
from trueup.loop.validate import left_out_errors
from trueup.parameters import Parameter
from trueup.search.bounded_step import damped_step, gain
from trueup.search.robust import robust_losses, robust_weights

Array = NDArray[np.float64]

_UNSEEN = 0.15  # standard deviation, as a share of the box, from which a parameter must show that it helps
_HELPS = 0.003  # what is optional, or hardly seen, must lower the left-out error by this share to stay


@dataclass(frozen=True)
class Choice:
    """Parameters to freeze at their nominal value, and the sentences that say why."""

    freeze: tuple[str, ...]
    notes: tuple[str, ...]
    vague: tuple[str, ...] = ()
    """Kept because left-out recordings are replayed better with them, though their intervals are wide."""


def choose(problem: Problem, fit: Fit, covariance: Array) -> tuple[Choice, Choice]:
    """What the recordings cannot tell, and what they do not need, tried in the order of least to lose.

    Optional structures (all parameters of one `optional` name) go first, then parameters whose interval is wide. With three
    recordings or more each is frozen only if that does not raise the error on recordings left out of the fit: what
    is known vaguely may help all the same, where a shipped value is plainly wrong.
    """
    strength = dict(zip((p.name for p in fit.space.parameters if not p.frozen), effects(fit), strict=True))
    # What has no effect at all costs nothing, and may have one elsewhere (a foot that sticks, a limit not reached).
    wide = _not_missed(problem, fit, [p for p in _wide(fit, covariance) if strength[p.name] >= NO_EFFECT])
    if len(problem.trials) < 3:
        return Choice(tuple(p.name for p in wide), tuple(_untold(p) for p in wide)), Choice((), ())
    judge = _Judge(problem, fit)
    useless = [note for s in judge.structures for note in judge.structure(s)]
    frozen = set(judge.frozen)
    unseen = [p for p in wide if p.name not in frozen and judge.idle(p)]
    vague = tuple(p.name for p in wide if p.name not in judge.frozen)
    return (
        Choice(tuple(p.name for p in unseen), tuple(_untold(p) for p in unseen), vague),
        Choice(tuple(n for n in judge.frozen if n in frozen), tuple(useless)),
    )


def _untold(p: Parameter) -> str:
    return f"{p.name} kept at {p.nominal:.4g} {p.unit}: these recordings cannot tell it"


def _wide(fit: Fit, covariance: Array) -> list[Parameter]:
    """Parameters that the recordings hardly see, one after the other: freezing one may make its partner visible.

    Of two that cannot be told apart the one with the weaker effect comes first.
    """
    free = [p for p in fit.space.parameters if not p.frozen]
    strength = effects(fit)
    precision = np.linalg.inv(covariance + 1e-14 * np.eye(len(covariance)))
    kept = list(range(len(free)))
    dropped: list[Parameter] = []
    while kept:
        spread = np.sqrt(np.maximum(np.diag(np.linalg.inv(precision[np.ix_(kept, kept)])), 0.0))
        loose = [i for i, s in zip(kept, spread, strict=True) if s > _UNSEEN]
        if not loose:
            break
        worst = min(loose, key=lambda i: strength[i])
        kept.remove(worst)
        dropped.append(free[worst])
    return dropped


def _not_missed(problem: Problem, fit: Fit, wide: Sequence[Parameter]) -> list[Parameter]:
    """Those without which, at their nominal values, the recordings are replayed as well once the others have settled.

    Slopes alone do not tell: a friction that is found to be a thousandth of the shipped one has none any more.
    """
    if not wide:
        return []
    free = [p for p in fit.space.parameters if not p.frozen]
    places = [free.index(p) for p in wide]
    nominal = np.clip(fit.space.to_unit(fit.space.nominal), 0.0, 1.0)
    points = np.repeat(fit.unit[None], len(wide), axis=0)
    points[np.arange(len(wide)), places] = nominal[places]
    residuals = problem.residuals(fit.space.from_unit(points))
    curvature = fit.jacobian.T @ (fit.jacobian * fit.weights[:, None])
    worth = problem.chance(fit.residual) * len(free)
    kept = []
    for p, place, point, residual in zip(wide, places, points, residuals, strict=True):
        others = np.arange(len(free)) != place
        slope = (robust_weights(residual[None], fit.bend)[0] * residual) @ fit.jacobian[:, others]
        inner = curvature[np.ix_(others, others)]
        step = damped_step(inner, slope, 1e-6, point[others])
        left = float(robust_losses(residual[None], fit.bend)[0]) - gain(inner, slope, step)
        if left < fit.loss + worth:
            kept.append(p)
    return kept


class _Judge:
    """Freezes parameters one set after the other where the recordings left out of the fit do not miss them."""

    def __init__(self, problem: Problem, fit: Fit) -> None:
        self.free = [p for p in fit.space.parameters if not p.frozen]
        self.structures = sorted({p.optional for p in self.free if p.optional})
        self.frozen: list[str] = []
        self._problem, self._fit = problem, fit
        self._nominal = fit.space.to_unit(fit.space.nominal)
        self._unit = problem.main[1]
        self.error = self._error([])

    def structure(self, name: str) -> list[str]:
        """Judges one optional structure; says what came of it."""
        before, without = self._try([p.name for p in self.free if p.optional == name])
        if without < before * (1.0 + _HELPS):
            return [
                f"{name} left out: without it the left-out replay error is {without:.4g} {self._unit}, with it {before:.4g}"
            ]
        return [f"{name} kept: left-out replay error {before:.4g} {self._unit} with it, {without:.4g} without"]

    def idle(self, p: Parameter) -> bool:
        """Whether one parameter is not missed."""
        before, without = self._try([p.name])
        return without < before * (1.0 + _HELPS)

    def _try(self, names: list[str]) -> tuple[float, float]:
        """Errors before and without; `names` are frozen if they are not missed."""
        before, without = self.error, self._error([*self.frozen, *names])
        if without < before * (1.0 + _HELPS):
            self.frozen += names
            self.error = min(before, without)
        return before, without

    def _error(self, frozen: list[str]) -> float:
        held = np.where([p.name in frozen for p in self.free], self._nominal, np.nan)
        return pooled(left_out_errors(self._problem, self._fit, [held]))[0]


def pooled(errors: Array) -> Sequence[float]:
    """One number a variant: the geometric mean, so that a recording which nothing explains (a collision) does not rule."""
    logs = np.log(np.maximum(errors, 1e-12))
    return [float(np.exp(np.mean(row))) for row in logs]
