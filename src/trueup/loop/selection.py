# SPDX-License-Identifier: Apache-2.0
"""Chooses the parameters that the recordings can support: by what they can see, and by the error on what was left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.loop.fit import Fit
from trueup.loop.identifiability import effects
from trueup.loop.problem import Problem
from trueup.loop.validate import left_out_errors

Array = NDArray[np.float64]

_UNSEEN = 0.15  # standard deviation, as a share of the box, from which a parameter is not worth fitting
_HELPS = 0.003  # an optional structure must lower the left-out error by this share to stay


@dataclass(frozen=True)
class Choice:
    """Parameters to freeze at their nominal value, and the sentences that say why."""

    freeze: tuple[str, ...]
    notes: tuple[str, ...]


def unsupported(fit: Fit, covariance: Array) -> Choice:
    """Parameters that the recordings cannot see, one after the other: freezing one may make its partner visible.

    Of two that cannot be told apart the one with the weaker effect is frozen.
    """
    free = [p for p in fit.space.parameters if not p.frozen]
    strength = effects(fit)
    precision = np.linalg.inv(covariance + 1e-14 * np.eye(len(covariance)))
    kept = list(range(len(free)))
    dropped: list[int] = []
    while kept:
        spread = np.sqrt(np.maximum(np.diag(np.linalg.inv(precision[np.ix_(kept, kept)])), 0.0))
        loose = [i for i, s in zip(kept, spread, strict=True) if s > _UNSEEN]
        if not loose:
            break
        worst = min(loose, key=lambda i: strength[i])
        kept.remove(worst)
        dropped.append(worst)
    notes = tuple(
        f"{free[i].name} kept at {free[i].nominal:.4g} {free[i].unit}: these recordings cannot tell it" for i in dropped
    )
    return Choice(tuple(free[i].name for i in dropped), notes)


def unhelpful(problem: Problem, fit: Fit) -> Choice:
    """Optional structures (all parameters of one `optional` name) that do not lower the left-out error."""
    if len(problem.trials) < 3:
        return Choice((), ())
    free = [p for p in fit.space.parameters if not p.frozen]
    structures = sorted({p.optional for p in free if p.optional})
    if not structures:
        return Choice((), ())
    nominal = fit.space.to_unit(fit.space.nominal)
    variants: list[Array | None] = [None]
    for structure in structures:
        variants.append(np.where([p.optional == structure for p in free], nominal, np.nan))
    errors = pooled(left_out_errors(problem, fit, variants))
    freeze: list[str] = []
    notes: list[str] = []
    unit = problem.main[1]
    for structure, error in zip(structures, errors[1:], strict=True):
        if error < errors[0] * (1.0 + _HELPS):
            freeze += [p.name for p in free if p.optional == structure]
            notes.append(
                f"{structure} left out: without it the left-out replay error is {error:.4g} {unit}, with it {errors[0]:.4g}"
            )
        else:
            notes.append(f"{structure} kept: left-out replay error {errors[0]:.4g} {unit} with it, {error:.4g} without")
    return Choice(tuple(freeze), tuple(notes))


def pooled(errors: Array) -> Sequence[float]:
    """One number a variant: the geometric mean, so that a recording which nothing explains (a collision) does not rule."""
    logs = np.log(np.maximum(errors, 1e-12))
    return [float(np.exp(np.mean(row))) for row in logs]
