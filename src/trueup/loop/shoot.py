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
_GROWTH = np.log(5.0)  # so many times an error at the start of a window may grow in it
_FEWEST = 8  # samples in a window: a start is estimated from five
_PARTS = 4  # windows that a recording is cut into to see how fast errors grow: all kinds of motion have their say
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
    def every(cls, problem: Problem) -> Starts:
        """No corrections, of whatever was measured."""
        widths = {n: len(c.labels) for t in problem.trials for n, c in t.initial.items()}
        handles = tuple((name, j, order) for name, width in widths.items() for j in range(width) for order in (0, 1))
        sizes = np.array([[_size(t, *handle) for handle in handles] for t in problem.trials])
        return cls(problem.trials, handles, sizes, np.zeros_like(sizes))

    @classmethod
    def as_measured(cls, problem: Problem, values: Array) -> Starts:
        """No corrections, of whatever changes the first samples at values (n,)."""
        every = cls.every(problem)
        begun = problem.replayed_by([cut(t, t.start, _GLANCE) for t in problem.trials], problem.owners)
        _, _, changes = replace(every, measured=begun.trials).changes(begun, values)
        seen = np.flatnonzero(changes.any(axis=1))
        sizes = every.sizes[:, seen]
        return cls(problem.trials, tuple(every.handles[k] for k in seen), sizes, np.zeros_like(sizes))

    def changes(self, problem: Problem, values: Array) -> tuple[list[Trial], Array, Array]:
        """The corrected trials, their residuals (m,), and (K, m) how one standard deviation more of each changes them."""
        k = len(self.handles)
        steps = np.concatenate([np.zeros((1, k)), np.eye(k)])
        begun = [replace(self, amounts=self.amounts + step).trials() for step in steps]
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
            [t for amounts in steps[1:] for t in replace(self, amounts=amounts).trials()],
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

    def trials(self) -> list[Trial]:
        """The trials with these corrections."""
        return [self._begun(r, row) for r, row in enumerate(self.amounts)]

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


def window_length(problem: Problem, values: Array) -> float:
    """How long trials may be in s, so that an error at their start grows fivefold at most; inf where none grows so.

    Two starts a standard deviation of the measurements apart are followed at values (n,), in each part of every trial. Their
    distance counts speeds by how far these lead until then, so that what drifts apart steadily does not grow: only what is
    unstable does, at the rate of its largest Lyapunov exponent (A. Wolf et al., Physica D 16(3), 1985). Runs under a
    controller of the simulator's own begin only where it does.
    """
    if any(t.command is None for t in problem.trials):
        return np.inf
    longest = max(t.duration for t in problem.trials)
    for length in (longest / _PARTS, longest):
        reached = _reached(in_windows(problem, length), values)
        if np.isfinite(reached):
            return reached
    return np.inf


def in_windows(problem: Problem, length: float) -> Problem:
    """The same problem with every trial cut into equal parts of about `length` s, each begun where the robot was then."""
    parts = [(part, owner) for t, owner in zip(problem.trials, problem.owners, strict=True) for part in _cut(t, length)]
    if len(parts) == len(problem.trials):
        return problem
    return problem.replayed_by([part for part, _ in parts], [owner for _, owner in parts])


def _cut(trial: Trial, length: float) -> list[Trial]:
    samples = max(len(o.time) for o in trial.observed.values())
    count = max(1, min(round(trial.duration / length), samples // _FEWEST))
    step = trial.duration / count
    parts = [cut(trial, trial.start + k * step, step) for k in range(count)]
    # What is seen at the instant where the next part begins is seen there.
    ends = [p.start + p.duration - 1e-9 for p in parts[:-1]] + [np.inf]
    return [_until(part, end) for part, end in zip(parts, ends, strict=True)] if count > 1 else [trial]


def _until(trial: Trial, end: float) -> Trial:
    observed = {n: replace(o, time=o.time[o.time < end]) for n, o in trial.observed.items()}
    return replace(trial, observed={n: o for n, o in observed.items() if len(o.time)})


def _reached(problem: Problem, values: Array) -> float:
    """From when on two starts are `_GROWTH` further apart, in the median over trials; inf where they do not stay so."""
    starts = Starts.every(problem)
    apart = replace(starts, amounts=np.ones_like(starts.amounts)).trials()
    both = problem.replayed_by([*problem.trials, *apart], problem.owners * 2)
    near, far = both.plain_residuals(values[None]).reshape(2, -1)
    times, grown = [], []
    for k, trial in enumerate(problem.trials):
        time, growth = _growth(problem, k, far - near)
        times.append(time - trial.start)
        grown.append(growth)
    grid = np.unique(np.concatenate(times))
    curves = [np.interp(grid, t, g, right=np.nan) for t, g in zip(times, grown, strict=True) if len(t)]
    known = [c for c in curves if np.isfinite(c).any()]
    if not known:
        return np.inf
    below = np.flatnonzero(~(np.nanmedian(known, axis=0) >= _GROWTH))
    # What a touch-down parts comes together again: only growth that lasts counts.
    return float(grid[below[-1] + 1]) if len(below) and below[-1] + 1 < len(grid) else np.inf


def _growth(problem: Problem, trial: int, change: Array) -> tuple[Array, Array]:
    """(T,) instants and ln of how many times further apart two runs of a trial are then; both empty where they are one."""
    place = pace = time = np.zeros(0)
    for segment in problem.segments:
        if segment.trial == trial and segment.samples > 2:
            own = problem.trials[trial].observed[segment.channel].time
            if len(time) and len(own) != len(time):
                continue  # another rate
            time, seen = own, segment.shaped(change)
            place = np.sum(seen**2, axis=1) + (place if len(place) else 0.0)
            pace = np.sum(np.gradient(seen, own, axis=0) ** 2, axis=1) + (pace if len(pace) else 0.0)
    if not len(time) or not np.isfinite(place).all() or not np.any(place):
        return np.zeros(0), np.zeros(0)
    until = (time - time[0]) ** 2
    first, last = place[0] + until * pace[0], place + until * pace
    return time, 0.5 * np.log(np.maximum(last, 1e-300) / np.maximum(first, 1e-300))
