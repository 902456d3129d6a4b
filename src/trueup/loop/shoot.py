# SPDX-License-Identifier: Apache-2.0
"""Multiple shooting: replays that begin at measured instants, from states that are known but for the noise there.

H. G. Bock and K. J. Plitt, A multiple shooting algorithm for direct solution of optimal control problems, IFAC 1984.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trueup.noise import estimate_noise
from trueup.recording import Channel
from trueup.trial import Observed, Trial

if TYPE_CHECKING:
    from trueup.loop.problem import Problem

Array = NDArray[np.float64]

_SLOPE = 1.24  # times noise / sampling interval: slope at the end of a parabola through five samples
_GLANCE = 0.1  # s: by then a start has shown whether it has an effect
_DAMPINGS = (0.0, 0.1, 1.0, 10.0)  # of the corrections that are tried side by side


@dataclass(frozen=True, eq=False)
class Eliminated:
    """Start corrections of one trial, eliminated from its residuals (condensing, by a Schur complement).

    A start that is off by d changes the residuals r, in units of their size, by S d, and costs |d|^2, where d is in standard
    deviations of the measured start. The least over d of |r + S d|^2 + |d|^2 is r' (1 + S S')^-1 r: plain least squares of r
    times the root of that inverse, which takes the share `shrink` off each of the `directions`.
    """

    columns: slice
    """The trial's part of the residual vector."""
    changes: Array
    """(m, k) S."""
    begun: Array
    """(k,) corrections that the trial begins with already."""
    size: float
    """Of the residuals, in units of noise."""
    directions: Array
    """(m, k) orthonormal."""
    shrink: Array
    """(k,)"""

    @classmethod
    def of(cls, columns: slice, changes: Array, begun: Array, size: float) -> Eliminated:
        """From the `changes` (m, k) of residuals of some `size` (in noise units) by a standard deviation of each number."""
        directions, sizes, _ = np.linalg.svd(changes / size, full_matrices=False)
        return cls(columns, changes / size, begun, size, directions, 1.0 - 1.0 / np.sqrt(1.0 + sizes**2))

    def apply(self, residuals: Array) -> None:
        """Changes residuals (b, M) in place."""
        part = residuals[:, self.columns]
        part -= self.size * (self.changes @ self.begun)
        part -= ((part @ self.directions) * self.shrink) @ self.directions.T

    def solved(self, residuals: Array, damping: float) -> Array:
        """(k,) the corrections, those begun with included, that go best with residuals (M,), damped."""
        slopes = self.changes.T @ residuals[self.columns] / self.size + self.begun
        normal = self.changes.T @ self.changes
        normal += np.eye(len(slopes)) + damping * np.diag(np.diag(normal))
        return self.begun - np.linalg.solve(normal, slopes)

    def loss(self, residuals: Array, amounts: Array) -> Array:
        """(b,) half the squares of residuals (b, M), in units of their size, and of corrections (b, k)."""
        return 0.5 * (np.sum((residuals[:, self.columns] / self.size) ** 2, axis=1) + np.sum(amounts**2, axis=1))


