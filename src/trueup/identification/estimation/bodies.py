# SPDX-License-Identifier: Apache-2.0
"""Possible bodies that predict best: how much to trust the model file, and which effects stand beside them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.identification.estimation.consistent import ConsistentFit, columns_of, consistent_fit
from trueup.identification.estimation.moments import Moments
from trueup.identification.estimation.selection import PAYS, loss_of, surely_smaller
from trueup.identification.estimation.torque_model import TorqueModel

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

_PULLS = (1e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2)
_FIRST = 1
_SURE = 2.0
"""Standard deviations by which a drive's inertia must be below zero for it to be tried."""
_SMOOTH = ("viscous", "quadratic", "root", "offset", "gain")


@dataclass(frozen=True, eq=False)
class _Trial:
    """One way to fit, and how well it predicts what is left out."""

    columns: Integers
    lagging: tuple[int, ...]
    pull: int
    """Index into _PULLS."""
    loss: float
    errors: Array
    """(K, n) squared errors of the blocks."""
    whole: ConsistentFit
    """To all blocks."""
    fits: tuple[ConsistentFit, ...]
    """K, each without one block."""


class _Folds:
    """Normal equations with one block after the other left out."""

    def __init__(self, model: TorqueModel, moments: Moments, weights: Array, prior: Array) -> None:
        normal = moments.normal(weights)
        self.whole, self.others = normal.whole(), [normal.without(k) for k in range(len(normal.square))]
        self.model, self.moments, self.prior = model, moments, prior

    def trial(
        self, columns: Integers, lagging: tuple[int, ...], pull: int, near: ConsistentFit | None = None
    ) -> _Trial:  # fmt: skip
        """The errors of K fits on the block that each did not see; `near` is a similar fit to all blocks."""
        K, scale, fits = len(self.others), self.moments.scale, []
        errors = np.ones((K, self.model.tree.n))
        whole = consistent_fit(
            self.model, self.whole, columns, self.prior, pull=_PULLS[pull], lagging=lagging, near=near
        )
        for k in range(K if K > 1 else 0):
            fit = consistent_fit(
                self.model, self.others[k], columns, self.prior, pull=_PULLS[pull], lagging=lagging, near=whole
            )
            errors[k] = self.moments.take([k]).errors(fit.parameters * scale)[0]
            fits.append(fit)
        return _Trial(columns, lagging, pull, loss_of(errors), errors, whole, tuple(fits))

    def strict(self, active: Integers) -> _Trial:
        """With these effects alone."""
        return self.trial(np.asarray(active, dtype=np.int64), (), _FIRST)

    def widened(self, best: _Trial) -> _Trial:
        """With smooth friction and gains of all drives, where that surely predicts better."""
        columns = np.union1d(best.columns, columns_of(self.model, *_SMOOTH))
        wide = self.trial(columns, best.lagging, best.pull, best.whole)
        return wide if _pays(wide, best) else best

    def pulled(self, best: _Trial) -> _Trial:
        """With the pull that predicts best, step by step from the one at hand where that surely pays."""
        start = best.pull
        for step in (-1, 1):
            while best.pull == start or (best.pull > start) == (step > 0):
                if not 0 <= best.pull + step < len(_PULLS):
                    break
                new = self.trial(best.columns, best.lagging, best.pull + step, best.whole)
                if not _pays(new, best):
                    break
                best = new
        return best

    def released(self, best: _Trial) -> _Trial:
        """With drives whose torque falls with acceleration, where that is certain and surely predicts better."""
        lags = columns_of(self.model, "lag")
        drives = [self.model.effects[int(k) - 10 * self.model.tree.n][0] for k in lags]
        if not drives or len(best.fits) < 2:
            return best
        trial = self.trial(best.columns, tuple(drives), best.pull, best.whole)
        found = np.array([fit.parameters[lags] for fit in trial.fits])
        K = len(found)
        deviations = np.sqrt((K - 1) * found.var(axis=0))  # the jackknife's
        sure = tuple(d for d, m, s in zip(drives, found.mean(axis=0), deviations, strict=True) if m < -_SURE * s)
        if not sure:
            return best
        trial = self.trial(best.columns, sure, best.pull, best.whole)
        return trial if _pays(trial, best) else best


def _pays(new: _Trial, old: _Trial) -> bool:
    return new.loss < old.loss - PAYS and surely_smaller(new.errors, old.errors)


@dataclass(frozen=True, eq=False)
class Bodies:
    """The consistent fit that predicts best, its pull towards the model file, and the same fits without one block each."""

    fit: ConsistentFit
    pull: float
    folds: tuple[ConsistentFit, ...]
    """K, none where there is but one block."""


def cross_validated_fit(
    model: TorqueModel, moments: Moments, weights: Array, active: Integers, prior: Array
) -> Bodies:  # fmt: skip
    """The consistent fit that predicts best what is left out.

    Possible bodies bend less than free combinations of parameters: smooth friction of all drives, and gains, join the
    `active` effects where what is left out is predicted better with them, and so does torque that falls with acceleration.
    """
    folds = _Folds(model, moments, weights, prior)
    best = folds.released(folds.strict(active))
    best = folds.pulled(folds.widened(best))
    return Bodies(best.whole, _PULLS[best.pull], best.fits)


def first_bodies(model: TorqueModel, moments: Moments, weights: Array, active: Integers, prior: Array) -> Array:
    """(p,) possible bodies with gains where they pay, at the usual pull: good enough for the loads that gears carry."""
    folds = _Folds(model, moments, weights, prior)
    return folds.widened(folds.strict(active)).whole.parameters
