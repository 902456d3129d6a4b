# SPDX-License-Identifier: Apache-2.0
"""How much lower the loss would be with a structure that the simulator lacks, without a fit: a score test.

What a structure does to the residuals is simulated at a few sizes, and all else makes up for it as the slopes of the fit
without it foretell (C. R. Rao, Proc. Cambridge Phil. Soc. 44, 1948).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from trueup.arrays import Array
from trueup.engines.simulator import Simulator
from trueup.loop.descent import Fit
from trueup.loop.problem import Problem
from trueup.parameters import Parameter
from trueup.rounding import TINY
from trueup.verdicts import PRIOR

# Shares of the way to a bound at which parameters are looked at: what cannot be less than none has no slope there.
SIZES = 10.0 ** np.arange(-3.75, 0.0, 0.75)


@dataclass(frozen=True, eq=False)
class Look:
    """A structure by the score test."""

    name: str
    sizes: Mapping[str, float]
    """How large its parameters are, by name."""
    gain: float
    """How much lower the loss would be."""
    lower: float
    """How much lower errors would be: ln(error without / error with)."""
    values: Array
    """(n,) values of the simulator's own parameters, to fit them from."""


@dataclass(frozen=True, eq=False)
class Scan:
    """Recordings on which structures are looked at: all that were fitted, or some of them."""

    problem: Problem
    fit: Fit
    chance: float
    """How much lower the loss of all that was fitted would be with one more parameter by chance alone."""
    _root: Array
    """(m,) roots of the robust weights."""
    _slopes: Array
    """(m, n_free) of the weighted residuals."""
    _pull: Array
    """(n_free,) slope of the loss of what else was fitted."""
    _inverse: Array
    """(n_free, n_free) of the curvature of the loss of all that was fitted."""

    @classmethod
    def of(
        cls, problem: Problem, found: Fit, part: Problem | None = None, rows: NDArray[np.intp] | None = None
    ) -> Scan:
        """Of a problem, or of a `part` whose residuals have the places `rows` among those of the problem."""
        root, chance = np.sqrt(found.weights), problem.chance(found.residual)
        slopes, error = found.jacobian * root[:, None], found.residual * root
        curvature = slopes.T @ slopes + PRIOR * np.eye(slopes.shape[1])
        inverse = np.asarray(np.linalg.inv(curvature), dtype=np.float64)
        if part is None or rows is None:
            return cls(problem, found, chance, root, slopes, np.zeros(len(inverse)), inverse)
        own, pull = slopes[rows], slopes.T @ error - slopes[rows].T @ error[rows]
        return cls(part, found, chance, root[rows], own, pull, inverse)

    @classmethod
    def as_it_is(cls, problem: Problem, begun: Fit) -> Scan:
        """With all else as it stands: where a search begins, far from any recording, slopes foretell nothing."""
        root, none = np.sqrt(begun.weights), np.zeros((len(begun.residual), 0))
        return cls(problem, begun, problem.chance(begun.residual), root, none, np.zeros(0), np.zeros((0, 0)))

    @cached_property
    def _before(self) -> float:
        """The loss without any structure, as it is replayed anew: what a fit corrected at starts is not in it."""
        return self.left(self.problem.residuals(self.fit.values[None])[0])

    def left(self, residual: Array) -> float:
        """The loss of residuals (m,) once all else has settled."""
        error = residual * self._root
        slope = self._pull + self._slopes.T @ error
        loss = 0.5 * float(error @ error - slope @ self._inverse @ slope)
        return loss if np.isfinite(loss) else np.inf

    def favoured(self, structures: Mapping[str, Simulator]) -> list[Look]:
        """Those of some structures that gain more than their parameters would by chance, the best first."""
        looks = [self.look(name, simulator) for name, simulator in structures.items()]
        some = [look for look in looks if look.gain > self.chance * max(len(look.sizes), 1)]
        return sorted(some, key=lambda look: -look.gain)

    def look(self, name: str, simulator: Simulator) -> Look:
        """The sizes of what a `simulator` has behind the parameters of the fit: each alone, then added, the best first."""
        own, problem = len(self.fit.space), self.problem.by(simulator)
        more = simulator.parameters.parameters[own:]
        taken = np.concatenate([self.fit.values, [p.nominal for p in more]])
        places = [_places(p) for p in more]
        rows = np.repeat(taken[None], 1 + sum(map(len, places)), axis=0)
        rows[np.arange(1, len(rows)), np.repeat(np.arange(own, len(taken)), [len(at) for at in places])] = (
            np.concatenate(places)
        )
        before, *each = (self.left(r) for r in problem.residuals(rows))
        losses, lowest = np.split(np.array(each), np.cumsum([len(at) for at in places])[:-1]), before
        for k in np.argsort([np.min(after) for after in losses], kind="stable"):
            # what does nothing by itself (where a spring rests that has no stiffness) belongs to what was taken
            beside = bool(np.all(losses[k] == before))
            if not beside and not np.min(losses[k]) < before - self.chance:
                continue  # what gains nothing alone is not simulated again beside what was taken
            tried = places[k] if beside else places[k][[np.argmin(losses[k])]]
            rows = np.repeat(taken[None], len(tried), axis=0)
            rows[:, own + k] = tried
            after = [self.left(r) for r in problem.residuals(rows)]
            if min(after) < (lowest if beside else lowest - self.chance):
                lowest, taken = min(after), rows[int(np.argmin(after))]
        sizes = {p.name: float(v) for p, v in zip(more, taken[own:], strict=True) if v != p.nominal}
        # A second joint within a gear replays worse where feet touch, though nothing twists: to make up for that is no gain.
        before = min(before, self._before)
        if not np.isfinite(lowest):  # nothing of it can be simulated
            return Look(name, sizes, -np.inf, -np.inf, self.fit.values)
        lower = 0.5 * float(np.log(max(before, TINY) / max(lowest, TINY)))
        return Look(name, sizes, before - lowest, lower, self.fit.values)


def missed(problem: Problem, found: Fit, held: Sequence[Parameter], need: float) -> list[Parameter]:
    """Those of some parameters that are `held` in a fit without which its loss is more than `need` lower, by score tests."""
    scan, names = Scan.of(problem, found), [p.name for p in found.space.parameters]
    places = [_places(p) for p in held]
    rows = np.repeat(found.values[None], 1 + sum(map(len, places)), axis=0)
    columns = np.repeat([names.index(p.name) for p in held], [len(at) for at in places])
    rows[np.arange(1, len(rows)), columns] = np.concatenate(places)
    before, *after = (scan.left(r) for r in problem.residuals(rows))
    lowest = (np.min(own) for own in np.split(np.array(after), np.cumsum([len(at) for at in places])[:-1]))
    return [p for p, loss in zip(held, lowest, strict=True) if loss < before - need]


def _places(p: Parameter) -> Array:
    """(P,) values at which a parameter is looked at."""
    if p.nominal <= p.lower:
        return p.nominal + SIZES * (p.upper - p.nominal)
    large = np.append(SIZES[-2:], 0.5)  # to either side of what a model has; half the way to what it may carry
    return np.concatenate([p.nominal - large * (p.nominal - p.lower), p.nominal + large * (p.upper - p.nominal)])
