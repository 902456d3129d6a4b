# SPDX-License-Identifier: Apache-2.0
"""Implicit filtering by ask and tell: least squares down a bowl with stairs and cracks, by differences as wide as these.

P. Gilmore and C. T. Kelley, SIAM J. Optimization 5(2), 1995; for least squares C. T. Kelley, Implicit Filtering, 2011.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from trueup.arrays import Array
from trueup.errors import CalibrationError
from trueup.rounding import NEGLIGIBLE, TINY
from trueup.search.bounded_step import damped_step
from trueup.search.robust import robust_losses, robust_weights
from trueup.search.search import SearchState, saved_point


def _half(residual: Array) -> float:
    return 0.5


@dataclass
class ImplicitFiltering:
    """Minimises the robust sum of squared residuals over the unit box where slopes at a point tell little.

    Rate limits, delays, dry friction and contacts act from one step of a simulation to the next, so the loss has stairs and
    cracks, and a slope taken over less than a stair is that of its tread. Here slopes are central differences along
    directions that all change the residuals alike, first by far more than noise does, then by less and less. The lowest of
    all points seen is where the next round begins; where there is none, the width shrinks.
    """

    start: Array
    """(n,) where to begin, in [0, 1]."""
    bend: float = np.inf
    """Residuals far beyond it count less (see robust.py)."""
    jacobian: Array | None = None
    """(m, n) slopes at the start, if known: they tell how far to go in which direction."""
    residual: Array | None = None
    """(m,) at the start, if known."""
    chance: Callable[[Array], float] = _half
    """Of residuals (m,): how much fitting one parameter to noise alone lowers the loss. Gains below it are none."""
    widths: tuple[float, ...] = (128.0, 32.0, 8.0, 2.0)
    """Half the differences, in standard deviations of the estimate."""
    tries: int = 4
    """Rounds at one width at most."""
    directions: int = 10
    """At most so many in a round, drawn anew each time; others keep the slopes that they had."""
    reach: float = 0.1
    """No difference is wider than this share of the box to either side."""
    dampings: tuple[float, ...] = (1e-6, 0.1, 1.0, 10.0)
    """Of the steps tried side by side."""
    seed: int = 0

    point: Array = field(init=False)
    loss: float = field(init=False, default=np.inf)
    _level: int = field(init=False, default=0)
    _try: int = field(init=False, default=0)
    _stencil: tuple[Array, Array] | None = field(init=False, default=None)
    """(2 k, n) points around the point and their residuals (2 k, m), once told."""

    def __post_init__(self) -> None:
        """Begins at the start."""
        self.point = np.clip(np.asarray(self.start, dtype=np.float64), 0.0, 1.0)
        self._rng = np.random.default_rng(self.seed)
        if self.residual is not None:
            self.loss = float(robust_losses(self.residual[None], self.bend)[0])

    @property
    def done(self) -> str:
        """Why the search has ended, or ''."""
        return "converged: nothing lower at any width" if self._level >= len(self.widths) else ""

    @property
    def best(self) -> tuple[Array, float]:
        """The lowest point and its loss."""
        return self.point, self.loss

    def ask(self) -> Array:
        """Pairs of points around the point (and the point itself until it is known), or steps with the slopes they gave."""
        if self._stencil is not None:
            return self._steps()
        pairs = self.around(self.widths[self._level], self.directions if self.jacobian is not None else len(self.point))
        return pairs if self.residual is not None else np.concatenate([self.point[None], pairs])

    def tell(self, candidates: Array, losses: Array) -> None:
        """Residuals (b, m) of the candidates; rows with NaN are failed evaluations.

        Raises CalibrationError where the start itself fails.
        """
        points, residuals = np.array(candidates), np.asarray(losses)
        if self._stencil is None and self.residual is None:
            if not np.isfinite(residuals[0]).all():
                raise CalibrationError("the simulation fails at the start values; check the model and the start state")
            self.residual = np.array(residuals[0])
            self.loss = float(robust_losses(self.residual[None], self.bend)[0])
            points, residuals = points[1:], residuals[1:]
        if self._stencil is None:
            self.see(points, residuals, self.widths[self._level])
            self._stencil = points, np.array(residuals)
        else:
            self._go(np.concatenate([self._stencil[0], points]), np.concatenate([self._stencil[1], residuals]))
            self._stencil = None

    def state(self) -> SearchState:
        """The point, the width and the generator; slopes are taken anew."""
        return {
            "point": self.point.tolist(), "loss": self.loss, "level": self._level, "try": self._try,
            "generator": self._rng.bit_generator.state,
        }  # fmt: skip

    def resume(self, state: SearchState) -> None:
        """Goes on from `state`. Raises CalibrationError where it belongs to another number of parameters."""
        self.point, self.loss = saved_point(state, self.point), float(state["loss"])
        self._level, self._try = int(state["level"]), int(state["try"])
        self._rng.bit_generator.state = state["generator"]
        self.jacobian = self.residual = self._stencil = None

    def around(self, width: float, most: int) -> Array:
        """(2 k, n) points around the point, each half the mirror image of the other: k <= `most` random directions, which
        are orthogonal where all change the residuals alike, `width` standard deviations away but within reach.
        """
        n = len(self.point)
        away = (self._frame(width) @ np.linalg.qr(self._rng.standard_normal((n, min(n, most))))[0]).T
        away /= np.maximum(1.0, np.abs(away).max(axis=1, keepdims=True) / self.reach)
        return np.clip(np.concatenate([self.point + away, self.point - away]), 0.0, 1.0)

    def _frame(self, width: float) -> Array:
        """(n, n) columns: orthogonal directions, each as long as differences go."""
        if self.jacobian is None or self.residual is None:
            return self.reach * np.eye(len(self.point))
        size = 2.0 * max(self.chance(self.residual), TINY)
        weighted = self.jacobian * robust_weights(self.residual, self.bend)[:, None]
        values, frame = np.linalg.eigh(self.jacobian.T @ weighted / size)
        return frame * np.minimum(width / np.sqrt(np.maximum(values, NEGLIGIBLE)), self.reach)

    @property
    def slopes(self) -> Array:
        """(m, n) as they are known. Raises CalibrationError before anything was told."""
        if self.jacobian is None:
            raise CalibrationError("slopes asked before any pair was told")
        return self.jacobian

    def see(self, points: Array, residuals: Array, width: float) -> None:
        """Slopes as pairs of some width show them; across directions that they do not span the old ones stay."""
        k = len(points) // 2
        moved, changed = points[:k] - points[k:], residuals[:k] - residuals[k:]
        told = np.isfinite(changed).all(axis=1)
        moved, changed = moved[told], changed[told]
        old = np.zeros((residuals.shape[1], len(self.point))) if self.jacobian is None else self.jacobian
        inverse = np.linalg.inv(self._frame(width))
        # The least change of the slopes in the metric of the frame that explains the pairs.
        self.jacobian = old + (changed - moved @ old.T).T @ np.linalg.pinv((moved @ inverse.T).T) @ inverse

    def _steps(self) -> Array:
        """(b, n) steps of several lengths, from the residual at the point and from one smoothed over the stencil."""
        if self.jacobian is None or self.residual is None or self._stencil is None:
            raise CalibrationError("steps asked before the pairs were told")
        weighted = self.jacobian * robust_weights(self.residual, self.bend)[:, None]
        curvature = self.jacobian.T @ weighted
        told = self._stencil[1][np.isfinite(self._stencil[1]).all(axis=1)]
        smooth = 0.5 * (self.residual + told.mean(axis=0)) if len(told) else self.residual
        slopes = [weighted.T @ residual for residual in (self.residual, smooth)]
        steps = [damped_step(curvature, slope, d, self.point) for slope in slopes for d in self.dampings]
        return np.clip(self.point + np.array(steps), 0.0, 1.0)

    def _go(self, points: Array, residuals: Array) -> None:
        """To the lowest of all points if it is lower; else, or after enough tries, to the next width."""
        losses = np.nan_to_num(robust_losses(residuals, self.bend), nan=np.inf, posinf=np.inf)
        k = int(losses.argmin())
        worth = 0.0 if self.residual is None else self.chance(self.residual)
        lower = losses[k] < self.loss - worth
        if losses[k] < self.loss:
            self.point, self.loss, self.residual = points[k], float(losses[k]), residuals[k]
        self._try += 1
        if not lower or self._try >= self.tries:
            self._level, self._try = self._level + 1, 0
