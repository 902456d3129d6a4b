# SPDX-License-Identifier: Apache-2.0
"""What was frozen since the recordings did not tell it: asked again where the fit has come to, and counted as open.

What is held at a start value is not known by that. What of it others would make up for is part of their intervals, which
are those that they would have were it free, with nothing known of it but its bounds (nuisance parameters with a prior:
Tapley, Schutz and Born, Statistical Orbit Determination, 2004, 6.4).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueup.arrays import Array
from trueup.calibration import Estimate
from trueup.loop.descent import Descent, Fit, Look
from trueup.loop.identifiability import NO_EFFECT
from trueup.loop.problem import Problem
from trueup.loop.stages import Run
from trueup.loop.uncertainty import unit_covariance
from trueup.parameters import Parameter, ParameterSpace
from trueup.search.bounded_step import damped_step, gain
from trueup.search.robust import robust_losses
from trueup.verdicts import Verdict, vague

_ASIDE = 0.05  # share of the box over which slopes are taken: beyond the stairs of delays, and open that far anyway


def asked_again(run: Run) -> None:
    """Frees what was frozen, where the recordings tell it now that all else has come further and speak against the value at
    which it is held, and searches on; it stays frozen where that gains no more than chance.
    """
    while run.untold and run.looks and not run.look.problem.duration < run.problem.duration:
        before, descent = run.descent, _thawed(run.descent, run.look, run.untold)
        if descent is None:
            break
        run.descent = descent
        run.again()
        if not _gained(run, descent, before):
            run.descent = before
            break
        descent.watch = before.watch
        descent.finished(run.look, again=True)  # what was freed must be told by slopes there, or is frozen at the end
        run.untold = {n: p for n, p in run.untold.items() if descent.space[n].frozen}


def _gained(run: Run, descent: Descent, before: Descent) -> bool:
    """Whether a search has ended lower than the one before it, by more than what chance gives for all that was freed."""
    found, fit = descent.finished(run.look), before.finished(run.look)
    freed = len(found.unit) - len(fit.unit)
    new, old = robust_losses(np.stack([found.residual, fit.residual]), found.bend)
    return bool(new < old - freed * run.look.problem.chance(found.residual))


def _thawed(descent: Descent, look: Look, untold: Mapping[str, Parameter]) -> Descent | None:
    """The search with those of the frozen parameters `untold` free again that the recordings tell where it has come to by
    now; None where these are none, or promise no more than chance.
    """
    found = descent.finished(look)
    wider = _Wider.of(look.cheap, found, [_in_value(p) for p in untold.values()])
    told = wider.identified(look.problem)
    promise, reached = wider.promise(told) if told else (0.0, {})
    if not told or promise < look.problem.chance(found.residual) * len(told):
        return None
    space = ParameterSpace(tuple(untold[p.name] if p.name in told else p for p in descent.space.parameters))
    again, begin = replace(descent, space=space, search=None, watch=descent.watch.aside()), found.values.copy()
    for name, value in reached.items():
        begin[space.index(name)] = value
    again.restart(np.clip(space.to_unit(begin), 0.0, 1.0))
    return again


def _in_value(p: Parameter) -> Parameter:
    """On a linear scale what may be none at all: at next to nothing of a rotor's inertia no logarithm has a slope."""
    return p.replace(scale="linear") if p.vanishes else p


def open_covariance(problem: Problem, fit: Fit, untold: Sequence[Parameter]) -> tuple[Array, Array]:
    """(n_free, n_free) covariance in the unit box with the frozen parameters `untold` (as declared) open, and (n_free, k) the
    variance that each estimate shares with each of them.
    """
    wider = _Wider.of(fit.near or fit.shot or problem, fit, untold)
    covariance, n = wider.covariance(problem, range(len(untold))), len(fit.unit)
    between, own = covariance[:n, n:], np.diag(covariance)[n:]
    return covariance[:n, :n], between**2 / own


