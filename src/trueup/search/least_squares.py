# SPDX-License-Identifier: Apache-2.0
"""Bounded Gauss-Newton / Levenberg-Marquardt by ask and tell: one batch holds all finite-difference columns.

D. Marquardt, SIAM J. 11(2), 1963, with projection onto the box; robust loss after P. Huber's pseudo-Huber form.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from trueup.errors import CalibrationError
from trueup.search.search import SearchState

Array = NDArray[np.float64]

_MOST_SHRINK = 5.0
# Damping factors tried side by side: one batch of steps instead of one step after the other.
_LADDER = (0.03, 1.0, 30.0)


@dataclass
class LeastSquares:
    """Minimises the robust sum of squared residuals over the unit box.

    `log_range` (n,) is ln(upper / lower) of parameters on a log scale, 0 for the others: such parameters mostly act in
    proportion to their value, so a step may also be taken in the value instead of its logarithm.
    """

    start: Array
    """(n,) where to begin, in [0, 1]."""
    log_range: Array
    difference: float = 1e-3
    """Largest finite-difference step, as a share of the box."""
    robust: float = 3.0
    """Residuals beyond this many robust standard deviations count less; inf for plain least squares."""
    tolerance: float = 1e-3
    """Ends when a step lowers the loss by less than this many times `worth`, or than this share if `worth` is None."""
    worth: Callable[[Array], float] | None = None
    """Of residuals (m,): by how much noise alone changes the loss when all parameters are fitted. A step that gains
    far less than that moves the estimates by far less than their uncertainty."""
    max_iterations: int = 30
    patience: int = 3
    """Ends after this many batches of steps without any descent."""
    share: float = 2e-3
    """With `worth`: a gain above this share of the loss is never negligible."""
    least_damping: float = 1e-9
    """Damping never goes below: it holds combinations that are weakly seen where they are."""
    nudge: float = 0.05
    """How far a start on a bound is moved inside: there a logarithmic parameter has almost no slope."""

    point: Array = field(init=False)
    loss: float = field(init=False, default=np.inf)
    iteration: int = field(init=False, default=0)
    jacobian: Array | None = field(init=False, default=None)
    """(m, n) d residual / d unit at `point` once the columns are told."""
    residual: Array | None = field(init=False, default=None)
    """(m,) at `point`."""
    delta: float = field(init=False, default=np.inf)
    """Present bend of the robust loss, in residual units."""
    reuse: int = 5
    """How many steps in a row may be taken with slopes that are only corrected by what the last step showed."""
    _fresh: bool = field(init=False, default=True)
    _reused: int = field(init=False, default=0)
    _short: int = field(init=False, default=0)
    _damping: float = field(init=False, default=1e-2)
    _stale: int = field(init=False, default=0)
    _done: str = field(init=False, default="")
    _steps: Array = field(init=False, default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        """Moves the start off the bounds."""
        self.start = np.asarray(self.start, dtype=np.float64)
        self.point = np.clip(self.start, self.nudge, 1.0 - self.nudge)

    @property
    def done(self) -> str:
        """Why the search has ended, or ''."""
        return self._done

    @property
    def best(self) -> tuple[Array, float]:
        """The point and its loss."""
        return self.point, self.loss

    def ask(self) -> Array:
        """Finite-difference columns around the point (with the point itself first), or steps of several lengths."""
        if self.jacobian is None:
            inward = np.where(self.point > 0.5, -1.0, 1.0)
            self._steps = inward * self._difference()
            return np.concatenate([self.point[None], self.point + np.diag(self._steps)])
        return self._trial_points()

    def tell(self, candidates: Array, losses: Array) -> None:
        """Residuals (b, m) of the candidates; rows with NaN are failed evaluations."""
        residuals = np.asarray(losses)
        if self.jacobian is None:
            self._take_jacobian(residuals)
        else:
            self._take_step(candidates, residuals)

    def state(self) -> SearchState:
        """The point, its damping and counters; the next ask is for the columns around it."""
        return {
            "point": self.point.tolist(), "loss": self.loss, "iteration": self.iteration, "damping": self._damping,
            "stale": self._stale, "short": self._short, "done": self._done,
        }  # fmt: skip

    def resume(self, state: SearchState) -> None:
        """Goes on from `state`. Raises CalibrationError where it belongs to another number of parameters."""
        point = np.asarray(state["point"], dtype=np.float64)
        if point.shape != self.point.shape:
            raise CalibrationError(f"the saved search has {len(point)} parameters, this one {len(self.point)}")
        self.point, self.loss, self.iteration = point, float(state["loss"]), int(state["iteration"])
        self._damping, self._stale = float(state["damping"]), int(state["stale"])
        self._short, self._done = int(state["short"]), str(state["done"])

    def _difference(self) -> float:
        """Far from the recordings a coarse difference sees past the ripples of friction; at the noise it must be exact,
        or weakly seen directions take the errors of the strong ones for their own slope.
        """
        if self.residual is None:
            return self.difference
        rough = 1.4826 * float(np.median(np.abs(self.residual)))
        return float(np.clip(1e-4 * rough**2, 1e-4, self.difference))

    def _take_jacobian(self, residuals: Array) -> None:
        base = residuals[0]
        if not np.isfinite(base).all():
            raise CalibrationError("the simulation fails at the start values; check the model and the start state")
        columns = (residuals[1:] - base) / self._steps[:, None]
        # A column whose simulation failed tells nothing this time; the parameter rests until the next round.
        columns[~np.isfinite(columns).all(axis=1)] = 0.0
        self.jacobian, self.residual = columns.T, base
        self._fresh, self._reused = True, 0
        scale = 1.4826 * float(np.median(np.abs(base[base != 0]))) if np.any(base) else 1.0
        self.delta = self.robust * max(scale, 1.0)
        self.loss = float(self._loss(base[None])[0])
        if self.iteration > 0 and self._promise() < self._negligible(self.loss, base):
            self._done = "converged: no step promises a gain that noise would not give"

    def _negligible(self, loss: float, residual: Array) -> float:
        """Gains below this are not worth another step."""
        if self.worth is None:
            return self.tolerance * loss
        return min(self.tolerance * self.worth(residual), self.share * loss)

    def _promise(self) -> float:
        """By how much the loss would fall at most, were the slopes to hold all the way."""
        curvature, slope = self._normal_equations()
        # Not clipped to the box: a logarithm at its lower bound sees but a little of what a long way up would gain.
        step = self._damped(curvature, slope, 1e-6)
        return float(-(slope @ step + 0.5 * step @ curvature @ step))

    def _normal_equations(self) -> tuple[Array, Array]:
        if self.jacobian is None or self.residual is None:
            raise CalibrationError("steps asked before the columns were told")
        weights = self.weights()
        return self.jacobian.T @ (self.jacobian * weights[:, None]), self.jacobian.T @ (weights * self.residual)

    def _take_step(self, candidates: Array, residuals: Array) -> None:
        losses = self._loss(residuals)
        k = int(np.nanargmin(np.where(np.isfinite(losses), losses, np.inf)))
        if losses[k] < self.loss:
            self._accept(candidates[k], float(losses[k]), residuals[k], _LADDER[k % len(_LADDER)])
        elif not self._fresh:
            self.jacobian = None  # corrected slopes have worn out: take new ones before giving up
        else:
            self._stale += 1
            self._damping = min(self._damping * 300.0, 1e9)
        if self._stale >= self.patience:
            self._done = "converged: no step of any length goes further down"
        elif self.iteration >= self.max_iterations:
            self._done = f"stopped after {self.max_iterations} iterations; more may help"

    def _accept(self, point: Array, loss: float, residual: Array, factor: float) -> None:
        """Goes to a better point; ends where the gain is small, and corrects the slopes where they proved right."""
        gain, moved = self.loss - loss, point - self.point
        old, slopes = self.residual, self.jacobian
        if old is None or slopes is None:
            raise CalibrationError("a step was told before the columns")
        predicted = old + slopes @ moved
        self._damping = float(np.clip(self._damping * factor, self.least_damping, 1e9))
        self.point, self.loss, self.iteration, self._stale = point, loss, self.iteration + 1, 0
        small = gain < self._negligible(loss, residual)
        trusted = np.linalg.norm(residual - predicted) < 0.7 * np.linalg.norm(residual - old)
        # One short step may be bad luck in a bent valley; two in a row, with new slopes in between, are the bottom.
        self._short = self._short + 1 if small and self._fresh else 0
        if self._short >= 2:
            self._done = "converged: the last steps changed almost nothing"
        if trusted and not small and self._reused < self.reuse:
            # Broyden's rank-one correction, Math. Comp. 19, 1965: the slopes along the step just taken are now known.
            slopes = slopes + np.outer(residual - predicted, moved / (moved @ moved))
            self.jacobian, self.residual, self._fresh, self._reused = slopes, residual, False, self._reused + 1
        elif self._done:
            self.residual = residual  # slopes of a negligible step away will do
        else:
            self.jacobian = None

    def _loss(self, residuals: Array) -> Array:
        """(b,) sum of pseudo-Huber losses, half of the squares for small residuals."""
        if not np.isfinite(self.delta):
            return 0.5 * np.einsum("bm,bm->b", residuals, residuals)
        ratio = residuals / self.delta
        ratio *= ratio
        return self.delta**2 * (np.sqrt(1.0 + ratio) - 1.0).sum(axis=1)

    def weights(self) -> Array:
        """(m,) how much each residual counts at the point: 1 for small ones, less for outliers."""
        if self.residual is None:
            raise CalibrationError("no residuals told yet")
        return 1.0 / np.sqrt(1.0 + (self.residual / self.delta) ** 2)

    def _trial_points(self) -> Array:
        curvature, slope = self._normal_equations()
        found = [self._damped(curvature, slope, max(self._damping * factor, self.least_damping)) for factor in _LADDER]
        plain = [self._inside(d) for d in found]
        if not np.any(self.log_range > 0):
            return np.array(plain)
        return np.array(plain + [self._inside(self._in_value(d)) for d in found])

    def _inside(self, step: Array) -> Array:
        """The point after a step, in the box. No step divides a logarithmic parameter by more than `_MOST_SHRINK`: where
        it is tiny it has almost no effect, so one wrong step down to there would not be taken back.
        """
        span = np.where(self.log_range > 0, self.log_range, 1e-3)
        return np.clip(self.point + np.maximum(step, -np.log(_MOST_SHRINK) / span), 0.0, 1.0)

    def _in_value(self, step: Array) -> Array:
        """The step that changes a logarithmic parameter's value, not its logarithm, by what was computed."""
        span = np.where(self.log_range > 0, self.log_range, 1.0)
        moved = np.log1p(np.maximum(step * span, -0.95)) / span
        return np.where(self.log_range > 0, moved, step)

    def _damped(self, curvature: Array, slope: Array, damping: float) -> Array:
        """The Levenberg-Marquardt step inside the box: parameters pushed against a bound are held there."""
        n = len(slope)
        diagonal = np.diag(curvature)
        floor = 1e-9 * max(float(diagonal.max()), 1e-300)
        damped = curvature + np.diag(damping * (diagonal + floor) + floor)
        free = np.ones(n, dtype=bool)
        step = np.zeros(n)
        for _ in range(3 * n):
            step[:] = 0.0
            if free.any():
                step[free] = -np.linalg.solve(damped[np.ix_(free, free)], slope[free])
            blocked = free & (((self.point <= 0.0) & (step < 0)) | ((self.point >= 1.0) & (step > 0)))
            if blocked.any():
                free &= ~blocked
                continue
            # What was held while others pushed may now want to leave its bound.
            pull = np.where(free, 0.0, -(slope + damped @ step) * np.where(self.point > 0.5, -1.0, 1.0))
            if pull.max() <= 1e-12 * np.abs(slope).max():
                break
            free[int(pull.argmax())] = True
        return step
