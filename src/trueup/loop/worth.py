# SPDX-License-Identifier: Apache-2.0
"""Which parameters are worth calibrating: those on which the outcome hangs and that these recordings can tell.

J. Tan et al., IROS 2016, section VIII, leave this choice open and take 30. Here it is an optimal design turned round: the
expected error of the outcome (criterion V: A. C. Atkinson, A. N. Donev, R. D. Tobias, "Optimum Experimental Designs, with
SAS", 2007, chapter 10) with the bias of what is left out (G. E. P. Box and N. R. Draper, J. Am. Stat. Assoc. 54, 1959), on
average over slopes at several values that may be true (chapter 18): where robots fall and touch, one point says little.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.errors import CalibrationError
from trueup.loop.problem import Problem
from trueup.loop.whole_runs import weights
from trueup.parameters import ParameterSpace
from trueup.verdicts import PRIOR

MOVED = 0.01  # share of the box by which a parameter is moved to see its effect
SAMPLES = 50.0
"""Independent samples that a channel of a whole run is worth: what `whole_runs` weighs against its prior (1 / 0.02)."""


@dataclass(frozen=True)
class Worth:
    """What is to be thought of one parameter."""

    name: str
    chosen: bool
    effect: float
    """How far the outcome moves where the parameter is as wrong as it may well be, root mean square, in residuals."""
    information: float
    """Share of that doubt which the recordings take away, were it alone."""
    why: str


@dataclass(frozen=True, eq=False)
class Choice:
    """The parameters that are worth calibrating, and why each was taken or left."""

    rows: tuple[Worth, ...]
    """The first taken first, then those left, the largest effect first."""
    expected: tuple[float, float, float]
    """Error of the outcome, root mean square, in residuals: with none calibrated, with those taken, with all."""

    @property
    def chosen(self) -> tuple[str, ...]:
        """Their names."""
        return tuple(w.name for w in self.rows if w.chosen)

    @property
    def notes(self) -> tuple[str, ...]:
        """All of it in words."""
        none, some, everything = self.expected
        first = (
            f"{len(self.chosen)} of {len(self.rows)} parameters are worth calibrating: the outcome is expected to be off by "
            f"{some:.2g} residuals (by {everything:.2g} with all of them, by {none:.2g} with none)"
        )
        return (first, *(f"{w.name} {'taken' if w.chosen else 'left'}: {w.why}" for w in self.rows))

    def of(self, space: ParameterSpace) -> ParameterSpace:
        """The space without the others."""
        return space.left_out([w.name for w in self.rows if not w.chosen])


def worth_calibrating(
    problems: Sequence[Problem], space: ParameterSpace, outcomes: Sequence[Problem] = (), *, rng: np.random.Generator
) -> Choice:
    """Chooses among the free parameters of `space`, which all problems' simulators have.

    `problems` are the recordings that will be fitted, `outcomes` the motions that shall be foretold (default: the same). A
    parameter is believed to be anywhere in its range. The smallest set is looked for, one parameter after the
    other, with which the outcome is foretold as well as with all, but for what its mean is known to from a run's samples.
    Slopes are taken at the nominal values and at three that are drawn around them.
    Raises CalibrationError where nothing is free or nothing can be simulated.
    """
    names = [p.name for p in space.parameters if not p.frozen]
    free = range(len(names))
    if not names:
        raise CalibrationError("no parameter is free, so there is none to choose")
    begin, draws = np.clip(space.to_unit(space.nominal), 0.0, 1.0), 4
    away = 0.5 / np.sqrt(PRIOR) * rng.standard_normal((draws, len(names))) * (np.arange(draws) > 0)[:, None]
    points = np.clip(begin + away, 0.0, 1.0)
    seen = np.mean([_products(p, space, points) for p in problems], axis=0)
    wanted = np.mean([_products(p, space, points) for p in outcomes], axis=0) if outcomes else seen
    doubt = _Doubt(SAMPLES / PRIOR * seen, wanted / PRIOR)
    channels = len({s.channel for p in (outcomes or problems) for s in p.segments})
    everything, taken, now = doubt.left(list(free)), list[int](), doubt.left([])
    none = now
    while now > everything + channels / SAMPLES:
        others = [j for j in free if j not in taken]
        found = [doubt.left([*taken, j]) for j in others]
        best = int(np.argmin(found))
        if found[best] >= now:
            break
        taken, now = [*taken, others[best]], found[best]
    rows = [Worth(names[j], True, *doubt.of(j), doubt.because(j)) for j in taken]
    left = sorted(set(free) - set(taken), key=lambda j: -doubt.of(j)[0])
    rows += [Worth(names[j], False, *doubt.of(j), doubt.why_left(j, taken, names, channels)) for j in left]
    return Choice(tuple(rows), (np.sqrt(none).item(), np.sqrt(now).item(), np.sqrt(everything).item()))


class _Doubt:
    """What is left of the outcome's mean square error; parameters in units of how wrong they may be.

    `information` and `outcome` (draws, n, n) are products of slopes at several points.
    """

    def __init__(self, information: Array, outcome: Array) -> None:
        self._all = list(zip(information, outcome, strict=True))
        self._information, self._outcome = information.mean(axis=0), outcome.mean(axis=0)

    def left(self, some: Sequence[int]) -> float:
        """With these calibrated: what they leave open, what the others bias, and what noise adds."""
        s, found = list(some), []
        for a, h in self._all:
            errors = np.eye(len(a))  # of all, by how wrong each parameter is: the fit changes rows of those calibrated
            noise = np.zeros_like(a)
            if s:
                inverse = np.linalg.inv(a[np.ix_(s, s)] + np.eye(len(s)))
                errors[s] -= inverse @ a[s]
                noise[np.ix_(s, s)] = inverse @ a[np.ix_(s, s)] @ inverse
            found.append(np.sum(h * (errors @ errors.T + noise)))
        return float(np.mean(found))

    def of(self, j: int) -> tuple[float, float]:
        """A parameter's effect on the outcome, and the share of its doubt that goes."""
        return float(np.sqrt(self._outcome[j, j])), float(1.0 - 1.0 / np.sqrt(1.0 + self._information[j, j]))

    def because(self, j: int) -> str:
        """Why one was taken."""
        effect, told = self.of(j)
        return f"the outcome moves by {effect:.2g} where it is wrong, and the recordings take {100 * told:.0f} % of its doubt"

    def why_left(self, j: int, taken: Sequence[int], names: Sequence[str], channels: int) -> str:
        """Why one was left."""
        effect, _ = self.of(j)
        if effect**2 < channels / SAMPLES:
            return f"the outcome hardly depends on it (it moves by {effect:.2g})"
        if self._information[j, j] < 1.0:
            return f"the outcome moves by {effect:.2g} where it is wrong, but these recordings leave it open"
        a = self._information
        alike = [abs(a[j, k]) / np.sqrt(max(a[j, j] * a[k, k], 1e-300)) for k in taken]
        if not taken:
            return "nothing that can be calibrated makes the outcome any surer"
        return f"what it does to the recordings is done by those taken, most of all by {names[taken[int(np.argmax(alike))]]}"


def _products(problem: Problem, space: ParameterSpace, points: Array) -> Array:
    """(draws, f, f) products of weighted slopes of the residuals at points (draws, f) of the unit box."""
    each = np.stack([slopes(problem, space, at) for at in points])
    if not each.any():
        raise CalibrationError("no free parameter changes anything in these recordings, or none can be simulated")
    return each @ each.transpose(0, 2, 1)


def slopes(problem: Problem, space: ParameterSpace, at: Array) -> Array:
    """(f, m) weighted residuals by free parameters, in shares of the box; 0 where a simulation failed."""
    f = np.arange(len(at))
    points = np.repeat(at[None], 2 * len(at), axis=0)  # to both sides: what bends is no difference between parameters
    points[f, f], points[len(at) + f, f] = np.minimum(at + MOVED, 1.0), np.maximum(at - MOVED, 0.0)
    residuals = problem.residuals(space.from_unit(points))
    width = points[f, f] - points[len(at) + f, f]
    found = (residuals[: len(at)] - residuals[len(at) :]) / width[:, None] * weights(problem)
    return np.where(np.isfinite(found), found, 0.0)