@dataclass(frozen=True, eq=False)
class Starts:
    """Corrections of measured starts, as numbers in standard deviations: value and speed of each label that has an effect."""

    measured: tuple[Trial, ...]
    handles: tuple[tuple[str, int, int], ...]
    """Channel, place of the label in it, and 0 for its value, 1 for its speed."""
    sizes: Array
    """(R, K) standard deviation of each, in the channel's unit (per second)."""
    amounts: Array
    """(R, K) corrections, in these."""

    @classmethod
    def as_measured(cls, problem: Problem, values: Array) -> Starts:
        """No corrections, of whatever changes the first samples at values (n,)."""
        widths = {n: len(c.labels) for t in problem.trials for n, c in t.initial.items()}
        handles = [(name, j, order) for name, width in widths.items() for j in range(width) for order in (0, 1)]
        sizes = np.array([[_size(t, *handle) for handle in handles] for t in problem.trials])
        begun = problem.replayed_by([cut(t, t.start, _GLANCE) for t in problem.trials], problem.owners)
        _, _, changes = cls(begun.trials, tuple(handles), sizes, np.zeros_like(sizes)).changes(begun, values)
        seen = np.flatnonzero(changes.any(axis=1))
        none = np.zeros((len(sizes), len(seen)))
        return cls(problem.trials, tuple(handles[k] for k in seen), sizes[:, seen], none)

    def changes(self, problem: Problem, values: Array) -> tuple[list[Trial], Array, Array]:
        """The corrected trials, their residuals (m,), and (K, m) how one standard deviation more of each changes them."""
        k = len(self.handles)
        steps = np.concatenate([np.zeros((1, k)), np.eye(k)])
        begun = [[self._begun(r, row + step) for r, row in enumerate(self.amounts)] for step in steps]
        several = problem.replayed_by([t for own in begun for t in own], problem.owners * len(begun))
        residuals = several.plain_residuals(values[None]).reshape(len(begun), -1)
        changes = residuals[1:] - residuals[0]
        changes[~np.isfinite(changes).all(axis=1)] = 0.0  # what cannot be simulated is not corrected
        return begun[0], residuals[0], changes

    def eliminated_from(self, problem: Problem, values: Array) -> Problem:
        """The problem begun with these corrections and with further ones eliminated, as seen at values (n,)."""
        if not self.handles:
            return problem
        begun, residual, changes = self.changes(problem, values)
        size = max(1.0, 1.4826 * float(np.median(np.abs(residual))))
        parts = [problem.columns(r) for r in range(len(self.measured))]
        return problem.with_starts(
            begun, [Eliminated.of(p, changes[:, p].T, a, size) for p, a in zip(parts, self.amounts, strict=True)]
        )

    def corrected(self, problem: Problem, values: Array) -> tuple[Starts, float]:
        """Corrections that replay better with values (n,), and by how much more or less than slopes foretell.

        Steps of Levenberg and Marquardt, of several lengths at once; each trial takes its own best, or stays.
        """
        begun = problem.plain_residuals(values[None])
        steps = [self.amounts, *(np.array([s.solved(begun[0], d) for s in problem.eliminated]) for d in _DAMPINGS)]
        tried = problem.replayed_by(
            [self._begun(r, row) for amounts in steps[1:] for r, row in enumerate(amounts)],
            problem.owners * len(_DAMPINGS),
        )
        residuals = np.concatenate([begun, tried.plain_residuals(values[None]).reshape(len(_DAMPINGS), -1)])
        amounts, surprise = np.array(steps), 0.0
        for s in problem.eliminated:
            s.apply(begun)
        chosen = np.empty_like(self.amounts)
        for r, s in enumerate(problem.eliminated):
            losses = np.nan_to_num(s.loss(residuals, amounts[:, r]), nan=np.inf)
            chosen[r] = amounts[losses.argmin(), r]
            surprise += s.size**2 * abs(float(losses.min()) - float(s.loss(begun, np.zeros((1, 1)))[0]))
        return replace(self, amounts=chosen), surprise

    def _begun(self, r: int, amounts: Array) -> Trial:
        trial = self.measured[r]
        corrections = {name: np.zeros((2, len(c.labels))) for name, c in trial.initial.items()}
        for (name, j, order), amount, size in zip(self.handles, amounts, self.sizes[r], strict=True):
            if size:
                corrections[name][order, j] = amount * size
        return replace(trial, corrections={n: c for n, c in corrections.items() if c.any()})


def _size(trial: Trial, name: str, label: int, order: int) -> float:
    """Standard deviation of a measured value, or of a speed (one measured, or the slope of a few values); 0 for none."""
    channel = trial.initial.get(name)
    if channel is None or label >= len(channel.labels):
        return 0.0
    if order == 0:
        return _noise(channel, label)
    speed = next(
        (c for c in trial.initial.values() if c.unit == f"{channel.unit}/s" and c.labels == channel.labels), None
    )
    if speed is not None:
        return _noise(speed, label)
    return _SLOPE * _noise(channel, label) / float(np.median(np.diff(channel.time)))


def _noise(channel: Channel, label: int) -> float:
    return float(np.nan_to_num(estimate_noise(channel.values[:, label], channel.time))[0])


def cut(trial: Trial, start: float, length: float) -> Trial:
    """The part of a trial from an instant on, `length` s at most; it starts where the robot was measured to be then."""
    stop = start + length
    observed = {}
    for name, o in trial.observed.items():
        inside = (o.time >= start - 1e-9) & (o.time <= stop)
        if inside.any():
            observed[name] = Observed(o.labels, o.unit, o.time[inside])
    left = trial.start + trial.duration - start
    return replace(trial, start=start, duration=min(length, left), observed=observed)
