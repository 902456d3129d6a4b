# SPDX-License-Identifier: Apache-2.0
"""Recordings, a simulator and a discrepancy made into one function: parameter values in, residuals out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from trueup.arrays import Array
from trueup.controllers.controller import ControllerFactory
from trueup.discrepancies.discrepancy import Discrepancy, compared
from trueup.ends import End
from trueup.engines.simulator import Approximated, Controlled, Rollout, Simulator, broken
from trueup.errors import CalibrationError, SimulationFailedError
from trueup.loop.condensing import Eliminated, cut, thinned
from trueup.loop.mixed import Mixed
from trueup.loop.segment import Segment
from trueup.loop.visited import Visited
from trueup.recording import Recording
from trueup.rounding import TINY
from trueup.trial import Trial

FAITHFUL = 0.3
"""Share of the residuals by which a coarser step, or an approximation, may change them and be searched in their place."""
WORTH = 60.0
"""s of motion in all from which an approximation is worth its trouble: with less, slopes cost the engine seconds."""


class Problem:
    """Residuals (b, m) of values (b, n): all candidates on all recordings in one rollout.

    The m residuals are those of samples that were measured, as `segments` lay them out: a gap in a recording has none, nor
    has what was measured after the end of the robot's run. Where a simulated run ends first (`ends`: conditions that stop
    rows early, and so cost no more), its last state is held and compared (see `Rollout.held`). A recording is
    replayed by one trial, or by several that each begin where the robot was then (see `shoot.py`).
    """

    def __init__(
        self, simulator: Simulator, recordings: Sequence[Recording], discrepancy: Discrepancy,
        channels: Sequence[str] | None = None, *, controllers: ControllerFactory | None = None, ends: Sequence[End] = (),
    ) -> None:  # fmt: skip
        self.simulator, self.recordings, self.discrepancy = simulator, tuple(recordings), discrepancy
        self._finest = simulator  # as it was before steps became coarser
        self._counted = [0]  # shared by all versions of this problem
        self.heard_by: list[Callable[[int], None]] = []
        """Told how many candidates were simulated so far, by all versions of this problem."""
        self._controllers = controllers
        self._exactly = False
        self._offset: Array | None = None
        self._last: tuple[bytes, Array] | None = None  # values and residuals of the last candidate that came alone
        self.visited = Visited(simulator)
        self.eliminated: tuple[Eliminated, ...] = ()
        trials = thinned([_trial(simulator, r, channels) for r in recordings])
        self._lay_out([replace(t, ends=tuple(ends)) for t in trials] if ends else trials, range(len(trials)))

    def _lay_out(self, trials: Sequence[Trial], owners: Sequence[int]) -> None:
        self.trials, self.owners = tuple(trials), tuple(owners)
        """`owners`: which recording each trial replays."""
        self._masks = [
            compared(self.discrepancy, self.recordings[k], t) for k, t in zip(self.owners, self.trials, strict=True)
        ]
        self.segments = self._segments()

    def _twin(self) -> Problem:
        twin = object.__new__(Problem)
        twin.__dict__.update(self.__dict__)
        twin._last, twin.visited = None, Visited(self.simulator)
        return twin

    @property
    def period(self) -> float:
        """Time between two commands of the simulator's own controller, in s; 0 where there is none."""
        if self._controllers is None and isinstance(self.simulator, Controlled):
            return self.simulator.period
        return 0.0

    @property
    def evaluations(self) -> int:
        """Candidates simulated so far."""
        return self._counted[0]

    def at_step(self, step: float) -> Problem:
        """The same problem simulated with another step."""
        twin = self._twin()
        twin.simulator = self.simulator.at_step(step)
        return twin

    def by(self, simulator: Simulator) -> Problem:
        """The same problem simulated by another simulator of the same robot."""
        twin = self._twin()
        twin.simulator = twin._finest = simulator
        return twin

    def approximated(self, values: Array, fine: Array) -> Problem:
        """The same problem with trials left to an approximation of the simulator, if it offers one: all whose residuals
        this gives at `values` (n,) within `FAITHFUL` of the residuals `fine` (m,), or within the noise, of every label.
        Trials that an earlier look has found to be missed stay with the simulator.
        """
        mixed = self.simulator if isinstance(self.simulator, Mixed) else self._mixed()
        if mixed is None:
            return self
        twin = self._twin()
        twin.simulator = mixed
        apart = twin.residuals(values[None])[0] - fine
        left = [k for k, trial in enumerate(self.trials) if trial.name not in mixed.exact]
        missed = {self.trials[k].name for k in left if not self._faithful(k, apart, fine)}
        if not missed:
            return twin
        exact = mixed.exact | missed
        twin = self._twin()
        all_missed = exact >= {trial.name for trial in self.trials}
        twin.simulator = mixed.whole if all_missed else replace(mixed, exact=exact)
        return twin

    def exactly(self) -> Problem:
        """The same problem without approximations of its simulator, now and later."""
        twin = self._twin()
        twin._exactly = True
        if isinstance(self.simulator, Mixed):
            twin.simulator = self.simulator.whole
        return twin

    def _mixed(self) -> Mixed | None:
        if self._controllers is not None or not isinstance(self._finest, Approximated):
            return None
        if self._exactly or self.duration < WORTH:
            return None
        other = self._finest.approximation(self.trials)
        return None if other is None else Mixed(self.simulator, other)

    def _faithful(self, trial: int, apart: Array, fine: Array) -> bool:
        """Whether residuals that are `apart` (m,) from others are nearly the same in all labels of a trial."""
        for segment in self.segments:
            if segment.trial == trial:
                distance, size = (np.linalg.norm(segment.shaped(r), axis=0) for r in (apart, fine))
                if not np.all(distance <= np.maximum(FAITHFUL * size, np.sqrt(segment.mask.sum(axis=0)))):
                    return False
        return True

    @property
    def approximate_part(self) -> Problem | None:
        """The trials that are left to an approximation, in it alone; None where there are none."""
        if not isinstance(self.simulator, Mixed):
            return None
        left = [(t, k) for t, k in zip(self.trials, self.owners, strict=True) if t.name not in self.simulator.exact]
        return self.replayed_by([t for t, _ in left], [k for _, k in left]).by(self.simulator.approximation)

    def shifted(self, offset: Array) -> Problem:
        """The same problem with `offset` (m,) added to all residuals."""
        twin = self._twin()
        twin._offset = offset if self._offset is None else self._offset + offset
        return twin

    def at_level(self, values: Array, fine: Array) -> Problem | None:
        """As `approximated`, with residuals that are `fine` (m,) at `values` (n,); None where the simulation fails there."""
        cheap = self.approximated(values, fine)
        offset = fine - cheap.residuals(values[None])[0]
        return cheap.shifted(offset) if np.isfinite(offset).all() else None

    def replayed_by(self, trials: Sequence[Trial], owners: Sequence[int]) -> Problem:
        """The same recordings replayed by other trials, each of the recording that `owners` names by its place."""
        twin = self._twin()
        twin._offset, twin.eliminated = None, ()
        twin._lay_out(trials, owners)
        return twin

    def with_starts(self, trials: Sequence[Trial], eliminated: Sequence[Eliminated]) -> Problem:
        """The same trials with other measurements of their starts, and corrections of these eliminated."""
        twin = self._twin()
        twin.trials, twin.eliminated, twin._offset = tuple(trials), tuple(eliminated), None
        return twin

    def shortened(self, longest: float) -> Problem:
        """The same problem on the first `longest` s of each trial."""
        return self.replayed_by([cut(t, t.start, longest) for t in self.trials], self.owners)

    @property
    def duration(self) -> float:
        """What one candidate simulates, in s."""
        return sum(t.duration for t in self.trials)

    @property
    def windowed(self) -> bool:
        """Whether recordings are replayed in parts, each from where the robot was measured to be then."""
        return len(self.trials) > len(self.recordings)

    def rollouts(self, values: Array, only: Sequence[int] | None = None) -> list[Rollout]:
        """The simulated trials, all or `only` some."""
        self._counted[0] += len(values)
        for hear in self.heard_by:
            hear(self.evaluations)
        trials = self.trials if only is None else [self.trials[k] for k in only]
        return self.simulator.rollout(trials, values, self._controllers)

    def residuals(self, values: Array, only: Sequence[int] | None = None) -> Array:
        """(b, m) noise-weighted residuals; a row is NaN where its simulation failed.

        With `only` those of some trials, as they are: no start correction is eliminated from them.
        """
        if only is not None:
            return self.plain_residuals(values, only)
        rows = np.atleast_2d(values)
        if len(rows) == 1 and self._last is not None and self._last[0] == rows.tobytes():
            return self._last[1].copy()
        residuals = self.plain_residuals(rows)
        for start in self.eliminated:
            start.apply(residuals)
        if self._offset is not None:
            residuals = residuals + self._offset
        if len(rows) == 1:
            self._last = rows.tobytes(), residuals.copy()
        self.visited.add(rows, residuals)
        return residuals

    def plain_residuals(self, values: Array, only: Sequence[int] | None = None) -> Array:
        """(b, m) simulated minus measured in units of the noise, whatever the starts are."""
        done = self.rollouts(np.atleast_2d(values), only)
        residuals = self._compared(done, range(len(self.trials)) if only is None else only)
        for rollout in done:
            residuals[list(rollout.failures)] = np.nan
        return residuals

    def start_residual(self, values: Array) -> Array:
        """(m,) at one set of values. Raises SimulationFailedError with the simulator's reasons."""
        done = self.rollouts(np.atleast_2d(values))
        if reasons := broken(done, self.simulator):
            raise SimulationFailedError(f"the simulation fails at the start values: {reasons}")
        return self._compared(done, range(len(self.trials)))[0]

    def _compared(self, done: Sequence[Rollout], which: Sequence[int]) -> Array:
        parts = []
        for k, rollout in zip(which, done, strict=True):
            part, mask = self.discrepancy.residual(self.recordings[self.owners[k]], rollout.held()), self._masks[k]
            parts.append(part if mask.all() else part[:, mask])
        return np.concatenate(parts, axis=1)

    def columns(self, trial: int) -> slice:
        """The part of the residual vector that a trial has."""
        own = [s.columns for s in self.segments if s.trial == trial]
        return slice(own[0].start, own[-1].stop)

    @property
    def main(self) -> tuple[str, str]:
        """The channel that replay errors are quoted in, and its unit: position if it is there."""
        names = [s.channel for s in self.segments]
        name = "position" if "position" in names else names[0]
        return name, next(s.unit for s in self.segments if s.channel == name)

    def rmse(self, residual: Array, recording: int | None = None) -> float:
        """Pooled replay error of the main channel in its unit, over all recordings or one."""
        name, _ = self.main
        own = [s for s in self.segments if s.channel == name and recording in (None, s.recording)]
        squares = sum(float(np.sum((residual[s.columns] * s.units) ** 2)) for s in own)
        return float(np.sqrt(squares / max(sum(s.count for s in own), 1)))

    def chance(self, residual: Array) -> float:
        """By how much fitting one more parameter to chance alone would lower the loss: the residuals' variance / 2,
        times the number of samples over which they stay alike (model errors last, noise does not).
        """
        variances, lasting = [], []
        for segment in self.segments:
            series, mask = segment.shaped(residual), segment.mask
            variance = np.sum(series**2, axis=0) / np.maximum(mask.sum(axis=0), 1)
            both = np.maximum((mask[1:] & mask[:-1]).sum(axis=0), 1)
            alike = np.sum(series[1:] * series[:-1], axis=0) / both / np.maximum(variance, TINY)
            some = mask.any(axis=0)
            variances += variance[some].tolist()
            lasting += ((1.0 + np.clip(alike, 0.0, 0.99)) / (1.0 - np.clip(alike, 0.0, 0.99)))[some].tolist()
        return 0.5 * float(np.mean(variances)) * float(np.median(lasting))

    def _segments(self) -> tuple[Segment, ...]:
        segments, first = [], 0
        for k, trial in enumerate(self.trials):
            at = 0
            for name, o in trial.observed.items():
                size = len(o.time) * len(o.labels)
                mask = self._masks[k][at : at + size].reshape(len(o.time), -1)
                scale = self.discrepancy.scale(name, o.labels)
                given = None if mask.all() else mask
                segments.append(Segment(k, self.owners[k], name, o.labels, o.unit, first, len(o.time), scale, given))
                first, at = segments[-1].columns.stop, at + size
        return tuple(segments)


def _trial(simulator: Simulator, recording: Recording, channels: Sequence[str] | None) -> Trial:
    seen = simulator.observable(recording)
    wanted = [c for c in seen if channels is None or c in channels]
    if not wanted:
        raise CalibrationError(
            f"recording '{recording.name}' has no channel that the simulator '{simulator.name}' reproduces; it has: "
            f"{', '.join(recording.channels)}"
        )
    return Trial.of(recording, wanted)
