# SPDX-License-Identifier: Apache-2.0
"""Which of graded settings is best on a robot that has run few times: what all its runs say together of risk and worth.

Each trial is made where it tells most of the grade that may be the best: mostly bolder than that one, since runs that never
end early tell little. The last ones are of what is worth the most. Doses are found like this in medicine (J. O'Quigley,
M. Pepe and L. Fisher, Biometrics 46, 1990).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from trueup.arrays import Array, Integers, Mask
from trueup.loop.risks import Prior, Risks
from trueup.tasks.task import Grades

SURE = 0.3
"""Share of the trials, the last ones, that are spent on the grade that is worth the most, and not to learn. Without them what
is found is three times as far from the best; half or nearly twice as many do as well (`benchmarks/dosing.py`)."""
_DRAWS, _MANY = 200, 2000  # from the posterior: to choose by, and for an interval


@dataclass(eq=False)
class Ledger:
    """Trials of grades, and what they say together."""

    grades: Grades
    tried: list[int] = field(default_factory=list)
    """Grades that were run, each once, in the order of their first trial."""
    tallies: list[Array] = field(default_factory=list)
    """(2, 2 + w) of each, all its trials together; see `Graded.tally`."""

    def add(self, grade: int, tally: Array) -> None:
        """One more trial."""
        if grade in self.tried:
            place = self.tried.index(grade)
            self.tallies[place] = self.tallies[place] + tally
        else:
            self.tried.append(grade)
            self.tallies.append(np.asarray(tally, dtype=np.float64))

    def near(self) -> Mask:
        """(g,) which grades are near enough to one that was tried; the first one where none was."""
        places = self.grades.places
        off = np.abs(places[:, None] - places[self.tried or [0]]).max(axis=2)
        return np.any(off <= 1.0, axis=1) if self.tried else np.arange(len(places)) == 0

    def risks(self) -> Risks:
        """Of the ways in which a run ends early."""
        rows = self._rows()
        ended = rows[:, 2:]
        return Risks.of(self._features(), ended, rows[:, 0] + ended.sum(axis=1), Prior(*self.grades.risks))

    def worths(self, grades: Integers) -> Array:
        """(b,) what a run of each is worth that begins at rest and does not end early."""
        x, rows = self._features(), self._rows()
        known = rows[:, 0] / self.grades.scatter**2
        mean, deviation = self.grades.worth
        curve = (x.T * known) @ x + np.diag(1.0 / deviation**2)
        sums = x.T @ rows[:, 1] / self.grades.scatter**2 + mean / deviation**2
        return np.exp(self.grades.features[0, grades] @ np.linalg.solve(curve, sums))

    def expected(self, grades: Integers, rng: np.random.Generator) -> Array:
        """(draws, b) what runs of each are worth, early ends taken off, for risks drawn from the posterior."""
        shares = self.risks().sample_shares(self.grades.features[0, grades], _DRAWS, rng).sum(axis=2)
        return (1.0 - shares) * self.worths(grades) - self.grades.cost * shares

    def early(self, grade: int, rng: np.random.Generator) -> tuple[float, float, float]:
        """Share of its runs from rest that is expected to end early, by all runs of all grades, and its 95 % interval."""
        shares = self.risks().sample_shares(self.grades.features[0, [grade]], _MANY, rng).sum(axis=(1, 2))
        low, high = np.quantile(shares, (0.025, 0.975))
        return float(shares.mean()), float(low), float(high)

    def next(
        self, rng: np.random.Generator, *, settled: bool = False, barred: frozenset[int] = frozenset()
    ) -> int | None:
        """The grade to try now: the best if that is `settled`, else what tells most of it; None if all near are `barred`."""
        near = np.flatnonzero(self.near())
        near = near[~np.isin(near, list(barred))]
        if not len(near):
            return None
        expected = self.expected(near, rng)
        if settled:
            return int(near[expected.mean(axis=0).argmax()])
        best, often = np.unique(expected.argmax(axis=1), return_counts=True)
        x = self.grades.features[0, near]
        return int(near[self.risks().learned(x, x[best], often / _DRAWS).argmax()])

    def best(self, rng: np.random.Generator) -> tuple[int, Array]:
        """Of those that were tried the one that is worth the most, and (n,) what they are. Raises ValueError without any."""
        worths = self.expected(np.array(self.tried, dtype=np.int64), rng).mean(axis=0)
        return self.tried[int(worths.argmax())], worths

    def _rows(self) -> Array:
        """(2 n, 2 + w): of all tried, from rest, then going on."""
        tallies = np.array(self.tallies).reshape(len(self.tallies), 2, 2 + len(self.grades.ways))
        return np.concatenate([tallies[:, 0], tallies[:, 1]])

    def _features(self) -> Array:
        """(2 n, c), likewise."""
        known = self.grades.features[:, np.array(self.tried, dtype=np.int64)]
        return known.reshape(-1, known.shape[2])
