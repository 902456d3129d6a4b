# SPDX-License-Identifier: Apache-2.0
"""Numbers of a law that make it replay recordings, and what they would have been without each part of these."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from trueup.actuators.bench import Run
from trueup.actuators.replay import replay
from trueup.actuators.structures import law_of
from trueup.arrays import Array
from trueup.errors import CalibrationError
from trueup.evidence import FEWEST_PARTS
from trueup.parameters import Parameter, ParameterSpace
from trueup.rounding import NEGLIGIBLE, TINY
from trueup.samples import rms
from trueup.search.least_squares import LeastSquares
from trueup.search.robust import robust_losses, robust_weights
from trueup.trial import STEP

WINDOWS = (0.3, 1.0, np.inf)  # s: strokes of a servo, motions of several, all
_APART = 5e-3  # share of the box between which slopes are taken for intervals


@dataclass(frozen=True)
class Block:
    """A stretch of one run that is left out of a fit as a whole."""

    run: int
    samples: slice


@dataclass(frozen=True, eq=False)
class Found:
    """A fit: values by name, and the robust loss that is left."""

    values: Mapping[str, float]
    loss: float
    bend: float
    searched: tuple[Parameter, ...]


class Problem:
    """Runs of a servo as residuals of values of its law, in units of the noise; `file`: as MuJoCo replays its MJCF."""

    def __init__(self, runs: Sequence[Run], step: float = STEP, *, file: bool = False) -> None:
        if not runs:
            raise CalibrationError("no recordings to identify a servo from")
        self.runs, self.step, self.file = tuple(runs), step, file
        parts = int(np.ceil(FEWEST_PARTS / len(runs)))
        self.blocks = [
            Block(k, slice(round(len(r.time) * p / parts), round(len(r.time) * (p + 1) / parts)))
            for k, r in enumerate(runs) for p in range(parts)
        ]  # fmt: skip

    def residuals(self, rows: Sequence[Mapping[str, float]], without: Block | None = None,
                  window: float = np.inf) -> Array:  # fmt: skip
        """(b, m) of b sets of values; without a block its samples are missing. `window` as `replay` has it."""
        done = []
        for values in rows:
            parts = []
            for k, run in enumerate(self.runs):
                out = without.samples if without is not None and without.run == k else slice(0, 0)
                if out.stop - out.start < len(run.time):
                    parts.append(np.delete(self.misses(values, run, window) / run.noise, out))
            done.append(np.concatenate(parts))
        return np.stack(done)

    def misses(self, values: Mapping[str, float], run: Run, window: float = np.inf) -> Array:
        """(T,) rad by which a replay of one run with these values is off."""
        hung = run.hung(values.get("hangs_at"))
        return replay(law_of(values), hung, self.step, window, file=self.file) - run.position

    def losses(self, rows: Sequence[Mapping[str, float]], bend: float, window: float = np.inf) -> Array:
        """(b,) robust loss of sets of values; inf where a replay fails."""
        losses = robust_losses(self.residuals(rows, window=window), bend)
        return np.where(np.isfinite(losses), losses, np.inf)

    def block_errors(self, each: Sequence[Mapping[str, float]]) -> Array:
        """(B,) root mean square error in rad of each block with values of its own; inf where a replay fails."""
        errors = np.empty(len(self.blocks))
        for b, (block, values) in enumerate(zip(self.blocks, each, strict=True)):
            run = self.runs[block.run]
            misses = self.misses(values, run)[block.samples]
            errors[b] = rms(misses)
        return np.where(np.isfinite(errors), errors, np.inf)


def fit(problem: Problem, parameters: Sequence[Parameter], start: Mapping[str, float], *, without: Block | None = None,
        iterations: int = 30, window: float = np.inf) -> Found:  # fmt: skip
    """Least squares from a start; `start` also holds values that are not searched. Raises CalibrationError."""
    space = ParameterSpace(tuple(parameters))
    fixed = {n: v for n, v in start.items() if n not in space.names}
    ranges = np.array([p.log_range for p in parameters])
    begin = space.to_unit([start.get(p.name, p.nominal) for p in parameters])
    search = LeastSquares(
        np.clip(begin, 0.0, 1.0),
        ranges,
        max_iterations=iterations,
        confirm=without is None,
        nudge=LeastSquares.difference,
    )

    while not search.done:
        points = search.ask()
        search.tell(points, problem.residuals([fixed | row for row in space.named(points)], without, window))
    best = fixed | space.named(search.best[0][None])[0]
    return Found(best, search.best[1], search.delta, tuple(parameters))


def widening(
    problem: Problem, parameters: Sequence[Parameter], start: Mapping[str, float], windows: Sequence[float] = WINDOWS
) -> Found:
    """A fit through ever longer windows, up to whole runs.

    A replay of seconds goes astray for good where a servo sticks or slips once too often, and least squares is caught
    there; windows begin where it was measured to be (multiple shooting: H. Bock and K. Plitt, IFAC World Congress 1984).
    """
    found = fit(problem, parameters, start, window=windows[0])
    for window in windows[1:]:
        found = fit(problem, parameters, found.values, window=window)
    return found


@dataclass(frozen=True, eq=False)
class Slopes:
    """A fit's residuals (m,) and how they change with what was searched (m, n), over the box, robust weights in both."""

    misses: Array
    slopes: Array
    root: Array
    """(m,) of the weights."""

    @classmethod
    def at(cls, problem: Problem, found: Found) -> Slopes:
        """By differences over `_APART` of the box to both sides."""
        space = ParameterSpace(found.searched)
        here = space.to_unit([found.values[n] for n in space.names])
        n = len(here)
        points = np.clip(np.concatenate([here[None], here + _APART * np.eye(n), here - _APART * np.eye(n)]), 0.0, 1.0)
        misses = problem.residuals([{**found.values, **row} for row in space.named(points)])
        root = np.sqrt(robust_weights(misses[0], found.bend))
        moved = np.diag(points[1 : n + 1] - points[n + 1 :])
        return cls(root * misses[0], (misses[1 : n + 1] - misses[n + 1 :]).T / moved * root[:, None], root)


