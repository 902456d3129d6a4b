# SPDX-License-Identifier: Apache-2.0
"""How boldly a robot walks, and how it leans, as grades of a walk's settings. Which way it falls tells both.

A walk that is too bold for a robot falls forward or backward, and its lean decides which: joints whose zeros are off and a
centre of mass that nobody knows let one robot fall on its nose where the next one falls on its back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array, Mask
from trueup.engines.simulator import Rollout
from trueup.errors import ParameterError
from trueup.parameters import ParameterSpace
from trueup.tasks.task import Grades

SLOWEST = 0.05
"""m/s: who is slower walks on the spot."""
WAYS = ("fell forward", "fell backward")
_MIDDLE = np.log(1.5)  # of logarithms of the factor on steps
_RISKS = (
    np.array([[-3.5, 9.0, -1.0, 0.3, -0.5], [-3.5, 9.0, 1.0, 0.3, -0.5]]),
    np.array([[2.0, 3.0, 0.5, 0.3, 0.7], [2.0, 3.0, 0.5, 0.3, 0.7]]),
)
"""Log odds of a fall forward and backward in a run, with steps 1.5 times as long; by logarithm of steps, by lean and its
square, and for a robot that walks already: starting is a risk of its own. Rounded from fits to stand-ins 100 to 105 of
`studies/walk`, which that study does not have, and about as wide as these differ; what starting adds is a guess."""


@dataclass(frozen=True)
class Paces:
    """Which grades there are, and by which of a walk's parameters."""

    steps: tuple[float, ...] = tuple(np.round(np.arange(1.0, 2.15, 0.1), 1).tolist())
    """Factors on the length of steps."""
    leans: tuple[float, ...] = (-1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5)
    """How much farther ahead the feet are set, so that the body leans forward less, in tenths of that parameter's range."""
    bolder: float = 0.2
    """Of the logarithm of steps, and `shifted` tenths of lean: no trial is farther than that from one that was made."""
    shifted: float = 1.1
    long: str = "amp_swing"
    slow: str = "stepPeriod"
    ahead: str = "fwdOffset"
    cadence: float = 1.0 / 3.0
    """Steps are quicker by that power of the factor on their length: it costs fewer falls."""
    scatter: float = 0.04
    """Deviation of the logarithm of speed from run to run."""

    def grades(self, space: ParameterSpace, fall: float) -> Grades:
        """Those of a walk with these parameters, of whose falls each costs `fall` m/s. Raises ParameterError."""
        lacking = [n for n in (self.long, self.slow, self.ahead) if n not in space.names or space[n].frozen]
        if lacking:
            raise ParameterError(
                f"pace and lean are set by {self.long}, {self.slow} and {self.ahead}; this walk's free parameters are "
                f"{', '.join(p.name for p in space.parameters if not p.frozen)}: say with `paces` which are meant"
            )
        pairs = np.array([(s, x) for s in self.steps for x in self.leans])
        first = np.flatnonzero((pairs == (1.0, 0.0)).all(axis=1))
        if not len(first):
            raise ParameterError("a factor of 1 and a lean of 0, which are today's walk, must be among the paces")
        pairs = np.concatenate([pairs[first], np.delete(pairs, first, axis=0)])
        settings = self._settings(pairs, space)
        low, high = np.array([(p.lower, p.upper) for p in space.parameters]).T
        within = ((settings >= low) & (settings <= high)).all(axis=1)  # cut at a bound they would be two grades in one
        pairs, settings = pairs[within], settings[within]
        unit = f" {space[self.ahead].unit}".rstrip()
        return Grades(
            (f"{self.long} {{:.3g}} times", f"{self.ahead} {{:+.2g}}{unit}"), pairs * (1.0, self._tenth(space)), settings,
            features(pairs),
            np.stack([np.log(pairs[:, 0]) / self.bolder, pairs[:, 1] / self.shifted], axis=1), WAYS, _RISKS, _FASTER,
            self.scatter, fall,
        )  # fmt: skip

    def _tenth(self, space: ParameterSpace) -> float:
        return 0.1 * (space[self.ahead].upper - space[self.ahead].lower)

    def _settings(self, pairs: Array, space: ParameterSpace) -> Array:
        """(g, m): steps so many times as long, quicker by a power of that, and so much lean."""
        values = np.tile(space.nominal, (len(pairs), 1))
        values[:, space.index(self.long)] *= pairs[:, 0]
        values[:, space.index(self.slow)] /= pairs[:, 0] ** self.cadence
        values[:, space.index(self.ahead)] += pairs[:, 1] * self._tenth(space)
        return values


_FASTER = np.array([np.log(0.2), 1.0 + Paces.cadence, 0.0, 0.0, 0.05]), np.array([1.0, 0.3, 0.1, 0.02, 0.05])
"""Mean and deviation of the logarithm of speed in m/s with such steps, likewise."""


def features(pairs: Array) -> Array:
    """(2, b, 5) of what risks and speeds are linear in, for steps and leans (b, 2), from a stand and going already."""
    steps, lean = pairs.T
    ones = np.ones(len(pairs))
    return np.stack([np.stack([ones, np.log(steps) - _MIDDLE, lean, lean**2, g * ones], axis=1) for g in (0.0, 1.0)])


def lap_speeds(time: Array, ahead: Array, lap: float, laps: int, start: float, arrived: float | None) -> list[float]:
    """m/s of each lap of `lap` m that a run came through, from how far ahead (T,) it was when, and when it `arrived`."""
    known = np.isfinite(ahead)
    farthest = np.maximum.accumulate(ahead[known]) if known.any() else np.zeros(1)
    lines = lap * np.arange(1, laps)
    reached = [float(np.interp(x, farthest, time[known])) for x in lines[lines <= farthest[-1]]]
    return [lap / float(lasted) for lasted in np.diff([start, *reached, *([] if arrived is None else [arrived])])]


def told_speeds(seconds: Sequence[float], lap: float) -> list[float]:
    """The same where only the times were taken."""
    return [lap / float(lasted) for lasted in np.diff([0.0, *seconds])]


def tallied(rollout: Rollout, speeds: Sequence[Sequence[float]], laps: int, fell: Mask, pitch: Array) -> Array:
    """(2, 4) as `Graded.tally` has it, from the speeds of laps that runs came through, which fell, and pitch (b, T) in rad.

    A run that veered or was too slow counts as half a fall to either side, as does one of which nobody measured the pitch
    or told to which side it fell.
    """
    tally = np.zeros((2, 2 + len(WAYS)))
    for row, done in enumerate(speeds):
        if row in rollout.failures:
            continue
        for k, part in enumerate((done[:1], done[1:])):
            tally[k, :2] += len(part), np.log(part).sum()
        if len(done) < laps:
            known = pitch[row][np.isfinite(pitch[row])]
            forward = rollout.watched[row].forward if row in rollout.watched else 0.5
            forward = float(known[-1] > 0.0) if fell[row] and len(known) else forward
            tally[min(len(done), 1), 2:] += forward, 1.0 - forward
    return tally
