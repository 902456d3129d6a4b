# SPDX-License-Identifier: Apache-2.0
"""A faster walk by two numbers found on the robot: how boldly it walks, and how it leans. Which way it falls tells both.

A walk that is too bold for a robot falls forward or backward, and its lean decides which: joints whose zeros are off and a
centre of mass that nobody knows let one robot fall on its nose where the next one falls on its back. So all runs together
tell, by two risks that compete, how either grows with boldness and lean (`risks.Risks`), and each trial is made where it
tells most of the walk that may be the best: mostly bolder than that one, since walks that never fall tell little. Doses
are found like this in medicine (J. O'Quigley, M. Pepe and L. Fisher, Biometrics 46, 1990).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from trueup.arrays import Array, Mask
from trueup.controllers.walk_engine.engine import PARAMETERS
from trueup.robots.robot import Robot
from trueup.studies.walk.evaluation import Runs, at_once, worth
from trueup.studies.walk.risks import Prior, Risks
from trueup.studies.walk.study import Budget, Story, Tried, lap_track, spent
from trueup.tasks.walking import LineWalk

_SWING, _PERIOD, _OFFSET = (PARAMETERS.index(n) for n in ("amp_swing", "stepPeriod", "fwdOffset"))
_CADENCE = 1.0 / 3.0  # steps are quicker by that power of the factor on their length: it costs fewer falls
_MIDDLE, _UNIT = np.log(1.5), 0.006  # of logarithms of the factor on steps; m of lean: a tenth of `fwdOffset`'s range
_PRIOR = Prior(
    np.array([[-3.5, 9.0, -1.0, 0.3, -0.5], [-3.5, 9.0, 1.0, 0.3, -0.5]]),
    np.array([[2.0, 3.0, 0.5, 0.3, 0.7], [2.0, 3.0, 0.5, 0.3, 0.7]]),
)
"""Log odds of a fall forward and backward in a run, with steps 1.5 times as long; by logarithm of steps, by lean and its
square, and for a robot that walks already: starting is a risk of its own. Rounded from fits to stand-ins 100 to 105, which
the study does not have, and about as wide as these differ; what starting adds is a guess."""
_FASTER = np.array([np.log(0.2), 1.0 + _CADENCE, 0.0, 0.0, 0.05]), np.array([1.0, 0.3, 0.1, 0.02, 0.05])
"""Mean and deviation of the logarithm of speed in m/s with such steps, likewise."""
_SCATTER = 0.04  # of the logarithm of a run's speed
_DRAWS = 200


@dataclass(frozen=True)
class Paces:
    """How boldly a robot may walk, and how it may lean, and how trials are spent on that."""

    steps: tuple[float, ...] = tuple(np.round(np.arange(1.0, 2.15, 0.1), 1).tolist())
    """Factors on the length of steps."""
    leans: tuple[float, ...] = (-0.009, -0.006, -0.003, 0.0, 0.003, 0.006, 0.009)
    """m by which the feet are set farther ahead, so that the body leans forward less."""
    bolder: float = 0.2
    """Of the logarithm of steps, and `shifted` m of lean: no trial is farther than that from one that was made."""
    shifted: float = 0.0065
    laps: int = 3
    """Lines behind one another of a trial: bold walks are quick, and there is time for three."""
    sure: float = 0.3
    """Share of the trials, the last ones, that are spent on the walk that is worth the most, and not to learn."""

    def grid(self) -> Array:
        """(g, 2) of steps and leans, gentle ones first."""
        return np.array([(s, x) for s in self.steps for x in self.leans])

    def walk(self, start: Array, pace: Array) -> Array:
        """(17,) of a start walk with steps so many times as long, quicker by a power of that, and so much lean."""
        steps, lean = pace
        values = start.copy()
        values[_SWING] *= steps
        values[_PERIOD] /= steps**_CADENCE
        values[_OFFSET] += lean
        low, high = np.array([(p.lower, p.upper) for p in PARAMETERS.parameters]).T
        return np.clip(values, low, high)


@dataclass
class Ledger:
    """Trials of paces, and what they say together."""

    paces: Array
    """(n, 2), each once."""
    runs: list[Runs] = field(default_factory=list)
    """All runs of each."""
    later: list[Runs] = field(default_factory=list)
    """Those of them that went on from a line, and did not start."""

    @property
    def trials(self) -> int:
        """On the robot."""
        return sum(r.trials for r in self.runs)

    def add(self, pace: Array, trial: Runs) -> None:
        """One more trial."""
        same = np.flatnonzero((self.paces == pace).all(axis=1))
        if not len(same):
            self.paces = np.vstack([self.paces, pace])
            self.runs.append(Runs())
            self.later.append(Runs())
        place = int(same[0]) if len(same) else -1
        went_on = replace(trial, speeds=trial.speeds[1:], recordings=()) if trial.speeds else Runs()
        self.runs[place] += trial
        self.later[place] += went_on

    def near(self, grid: Array, way: Paces) -> Mask:
        """(g,) which of a grid are near enough to a pace that was tried."""
        steps = np.abs(np.log(grid[:, None, 0] / self.paces[:, 0])) <= way.bolder
        leans = np.abs(grid[:, None, 1] - self.paces[:, 1]) <= way.shifted
        return np.any(steps & leans, axis=1)

    def risks(self) -> Risks:
        """Of falls forward and backward in a run from a stand; one that veered counts half as either."""
        all_, on = (np.array([_ended(r) for r in runs]).reshape(-1, 3) for runs in (self.runs, self.later))
        ended = np.vstack([all_ - on, on])
        return Risks.of(self._asked(), ended[:, :2], ended[:, 2], _PRIOR)

    def speeds(self, paces: Array) -> Array:
        """(b,) m/s that are expected of a run from a stand, by a line through the logarithms of all arrivals."""
        all_, on = (np.array([np.log(r.speeds).sum() for r in runs]) for runs in (self.runs, self.later))
        numbers = np.array(
            [(len(r.speeds) - len(o.speeds), len(o.speeds)) for r, o in zip(self.runs, self.later, strict=True)]
        )
        x, sums = self._asked(), np.concatenate([all_ - on, on])
        arrived = numbers.T.ravel() / _SCATTER**2
        mean, deviation = _FASTER
        curve = (x.T * arrived) @ x + np.diag(1.0 / deviation**2)
        return np.exp(asked(paces) @ np.linalg.solve(curve, x.T @ sums / _SCATTER**2 + mean / deviation**2))

    def _asked(self) -> Array:
        """(2 n, 5) of all paces, from a stand and from a line."""
        return np.vstack([asked(self.paces), asked(self.paces, going=1.0)])


def _ended(runs: Runs) -> tuple[float, float, float]:
    """How many fell forward, backward, and how many there were."""
    return runs.forward + runs.veers / 2.0, runs.falls - runs.forward + runs.veers / 2.0, float(runs.number)


def asked(paces: Array, going: float = 0.0) -> Array:
    """(b, 5) of what risks and speeds are linear in, for steps and leans (b, 2), from a stand or going already (1)."""
    lean = paces[:, 1] / _UNIT
    ones = np.ones(len(paces))
    return np.stack([ones, np.log(paces[:, 0]) - _MIDDLE, lean, lean**2, going * ones], axis=1)


def paced(
    robot: Robot, budget: Budget, seed: int, *, line: LineWalk | None = None, paces: Paces | None = None,
    told: Callable[[str], None] | None = None,
) -> Story:  # fmt: skip
    """The story of a robot on which the start walk's pace and lean are found, within the budget's trials and time.

    The first trials are of the start walk; what is worth the most in the end is one of the walks that were tried.
    """
    way, say = paces or Paces(), told or (lambda _: None)
    track = lap_track(line, replace(budget, laps=way.laps))
    rng, grid = np.random.default_rng([seed, budget.trials]), way.grid()
    ledger = Ledger(np.zeros((0, 2)))
    for k in range(budget.start):
        ledger.add(np.array([1.0, 0.0]), at_once(robot, track, PARAMETERS.nominal, 1, f" start {k}"))
    last = budget.trials - round(way.sure * budget.trials)
    while not spent(ledger.runs, budget):
        near = grid[ledger.near(grid, way)]
        risks, speeds = ledger.risks(), ledger.speeds(near)
        worths = worth(speeds, risks.drawn(asked(near), _DRAWS, rng).sum(axis=2), budget.fall)
        if ledger.trials < last:
            best, often = np.unique(worths.argmax(axis=1), return_counts=True)
            pick = int(risks.learned(asked(near), asked(near[best]), often / _DRAWS).argmax())
        else:
            pick = int(worths.mean(axis=0).argmax())
        values = way.walk(PARAMETERS.nominal, near[pick])
        runs = at_once(robot, track, values, 1, f" pace {seed} {ledger.trials}")
        ledger.add(near[pick], runs)
        say(f"trial {ledger.trials}: steps x {near[pick][0]:g}, lean {1e3 * near[pick][1]:+.0f} mm: {ended_in(runs)}")
    risks = ledger.risks().drawn(asked(ledger.paces), _DRAWS, rng).sum(axis=2)
    worths = worth(ledger.speeds(ledger.paces), risks, budget.fall).mean(axis=0)
    tried = zip(ledger.paces, ledger.runs, worths, strict=True)
    return Story(
        tuple(Tried(min(k, 1), way.walk(PARAMETERS.nominal, p), None, r, float(w)) for k, (p, r, w) in enumerate(tried))
    )


def ended_in(runs: Runs) -> str:
    """What became of a trial, in words."""
    if not runs.failed:
        return f"{100 * runs.speed:.1f} cm/s"
    return "fell forward" if runs.forward else "fell backward" if runs.falls else "veered"