def as_open(
    estimates: Sequence[Estimate],
    known: Sequence[Verdict],
    opened: Sequence[Verdict],
    shared: Array,
    untold: Sequence[str],
) -> tuple[Estimate, ...]:
    """Estimates with words where what would be identified is not, as others stay open: verdicts `known` take the frozen ones
    `untold` as known, `opened` do not, `shared` is that of `open_covariance`. Limits have their own (`limits.py`).
    """
    free, rows = iter(zip(known, opened, shared, strict=True)), []
    for e in estimates:
        if e.fitted:
            verdict, when_open, common = next(free)
            hidden = verdict.word == "identified" and when_open.word in ("weak", "not identified")
            if hidden and e.verdict in ("weak", "not identified"):
                share = f"to {50 * (e.high - e.low) / abs(e.value):.0f} % only, " if e.value else ""
                note = f"known {share}as these recordings do not tell {untold[int(np.argmax(common))]}"
                e = replace(e, verdict="weak", note=note)
        rows.append(e)
    return tuple(rows)


@dataclass(frozen=True, eq=False)
class _Wider:
    """A fit, and the slopes of what is frozen in it."""

    fit: Fit
    untold: tuple[Parameter, ...]
    columns: Array
    """(m, k) d residual / d unit."""

    @classmethod
    def of(cls, problem: Problem, fit: Fit, untold: Sequence[Parameter]) -> _Wider:
        """With slopes by `problem`, towards the middle of the box."""
        rows, steps = np.repeat(fit.values[None], 1 + len(untold), axis=0), np.zeros(len(untold))
        for k, p in enumerate(untold):
            alone, i = ParameterSpace((p,)), fit.space.index(p.name)
            here = float(np.clip(alone.to_unit(fit.values[i : i + 1])[0], 0.0, 1.0))
            steps[k] = _ASIDE if here < 0.5 else -_ASIDE
            rows[1 + k, i] = float(alone.from_unit(np.array([here + steps[k]]))[0])
        residuals = problem.residuals(rows) if untold else fit.residual[None]
        columns = (residuals[1:] - residuals[0]) / steps[:, None]
        columns[~np.isfinite(columns).all(axis=1)] = 0.0
        return cls(fit, tuple(untold), columns.T)

    def promise(self, some: Collection[str]) -> tuple[float, dict[str, float]]:
        """By how much the loss would fall with `some` of the frozen ones free, as slopes foretell it: a score test
        (C. R. Rao, Proc. Cambridge Phil. Soc. 44, 1948); and where those would be that have no slope on their own scale.
        """
        fit, free = self.fit, [k for k, p in enumerate(self.untold) if p.name in some]
        jacobian = np.hstack([fit.jacobian, self.columns[:, free]])
        weighted, inside = jacobian * fit.weights[:, None], np.concatenate([fit.unit, np.full(len(free), 0.5)])
        curvature, slope = jacobian.T @ weighted, weighted.T @ fit.residual
        n = len(fit.unit)
        steps = [damped_step(curvature[:k, :k], slope[:k], 1e-6, inside[:k]) for k in (len(inside), n)]
        gains = [gain(curvature[: len(s), : len(s)], slope[: len(s)], s) for s in steps]
        reached = {}
        for p, step in zip((self.untold[k] for k in free), steps[0][n:].tolist(), strict=True):
            if p.scale != fit.space[p.name].scale:
                value = fit.values[fit.space.index(p.name)] + step * (p.upper - p.lower)
                reached[p.name] = float(np.clip(value, p.lower, p.upper))
        return gains[0] - gains[1], reached

    def covariance(self, problem: Problem, some: Sequence[int]) -> Array:
        """(n_free + k, n_free + k) in the unit box, with `some` of the frozen ones free."""
        n, jacobian = len(self.fit.unit), np.hstack([self.fit.jacobian, self.columns[:, list(some)]])
        scatter = None if self.fit.scatter is None else np.pad(self.fit.scatter, (0, jacobian.shape[1] - n))
        return unit_covariance(problem, replace(self.fit, jacobian=jacobian, scatter=scatter))

    def identified(self, problem: Problem) -> set[str]:
        """Names of those that the recordings tell with all else free; of several that stand for one another those with the
        strongest effects.
        """
        effect = np.sqrt(np.mean(self.columns**2, axis=0))
        n, kept = len(self.fit.unit), [k for k in range(len(self.untold)) if effect[k] >= NO_EFFECT]
        while kept:
            spread = np.sqrt(np.maximum(np.diag(self.covariance(problem, kept))[n:], 0.0))
            loose = [k for k, s in zip(kept, spread, strict=True) if vague(s)]
            if not loose:
                break
            kept.remove(min(loose, key=lambda k: effect[k]))
        return {self.untold[k].name for k in kept}