def spread(problem: Problem, slopes: Slopes) -> Array:
    """(n, n) covariance over the box of what was searched, from how differently the blocks pull.

    The sandwich with one term a block (K. Liang, S. Zeger, Biometrika 73(1), 1986), so that errors which last as long as a
    block, and what the model misses, count; nothing is less certain than a uniform guess (variance 1 / 12).
    """
    x, n, B = slopes.slopes, slopes.slopes.shape[1], len(problem.blocks)
    edges = np.cumsum([0, *(b.samples.stop - b.samples.start for b in problem.blocks)])
    pulls = np.stack([x[a:b].T @ slopes.misses[a:b] for a, b in pairwise(edges)])
    curvature = x.T @ x
    between = B / (B - 1) * (pulls.T @ pulls)
    size = max(float(np.trace(between) / max(np.trace(curvature), TINY)), NEGLIGIBLE)
    guess = 12.0 * np.eye(n)  # its information
    inverse = np.linalg.inv(curvature + size * guess)
    return inverse @ (between + size**2 * guess) @ inverse


def coarseness(problem: Problem, found: Found, slopes: Slopes) -> Array:
    """(n,) share of the box by which values are off since a replay takes steps, to first order.

    MuJoCo's errors shrink with its step, so that half a step has half of them: what the fit would change by with it, a
    Gauss-Newton step on, is as much as what is left (L. F. Richardson, Phil. Trans. Royal Society A 210, 1911).
    """
    fine = Problem(problem.runs, 0.5 * problem.step, file=problem.file).residuals([found.values])[0]
    change = np.linalg.lstsq(slopes.slopes, slopes.root * fine - slopes.misses, rcond=None)[0]
    return 2.0 * np.abs(np.where(np.isfinite(change), change, 0.0))


def left_out(problem: Problem, parameters: Sequence[Parameter], found: Found) -> list[dict[str, float]]:
    """Values of fits that never saw one block each; they begin where the whole one ended."""
    again = 4  # iterations of a fit that begins where the whole one ended
    return [dict(fit(problem, parameters, found.values, without=b, iterations=again).values) for b in problem.blocks]
