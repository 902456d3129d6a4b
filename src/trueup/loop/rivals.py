# SPDX-License-Identifier: Apache-2.0
"""Structures that the recordings neither ask for nor rule out, and what the estimates would be with them.

Short recordings of few motions are replayed as well with a spring, a punch or a gear that twists as without, and estimates
follow: their intervals hold for the structure of the model alone. Each structure that a robot might have is looked at along
its size, with all else settled anew, as far as the recordings leave it open: a profile likelihood (W. Q. Meeker and
L. A. Escobar, Am. Statistician 49, 1995), over models as well as over values (D. Draper, J. R. Stat. Soc. B 57, 1995).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueup.arrays import Array
from trueup.calibration import Estimate
from trueup.engines.simulator import related_of
from trueup.evidence import half_interval
from trueup.loop.descent import Fit
from trueup.loop.problem import WORTH, Problem
from trueup.loop.scans import SIZES
from trueup.loop.uncertainty import FORETOLD, INEXACT
from trueup.parameters import Parameter
from trueup.search.bounded_step import damped_step
from trueup.search.robust import robust_losses

_FACTORS = np.array([0.25, 0.625])
"""Shares of the logarithm of its range at which what may be wrong by a factor is looked at; the second where the recordings
leave the first open."""
SAME = 0.1  # share of a value by which it may be another with what a model lacks, and be called identified


@dataclass(frozen=True, eq=False)
class Rival:
    """A structure with one parameter above none, and how far the estimates would be moved by as much as is left open."""

    name: str
    parameter: Parameter
    down: Array
    """(n_free,) of each free parameter, in its unit; not negative."""
    up: Array
    held: bool = False
    """Whether it is no structure, but a parameter that is held where nobody knows it to be."""

    @property
    def doubt(self) -> str:
        """What estimates hang on that it moves."""
        return self.name if self.held else f"whether the robot has {self.name}"


def rivals(problem: Problem, found: Fit) -> tuple[Rival, ...]:
    """What the recordings do not rule out, structure by structure. None for long recordings: these are searched in an
    approximation, which knows no gears, and tell more.
    """
    if problem.duration > WORTH:
        return ()
    begun = found.shot or problem
    begun = begun if found.coarse_step is None else begun.at_step(found.coarse_step)
    look = _Look(found, half_interval() ** 2 * begun.chance(found.residual))
    return tuple(rival for several in _candidates(begun, found) for rival in look.along(several))


@dataclass(frozen=True, eq=False)
class _Candidates:
    """Structures as parameters of a problem's simulator."""

    problem: Problem
    base: Array
    """(n,) values without them, which begin with those of the fit."""
    names: tuple[str, ...]
    """The structure of each parameter."""
    places: tuple[int, ...]
    """Its place among the values."""
    parameters: tuple[Parameter, ...]


def _candidates(problem: Problem, found: Fit) -> list[_Candidates]:
    """What was declared, could enter and was left out, and what the simulator could have beside its own."""
    declared = problem.simulator.parameters.parameters
    left = [
        (p.optional, k, p) for k, (p, own) in enumerate(zip(declared, found.space.parameters, strict=True))
        if own.frozen and not p.frozen and p.optional and p.absent is not None
    ]  # fmt: skip
    groups = []
    related = related_of(problem.simulator)
    for simulator, names in () if related is None else related.rivals():
        of = {own: name for name, several in names.items() for own in several}
        more = simulator.parameters.parameters[len(declared) :]
        some = [(of[p.name], len(declared) + k, p) for k, p in enumerate(more) if p.nominal <= p.lower]
        by = problem.by(simulator).at_step(problem.simulator.step)
        groups.append((by, np.concatenate([found.values, [p.nominal for p in more]]), some))
    groups = groups or [(problem, found.values, [])]
    groups[-1][-1].extend(left)  # beside others: a call costs more than some rows
    return [_Candidates(p, values, *zip(*some, strict=True)) for p, values, some in groups if some]


def _sizes(p: Parameter) -> Array:
    """(2,) values of a parameter, from nearly none of it to as much as there may be."""
    if p.scale == "linear":
        return p.lower + SIZES[[1, -1]] * (p.upper - p.lower)
    if p.absent is not None and p.absent > p.upper:  # a limit: the lower, the more of it
        return np.asarray(p.upper * (p.lower / p.upper) ** _FACTORS)
    return np.asarray(p.lower * (p.upper / p.lower) ** _FACTORS)


