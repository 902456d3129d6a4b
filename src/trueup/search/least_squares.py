# SPDX-License-Identifier: Apache-2.0
"""Bounded Gauss-Newton / Levenberg-Marquardt by ask and tell: one batch holds all finite-difference columns.

D. Marquardt, SIAM J. 11(2), 1963, with projection onto the box; robust loss after P. Huber's pseudo-Huber form.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from trueup.arrays import Array
from trueup.errors import CalibrationError
from trueup.noise import spread
from trueup.search.bounded_step import careful_difference, corrected, damped_step, gain, steps_apart
from trueup.search.robust import robust_losses, robust_weights
from trueup.search.search import SearchState, saved_point


@dataclass
class LeastSquares:
    """Minimises the robust sum of squared residuals over the unit box.

    `log_range` (n,) is ln(upper / lower) of parameters on a log scale, 0 for others: steps may also be taken in their value.
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
    """Of residuals (m,): by how much noise alone changes the loss; a step that gains far less moves nothing that is known."""
    max_iterations: int = 30
    patience: int = 3
    """Batches of steps in a row without any descent after which it ends."""
    impatient: bool = False
    """Ends as stuck once new slopes have given little of what they promised: a crack in the loss holds it."""
    wanted: float = np.inf
    """Ends once new slopes promise no loss below it, were they to give `hope` times what they do: a trial that cannot win."""
    hope: float = 3.0  # what bends may give beyond slopes
    share: float = 2e-3
    """With `worth`: a gain above this share of the loss is never negligible."""
    least_damping: float = 1e-9
    """Damping never goes below: it holds combinations that are weakly seen where they are."""
    confirm: bool = True
    """Take new slopes where the search ends; a first look can do without."""
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
    """Steps in a row that may be taken with slopes that are only corrected by what the last step showed."""
    ladder: tuple[float, ...] = (0.03, 1.0, 30.0)
    """Factors on the damping that are tried side by side, in one batch."""
    climbs: int = 2
    """Steps uphill in a row, each on the promise that the next one comes down below everything before."""
    alike: float = 0.02
    """Steps nearer to one another than this share of the promised gain, and of the box, are one."""
    crossing: float = 1e-4
    """Damping of the imagined step across the valley that candidates are judged by."""
    cracked: float = 10.0
    """Times what is negligible: slopes that promise more where no step goes down are those of a crack."""
    creep: float = 0.2
    """Share of what new slopes promised: a search that gains less until the next ones creeps."""
    _fresh: bool = field(init=False, default=True)
    _reused: int = field(init=False, default=0)
    _short: int = field(init=False, default=0)
    _enough: float = field(init=False, default=np.inf)
    """The loss that must be reached before slopes are taken again, if `impatient`."""
    _damping: float = field(init=False, default=1e-2)
    _stale: int = field(init=False, default=0)
    _done: str = field(init=False, default="")
    _credit: int = field(init=False)
    _lowest: tuple[Array, float, Array] | None = field(init=False, default=None)
    """Point, loss and residual of the lowest place so far."""
    _normal: tuple[Array, Array] | None = field(init=False, default=None)
    _factors: list[float] = field(init=False, default_factory=list)
    _steps: Array = field(init=False, default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        """Moves the start off the bounds."""
        self._credit = self.climbs
        self.start = np.asarray(self.start, dtype=np.float64)
        self.point = np.clip(self.start, self.nudge, 1.0 - self.nudge)

    @property
    def done(self) -> str:
        """Why the search has ended, or ''."""
        return self._done

    @property
    def best(self) -> tuple[Array, float]:
        """The lowest point and its loss."""
        return (self.point, self.loss) if self._lowest is None else self._lowest[:2]

    def ask(self) -> Array:
        """Finite-difference columns around the point (with the point itself first), or steps of several lengths."""
        if self.jacobian is None:
            self._steps = np.where(self.point > 0.5, -1.0, 1.0) * careful_difference(self.residual, self.difference)
            return np.concatenate([self.point[None], self.point + np.diag(self._steps)])
        return self._trial_points()

    def tell(self, candidates: Array, losses: Array) -> None:
        """Residuals (b, m) of the candidates; rows with NaN are failed evaluations."""
        residuals = np.asarray(losses)
        if self.jacobian is None:
            self._take_jacobian(residuals)
        else:
            self._take_step(candidates, residuals)

    @property
    def stuck(self) -> bool:
        """Whether slopes still promise what no step gives: it is at a crack in the loss, or creeping along one."""
        known = self.jacobian is not None and self.residual is not None
        return known and self._promise() > self.cracked * self._negligible(self.loss, self._known()[1])

    @property
    def fresh(self) -> bool:
        """Whether the slopes are those of the very point."""
        return self._fresh and self.jacobian is not None

    def adopt(self, jacobian: Array, residual: Array) -> None:
        """Begins with slopes (m, n) taken elsewhere and the residual (m,) here."""
        self._bend_and_lowest(residual)
        self._see(jacobian, residual)
        self._fresh = False

    def state(self) -> SearchState:
        """The point, its damping and counters; the next ask is for the columns around it."""
        return {
            "point": self.point.tolist(), "loss": self.loss, "iteration": self.iteration, "damping": self._damping,
            "stale": self._stale, "short": self._short, "done": self._done,
        }  # fmt: skip

    def resume(self, state: SearchState) -> None:
        """Goes on from `state`. Raises CalibrationError where it belongs to another number of parameters."""
        self.point, self.loss = saved_point(state, self.point), float(state["loss"])
        self.iteration = int(state["iteration"])
        self._damping, self._stale = float(state["damping"]), int(state["stale"])
        self._short, self._done = int(state["short"]), str(state["done"])

    def _take_jacobian(self, residuals: Array) -> None:
        base = residuals[0]
        if not np.isfinite(base).all():
            raise CalibrationError("the simulation fails at the start values; check the model and the start state")
        columns = (residuals[1:] - base) / self._steps[:, None]
        # A column whose simulation failed tells nothing this time; the parameter rests until the next round.
        columns[~np.isfinite(columns).all(axis=1)] = 0.0
        self._bend_and_lowest(base)
        self._see(columns.T, base)
        self._fresh, self._reused = True, 0
        promise = self._promise()
        if self.iteration > 0 and promise < self._negligible(self.loss, base):
            self._done = "converged: no step promises a gain that noise would not give"
        elif self.impatient and self.best[1] > self._enough:
            self._done = "stopped creeping along a crack in the loss"
        elif self.best[1] - self.hope * promise > self.wanted:
            self._done = "stopped where slopes promise too little"
        self._enough = self.best[1] - self.creep * promise

    def _bend_and_lowest(self, base: Array) -> None:
        """Sets the robust loss by the residuals at hand, and what is lowest by that loss."""
        self.delta = self.robust * max(float(spread(base)), 1.0)
        self.loss = float(robust_losses(base[None], self.delta)[0])
        if self._lowest is not None:
            point, _, residual = self._lowest
            self._lowest = point, float(robust_losses(residual[None], self.delta)[0]), residual
        if self.loss <= self.best[1] or np.array_equal(self.point, self.best[0]):  # seen twice: rounding
            self._lowest = self.point, self.loss, base

    def _negligible(self, loss: float, residual: Array) -> float:
        """Gains below this are not worth another step."""
        if self.worth is None:
            return self.tolerance * loss
        return min(self.tolerance * self.worth(residual), self.share * loss)

    def _promise(self) -> float:
        """By how much the loss would fall at most, were the slopes to hold all the way."""
        curvature, slope = self._normal_equations()
        # Not clipped to the box: a logarithm at its lower bound sees but a little of what a long way up would gain.
        return gain(curvature, slope, damped_step(curvature, slope, 1e-6, self.point))

    def _normal_equations(self) -> tuple[Array, Array]:
        """(n, n) curvature and (n,) slope of the loss at the point."""
        if self._normal is None:
            jacobian, residual = self._known()
            weighted = jacobian * self.weights()[:, None] if np.isfinite(self.delta) else jacobian
            self._normal = jacobian.T @ weighted, weighted.T @ residual
        return self._normal

    def _known(self) -> tuple[Array, Array]:
        """Slopes and residual at the point."""
        if self.jacobian is None or self.residual is None:
            raise CalibrationError("steps asked before the columns were told")
        return self.jacobian, self.residual

    def _see(self, jacobian: Array | None, residual: Array | None) -> None:
        """Other slopes, or another residual; with no slopes the next ask is for columns."""
        self.jacobian, self.residual, self._normal = jacobian, residual, None

    def _take_step(self, candidates: Array, residuals: Array) -> None:
        losses = np.nan_to_num(robust_losses(residuals, self.delta), nan=np.inf, posinf=np.inf)
        hoped = self._hoped(candidates, residuals, losses)
        below = self.best[1]
        lowest, k = int(losses.argmin()), int(hoped.argmin())
        climbs = losses[k] >= below
        if climbs and not (self._credit > 0 and hoped[k] < below - self._negligible(below, residuals[lowest])):
            k, climbs = lowest, False
        if climbs or losses[k] < below:
            self._credit = self._credit - 1 if climbs else self.climbs
            self._accept(candidates[k], float(losses[k]), residuals[k], float(losses[k] - hoped[k]), self._factors[k])
        else:
            self._reject()
        if self._stale >= self.patience:
            self._done = "converged: no step of any length goes further down"
        elif self.iteration >= self.max_iterations:
            self._done = f"stopped after {self.max_iterations} iterations; more may help"
        if self._done and self.loss > self.best[1]:
            self._go_back()

    def _hoped(self, candidates: Array, residuals: Array, losses: Array) -> Array:
        """(b,) what the loss of each candidate would be after one more step with the slopes at hand.

        In a bent valley a long step along it climbs the wall, and a step across it, which the slopes know well, comes
        back down. Judged by their own loss only short steps along the valley would ever be taken.
        """
        curvature, _ = self._normal_equations()
        slopes = (robust_weights(residuals, self.delta) * residuals) @ self._known()[0]
        damping = max(self.least_damping, self.crossing)
        return np.array([
            loss - gain(curvature, slope, damped_step(curvature, slope, damping, at)) if np.isfinite(loss) else np.inf
            for loss, slope, at in zip(losses, slopes, candidates, strict=True)
        ])  # fmt: skip

    def _reject(self) -> None:
        if not (self._fresh and np.array_equal(self.point, self.best[0])):
            self._go_back()  # corrected slopes have worn out, or a way uphill led nowhere
        else:
            self._stale += 1
            self._damping = min(self._damping * 300.0, 1e9)

    def _go_back(self) -> None:
        """To the lowest place, with new slopes, and no more climbing before something lower is found."""
        self.point, self.loss = self.best
        self._credit = 0
        self._see(None, self.residual if self._lowest is None else self._lowest[2])

    def _accept(self, point: Array, loss: float, residual: Array, left: float, factor: float) -> None:
        """Goes to a point that leaves a gain of `left`; corrects the slopes as long as they serve."""
        fallen, moved, promised = self.loss - loss, point - self.point, self._promise()
        self._damping = float(np.clip(self._damping * factor, self.least_damping, 1e9))
        self.point, self.loss, self.iteration, self._stale = point, loss, self.iteration + 1, 0
        if loss < self.best[1]:
            self._lowest = point, loss, residual
        negligible = self._negligible(loss, residual)
        # One short step may be bad luck in a bent valley; two in a row, with new slopes in between, are the bottom.
        self._short = self._short + 1 if abs(fallen) < negligible and self._fresh else 0
        if self._short >= 2:
            self._done = "converged: the last steps changed almost nothing"
        elif left < negligible and not self.confirm and loss <= self.best[1]:
            self._done = "converged: no step promises a gain that noise would not give"
        serve = negligible < left < promised or loss > self.best[1]
        self._fresh = False
        if self._done:
            self._see(self.jacobian, residual)  # slopes of a negligible step away will do
        elif serve and self._reused < self.reuse:
            self._see(corrected(*self._known(), moved, residual), residual)
            self._reused += 1
        else:
            self._see(None, residual)

    def weights(self) -> Array:
        """(m,) how much each residual counts at the point: 1 for small ones, less for outliers."""
        if self.residual is None:
            raise CalibrationError("no residuals told yet")
        return robust_weights(self.residual, self.delta)

    def _trial_points(self) -> Array:
        """Steps of several lengths that differ; the factor on the damping that made each is kept beside it."""
        curvature, slope = self._normal_equations()
        dampings = [max(self._damping * factor, self.least_damping) for factor in self.ladder]
        least = self.alike * self._promise()
        points, rungs = steps_apart(curvature, slope, dampings, self.point, self.log_range, least, self.alike)
        self._factors = [self.ladder[k] for k in rungs]
        return points
