# SPDX-License-Identifier: Apache-2.0
"""What the recordings show of the robot that the simulator lacks, and what the estimates would be with it.

Least squares put what a model lacks into the parameters that it has: a gear that twists looks like a heavier rotor, and
no residual tells how far off that is. Where the simulator does not explain the recordings, structures that it could have
are tried: each by a score test (C. R. Rao, Proc. Cambridge Phil. Soc. 44, 1948: how much lower would the loss be, once all
else has made up for it?), the best of them by a fit, and kept by the rule of evidence.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.engines.simulator import related_of
from trueup.errors import CalibrationError, SimulationFailedError
from trueup.evidence import Evidence
from trueup.loop.descent import Fit, Watch, explained
from trueup.loop.fit import DESCENT, REFINEMENT, SHIPPED, Stage, fit
from trueup.loop.problem import WORTH, Problem
from trueup.loop.selection import compared
from trueup.loop.ties import EXCERPT
from trueup.loop.uncertainty import PRIOR, intervals, unit_covariance
from trueup.loop.validate import by_stretch, cautious_errors
from trueup.parameters import Parameter, ParameterSpace

# Shares of the way to a bound at which parameters are looked at: what cannot be less than none has no slope there.
_SIZES = 10.0 ** np.arange(-3.75, 0.0, 0.75)
_ASTRAY = 0.25  # share of the loss of where a fit began: errors half as large
_SIGNED = 10.0 ** np.array([-1.5, -0.75])  # to either side of what a model has


@dataclass(frozen=True, eq=False)
class Missing:
    """A structure that the simulator lacks: what it would be, and the estimates with it."""

    name: str
    parameters: tuple[Parameter, ...]
    """Those of the structure; then `values`, `low`, `high` are theirs behind those of the simulator's free ones."""
    values: Array
    low: Array
    high: Array
    shown: Evidence

    def words(self) -> str:
        """What it is and what it would gain, for the user."""
        first = len(self.values) - len(self.parameters)
        rows = zip(self.parameters, self.values[first:], self.low[first:], self.high[first:], strict=True)
        sizes = ", ".join(f"{p.name} {v:.3g} [{lo:.3g}, {hi:.3g}] {p.unit}".rstrip() for p, v, lo, hi in rows)
        undecided = f"the recordings leave it open whether the robot has {self.name}, which the model lacks: {sizes}"
        if not self.shown.holds:
            return undecided
        return (
            f"the recordings are replayed better with {self.name}, which the model lacks: {sizes}. With it left-out errors "
            f"are {100 * np.exp(-self.shown.gain):.0f} % of what they are. It may stand for something else that is wrong (a "
            "mass, a parameter that is not declared); if not, declare it, from there, to have it in the model"
        )


def missing(problem: Problem, found: Fit) -> Missing | None:
    """The structure that the simulator lacks by the recordings' evidence, or else the one that they favour most; None where
    it explains them, or none of those that are known is favoured.
    """
    # Long recordings are searched joint by joint, which knows no gears: trying them there would double the time.
    if explained(found.residual) or problem.eliminated or problem.duration > WORTH:
        return None
    part = problem
    if problem.duration > EXCERPT:
        part = problem.shortened(EXCERPT / len(problem.trials))
        found = fit(part, found.space, found.values, Watch(), stages=REFINEMENT)
    without, tried = cautious_errors(part, found, by_stretch(part)), []
    for place, stages in _places_to_look_from(part, found):
        tried += _tried(part, place, stages, without)
    holding = [m for m in tried if m.shown.holds]
    return max(holding or tried, key=lambda m: m.shown.gain, default=None)


def _places_to_look_from(problem: Problem, found: Fit) -> list[tuple[Fit, Sequence[Stage]]]:
    """Where a fit ended, and where it began if it did not get far from there: what the model lacks has led it astray, and
    nothing can be seen from where it is.
    """
    first = np.where(found.space.free, found.space.nominal, found.values)
    try:
        begun = fit(problem, found.space, first, Watch(), stages=SHIPPED)
    except (
        SimulationFailedError,
        CalibrationError,
    ):  # nominal values beside what was set since
        return [(found, REFINEMENT)]
    return [(found, REFINEMENT), *([(begun, DESCENT)] if found.loss > _ASTRAY * begun.loss else [])]