class _Look:
    """Looks at structures of several sizes, with all else settled as the fit's slopes foretell, and again at what these
    promise.
    """

    def __init__(self, found: Fit, chance: float) -> None:
        self._found, self._chance = found, chance
        self._weighted = found.jacobian * found.weights[:, None]
        self._curvature = found.jacobian.T @ self._weighted
        self._before = self._losses(found.residual[None])[0]

    def along(self, several: _Candidates) -> list[Rival]:
        """A rival for each parameter of these structures, each looked at by itself."""
        sizes, every = np.array([_sizes(p) for p in several.parameters]), np.arange(len(several.places))
        begun = several.problem.residuals(several.base[None])[0]
        seen = [[place] for place in self._settled(several, every, sizes[:, 0], begun)]
        still = np.flatnonzero([places[0][0] <= self._chance for places in seen])
        for k, place in zip(still, self._settled(several, still, sizes[still, 1], begun), strict=True):
            seen[k].append(place)
        named = zip(several.names, several.parameters, seen, strict=True)
        return [self._rival(name, p, places) for name, p, places in named]

    def _settled(
        self, several: _Candidates, which: NDArray[np.intp], sizes: Array, begun: Array
    ) -> list[tuple[float, Array]]:
        """How much more loss there is with each of some parameters (k,) of its size (k,), beside residuals `begun` (m,)
        without any, once all else has settled, and (n_free,) where; what is promising is simulated there.
        """
        if not len(which):
            return []
        found, k = self._found, len(which)
        rows = np.repeat(several.base[None], k, axis=0)
        rows[np.arange(k), np.array(several.places)[which]] = sizes
        moved = several.problem.residuals(rows) - begun
        steps = np.array([self._step(change) for change in moved])
        stayed, foretold = (
            self._losses(found.residual + m) - self._before for m in (moved, moved + steps @ found.jacobian.T)
        )
        units = np.clip(found.unit + np.where((foretold < stayed)[:, None], steps, 0.0), 0.0, 1.0)
        promising = np.flatnonzero((foretold < stayed) & (foretold <= self._chance))
        more = np.fmin(stayed, foretold)
        if len(promising):
            there, free = rows[promising], np.flatnonzero(found.space.free)
            there[:, free] = found.space.from_unit(units[promising])[:, free]
            real = self._losses(found.residual + several.problem.residuals(there) - begun) - self._before
            units[promising[stayed[promising] < real]] = found.unit
            more[promising] = np.fmin(real, stayed[promising])
        return list(zip(more.tolist(), units, strict=True))

    def _step(self, moved: Array) -> Array:
        if not np.isfinite(moved).all():
            return np.zeros_like(self._found.unit)
        step = damped_step(self._curvature, self._weighted.T @ moved, INEXACT, self._found.unit)
        return np.clip(step, -FORETOLD, FORETOLD)

    def _losses(self, residuals: Array) -> Array:
        return np.nan_to_num(robust_losses(residuals, self._found.bend), nan=np.inf)

    def _rival(self, name: str, p: Parameter, seen: Sequence[tuple[float, Array]]) -> Rival:
        """What all else settles at for sizes with as little loss as chance may take from the best; the last end lies
        between sizes, as losses grow about as squares.
        """
        most = min(0.0, *(loss for loss, _ in seen)) + self._chance
        ends, last, at = [self._found.unit], 0.0, self._found.unit
        for loss, unit in seen:
            if loss <= most:
                ends.append(unit)
            elif np.isfinite(loss) and last <= most:
                ends.append(at + np.sqrt((most - last) / (loss - last)) * (unit - at))
            last, at = loss, unit
        space = self._found.space
        value, low, high = (
            space.from_unit(u)[space.free] for u in (ends[0], np.min(ends, axis=0), np.max(ends, axis=0))
        )
        return Rival(name, p, value - low, high - value)


def widened(estimates: Sequence[Estimate], rivals: Sequence[Rival]) -> tuple[Estimate, ...]:
    """With intervals that hold with a rival and without it."""
    moved = _moved(estimates, rivals)
    return tuple(_wide(e, moved[e.name]) if e.name in moved else e for e in estimates)


def doubted(estimates: Sequence[Estimate], rivals: Sequence[Rival]) -> tuple[Estimate, ...]:
    """With words where an estimate hangs on whether the robot has a rival."""
    moved = _moved(estimates, rivals)
    return tuple(_in_words(e, rivals, moved[e.name]) if e.name in moved else e for e in estimates)


def _moved(estimates: Sequence[Estimate], rivals: Sequence[Rival]) -> dict[str, dict[str, Array]]:
    """(2,) how far each fitted estimate is moved down and up by each structure, all parts of which may be there: their
    squares are added.
    """
    fitted = [e.name for e in estimates if e.fitted]
    moved = {name: {r.name: np.zeros(2) for r in rivals} for name in fitted if rivals}
    for k, by in enumerate(moved.values()):
        for r in rivals:
            by[r.name] = np.hypot(by[r.name], [r.down[k], r.up[k]])
    return moved


def _wide(e: Estimate, by: Mapping[str, Array]) -> Estimate:
    """Of several structures the worst counts."""
    down, up = np.hypot([e.value - e.low, e.high - e.value], np.max(list(by.values()), axis=0))
    return replace(e, low=max(float(e.value - down), e.lower_bound), high=min(float(e.value + up), e.upper_bound))


def _in_words(e: Estimate, rivals: Sequence[Rival], by: Mapping[str, Array]) -> Estimate:
    """What is moved by less than it is unsure of by itself holds with a rival as it is."""
    name = max(by, key=lambda n: float(by[n].max()))
    much = np.maximum(SAME * abs(e.value), np.sqrt(0.5) * np.array([e.value - e.low, e.high - e.value]))
    if e.verdict not in ("identified", "tied") or not np.any(by[name] > much):
        return e
    shown = next((r.parameter.shown_by for r in rivals if r.name == name and r.parameter.shown_by), "")
    note = f"hangs on {next(r.doubt for r in rivals if r.name == name)}, which these recordings do not tell"
    return replace(e, verdict="weak", note=note + (f"; {shown} would show it" if shown else ""))
