# SPDX-License-Identifier: Apache-2.0
"""Settings found on the robot itself, trial by trial, by how all of its runs ended (`loop.dosing`)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueup.arrays import Array
from trueup.campaign.events import Chosen, Scored
from trueup.campaign.outcomes import problems
from trueup.campaign.parts import Parts
from trueup.campaign.plan import Plan
from trueup.errors import PlanError, TrialError
from trueup.loop.dosing import SURE, Ledger
from trueup.loop.transfer import mean_score
from trueup.rounding import NEGLIGIBLE
from trueup.tasks.task import Graded


def doses_of(plan: Plan, parts: Parts) -> Doses | None:
    """Of a plan that tunes on the robot, None of another. Raises PlanError where its task has no grades, or where it would
    begin with several settings.
    """
    if plan.optimize.method != "on-robot":
        return None
    if not isinstance(parts.task, Graded):
        raise PlanError(
            f"[optimize], method = 'on-robot': task '{parts.task.name}' has no grades, as walks ahead have (course 'front' "
            "or 'line'); 'simulator' tunes any task"
        )
    if plan.experiment.settings != 1 or plan.experiment.later:
        raise PlanError(
            "[experiment]: method = 'on-robot' begins with what the robot runs with today: settings = 1, later = 0"
        )
    a_round = plan.transfer.candidates * plan.transfer.repeats
    runs = len(parts.task.trials) * (plan.experiment.repeats + plan.stop.rounds * a_round)
    return Doses(parts, parts.task, plan.seed, min(plan.stop.trials or runs, runs))


class Doses:
    """What is tried next on the robot and what is best, from the scores that a campaign has so far."""

    def __init__(self, parts: Parts, task: Graded, seed: int, runs: int) -> None:
        """`runs` are what there will be in all, of which the last ones are spent on the best."""
        self._parts, self._grades, self._seed = parts, task.grades(), seed
        self._units = parts.task.parameters.to_unit(self._grades.settings)
        self._learning = runs - round(SURE * runs)
        self._problems: dict[
            int, bool
        ] = {}  # grades whose simulated runs were looked at: whether they go beyond limits

    def chosen(self, number: int, scores: Sequence[Scored], runs: int) -> Chosen:
        """The next trial, after so many runs. Raises TrialError where no grade near those tried stays within the limits."""
        ledger, settled, barred = self._ledger(scores), runs >= self._learning, set[int]()
        while True:
            rng = np.random.default_rng([self._seed, runs])  # the same whatever was barred before an interruption
            grade = ledger.next(rng, settled=settled, barred=frozenset(barred))
            if grade is None:
                raise TrialError("no grade of the settings near those that were tried stays within the limits")
            if not self._beyond(grade):
                break
            barred.add(grade)
        expected = -ledger.expected(np.array([grade]), rng)
        why = "worth the most so far" if settled else "tells most of what may be the best"
        return Chosen(
            number, (tuple(self._units[grade].tolist()),), (float(expected.mean()),), (float(expected.std()),), -1,
            len(barred), why, (tuple(self._grades.numbers[grade].tolist()),),
        )  # fmt: skip

    def early(self, scores: Sequence[Scored], unit: Array) -> tuple[float, ...]:
        """Share of runs that is expected to end early with settings that were run, and its 95 % interval."""
        rng = np.random.default_rng([self._seed, len(scores), 1])
        return self._ledger(scores).early(self._at(unit), rng)

    def best(self, scores: Sequence[Scored]) -> tuple[Array, float]:
        """Settings in the unit box that are worth the most by all runs, and the mean score of their own.

        A fall of which nothing else is known scores what it costs; a run that was not done says nothing.
        """
        ledger = self._ledger(scores)
        grade, _ = ledger.best(np.random.default_rng([self._seed, len(scores)]))
        own = np.array([
            self._grades.cost if s.fell and np.isnan(x) else x
            for s in scores if self._grade(s) == grade for x in s.scores
        ])  # fmt: skip
        return self._units[grade], mean_score(own)

    @property
    def first(self) -> tuple[float, ...]:
        """The grade that the robot runs with today."""
        return tuple(self._grades.numbers[0].tolist())

    @property
    def names(self) -> tuple[str, ...]:
        """See `Grades.names`."""
        return self._grades.names

    @property
    def ways(self) -> tuple[str, ...]:
        """See `Grades.ways`."""
        return self._grades.ways

    def _beyond(self, grade: int) -> bool:
        if grade not in self._problems:
            model = self._parts.simulator.parameters.nominal
            self._problems[grade] = bool(problems(self._parts, self._units[grade], model))
        return self._problems[grade]

    def _ledger(self, scores: Sequence[Scored]) -> Ledger:
        ledger = Ledger(self._grades)
        for s in scores:
            grade = self._grade(s)
            if grade >= 0 and (s.tally or s.fell):
                ledger.add(grade, np.array(s.tally) if s.tally else self._fallen(len(s.scores)))
        return ledger

    def _grade(self, scored: Scored) -> int:
        return self._at(np.array(scored.unit))

    def _at(self, unit: Array) -> int:
        same = np.flatnonzero(np.abs(self._units - unit).max(axis=1) < NEGLIGIBLE)
        return int(same[0]) if len(same) else -1

    def _fallen(self, runs: int) -> Array:
        """Runs of which nothing is known but that they ended early."""
        ways = len(self._grades.ways)
        tally = np.zeros((2, 2 + ways))
        tally[0, 2:] = runs / ways
        return tally