def _tried(problem: Problem, place: Fit, stages: Sequence[Stage], without: Array) -> list[Missing]:
    """The structures that a score test at a place favours most, fitted from there, up to one that the evidence holds for."""
    related, tried = related_of(problem.simulator), list[Missing]()
    others = {} if related is None else dict(related.structures())
    looks = [_scanned(problem.by(other), place, len(place.space), name) for name, other in others.items()]
    worth = problem.chance(place.residual)
    for look in sorted(looks, key=lambda look: -look.gain)[:2]:  # each costs about as much as a quarter of the fit
        if look.gain > worth * max(len(look.sizes), 1):
            fitted = _fitted(problem.by(others[look.name]), place, look, stages, without)
            tried += [fitted] if fitted is not None and fitted.shown.gain > 0.0 else []
            if tried and tried[-1].shown.holds:
                break
    return tried


@dataclass(frozen=True)
class _Look:
    """How large the parameters of a structure are by the score test, by name, and how much lower the loss would be."""

    name: str
    sizes: dict[str, float]
    gain: float


def _scanned(problem: Problem, found: Fit, own: int, name: str) -> _Look:
    """The sizes of a structure's parameters, behind the simulator's `own`: each alone, then added, the best first."""
    more = problem.simulator.parameters.parameters[own:]
    base = np.concatenate([found.values, [p.nominal for p in more]])
    places = [_places(p) for p in more]
    rows = np.repeat(base[None], 1 + sum(map(len, places)), axis=0)
    rows[np.arange(1, len(rows)), np.repeat(np.arange(own, len(base)), [len(at) for at in places])] = np.concatenate(
        places
    )
    residuals = problem.residuals(rows)
    root = np.sqrt(found.weights)
    slopes = found.jacobian * root[:, None]
    curvature = slopes.T @ slopes + PRIOR * np.eye(slopes.shape[1])
    inverse = np.linalg.inv(curvature)

    def left(residual: Array) -> float:
        error = residual * root
        slope = slopes.T @ error
        loss = 0.5 * float(error @ error - slope @ inverse @ slope)
        return loss if np.isfinite(loss) else np.inf

    lowest = before = left(residuals[0])
    losses = np.split([left(r) for r in residuals[1:]], np.cumsum([len(at) for at in places])[:-1])
    worth, taken = problem.chance(found.residual), base
    for k in np.argsort([np.min(after) for after in losses], kind="stable"):
        # what does nothing by itself (where a spring rests that has no stiffness) belongs to what was taken
        beside = np.all(losses[k] == before)
        if not beside and not np.min(losses[k]) < before - worth:
            continue  # what gains nothing alone is not simulated again beside what was taken
        tried = places[k] if beside else places[k][[np.argmin(losses[k])]]
        rows = np.repeat(taken[None], len(tried), axis=0)
        rows[:, own + k] = tried
        after = [left(r) for r in problem.residuals(rows)]
        if min(after) < (lowest if beside else lowest - worth):
            lowest, taken = min(after), rows[int(np.argmin(after))]
    sizes = {p.name: float(v) for p, v in zip(more, taken[own:], strict=True) if v != p.nominal}
    return _Look(name, sizes, before - lowest)


def _places(p: Parameter) -> Array:
    """(P,) values at which a parameter is looked at."""
    if p.nominal <= p.lower:
        return p.nominal + _SIZES * (p.upper - p.nominal)
    return np.concatenate([p.nominal - _SIGNED * (p.nominal - p.lower), p.nominal + _SIGNED * (p.upper - p.nominal)])


def _fitted(problem: Problem, found: Fit, look: _Look, stages: Sequence[Stage], without: Array) -> Missing | None:
    """The fit with a structure, from where the score test has it; None where the simulation fails with it."""
    more = problem.simulator.parameters.parameters[len(found.space) :]
    space = ParameterSpace((*found.space.parameters, *more)).freeze([p.name for p in more if p.name not in look.sizes])
    start = np.concatenate([found.values, [look.sizes.get(p.name, p.nominal) for p in more]])
    try:
        grown = fit(problem, space, start, Watch(), stages=stages)
    except (CalibrationError, SimulationFailedError):
        return None
    shown = compared(without, cautious_errors(problem, grown, by_stretch(problem)))
    low, high = intervals(grown, unit_covariance(problem, grown))
    free = space.free
    return Missing(look.name, tuple(p for p in more if p.name in look.sizes), grown.values[free], low, high, shown)
