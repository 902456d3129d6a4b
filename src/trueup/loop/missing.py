# SPDX-License-Identifier: Apache-2.0
"""What the recordings show of the robot that the simulator lacks, and what the estimates would be with it.

Least squares put what a model lacks into the parameters that it has: a gear that twists looks like a heavier rotor, and
no residual tells how far off that is. Where the simulator does not explain the recordings, structures that it could have
are tried: each by a score test (C. R. Rao, Proc. Cambridge Phil. Soc. 44, 1948: how much lower would the loss be, once all
else has made up for it?), the best of them by a fit, and kept by the rule of evidence.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.calibration import Lacked
from trueup.engines.simulator import CONTACTS, Simulator, related_of
from trueup.errors import CalibrationError, SimulationFailedError
from trueup.evidence import EXCERPT, Evidence, explained
from trueup.loop.descent import Fit
from trueup.loop.earlier import Earlier
from trueup.loop.fit import DESCENT, REFINEMENT, SHIPPED, STAGES, Stage, fit
from trueup.loop.problem import WORTH, Problem
from trueup.loop.scans import Look, Scan
from trueup.loop.selection import compared
from trueup.loop.since import Known, since
from trueup.loop.uncertainty import intervals, unit_covariance
from trueup.loop.validate import by_stretch, cautious_errors
from trueup.loop.watch import Watch
from trueup.loop.windows import carried
from trueup.parameters import Parameter, ParameterSpace


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
    stands: bool = False
    """Whether an earlier calibration found it, and it was not fitted anew."""
    explains: bool = False
    """Whether the recordings are replayed to about their noise with it."""

    def lacked(self, fitted: Iterable[str]) -> Lacked:
        """The same for calibrations to come; `fitted` are the names of the simulator's free parameters."""
        names = (*fitted, *(p.name for p in self.parameters))
        rows = np.stack([self.values, self.low, self.high], axis=1).tolist()
        return Lacked(
            {name: (value, low, high) for name, (value, low, high) in zip(names, rows, strict=True)}, self.shown
        )

    def words(self) -> str:
        """What it is and what it would gain, for the user."""
        first = len(self.values) - len(self.parameters)
        rows = zip(self.parameters, self.values[first:], self.low[first:], self.high[first:], strict=True)
        sizes = ", ".join(f"{p.name} {v:.3g} [{lo:.3g}, {hi:.3g}] {p.unit}".rstrip() for p, v, lo, hi in rows)
        undecided = f"the recordings leave it open whether the robot has {self.name}, which the model lacks: {sizes}"
        if not self.shown.holds:
            return undecided
        sizes += " (fitted before the latest recordings came)" if self.stands else ""
        return (
            f"the recordings are replayed better with {self.name}, which the model lacks: {sizes}. With it left-out errors "
            f"are {self.shown.in_words()}. It may stand for something else that is wrong (a mass, a parameter that is not "
            "declared); if not, declare it, from there, to have it in the model"
        )


def missing(problem: Problem, found: Fit, earlier: Earlier | None = None) -> Missing | None:
    """The structure that the simulator lacks by the recordings' evidence, or else the one that they favour most; None where
    it explains them, or none of those that are known is favoured. Where an `earlier` calibration knew some of the
    recordings, its answer stands while the others do not speak against it, nor more for another (`since.py`).
    """
    if explained(found.residual) or problem.eliminated:
        return None
    structures = _structures(problem)
    if not structures:
        return None
    came = None if earlier is None else since(problem, found, earlier, structures)
    if came is not None and came.stands:
        return None if came.known is None else _still(came.known, found, structures)
    part = problem if problem.duration <= EXCERPT else problem.shortened(EXCERPT / len(problem.trials))
    if part is not problem:
        found = fit(part, found.space, found.values, Watch(), stages=REFINEMENT)
    without, tried = cautious_errors(part, found, by_stretch(part)), list[Missing]()
    scanned = dict(structures)
    if CONTACTS in structures and carried(part):
        tried += _anew(part, found, scanned.pop(CONTACTS), without)
    for place, stages in _places_to_look_from(part, found):
        if any(m.explains for m in tried):
            break
        scan = Scan.of(part, place) if place is found else Scan.as_it_is(part, place)
        looks = came.looks if came is not None and place is found else scan.favoured(scanned)
        asked = {frozenset(p.name for p in m.parameters) for m in tried}
        new = [look for look in looks if frozenset(look.sizes) not in asked]
        tried += _tried(part, place, new, structures, stages, without)
    holding = [m for m in tried if m.shown.holds]
    return max(holding or tried, key=lambda m: m.shown.gain, default=None)


def unasked_by(problem: Problem, found: Fit) -> tuple[str, ...]:
    """That recordings of more than a minute are not asked, though they leave something to explain: it may take as long as
    the calibration itself. Nothing where they are shorter, or where there is nothing to ask.
    """
    if problem.duration <= WORTH or explained(found.residual) or problem.eliminated or not _structures(problem):
        return ()
    return (
        f"the recordings are {problem.duration:.0f} s long, so it was not asked what the model lacks (a dead band, gears "
        "that twist, springs): --lacking, or lacking = true in a plan, asks, which can double the time",
    )


def _structures(problem: Problem) -> dict[str, Simulator]:
    related = related_of(problem.simulator)
    return {} if related is None else dict(related.structures())


def _places_to_look_from(part: Problem, found: Fit) -> Iterator[tuple[Fit, Sequence[Stage]]]:
    """Where a fit ended; and where it began, for as long as nothing that was found explains the recordings: what the model
    lacks has led the fit astray, and what it is cannot be seen from where that ended. A payload that nobody declared is
    plain with the gains of the file, and among those that were found in its place many links look wrong.
    """
    yield found, REFINEMENT
    first = np.where(found.space.free, found.space.nominal, found.values)
    try:
        begun = fit(part, found.space, first, Watch(), stages=SHIPPED)
    except (
        SimulationFailedError,
        CalibrationError,
    ):  # nominal values beside what was set since
        return
    yield begun, DESCENT


def _anew(problem: Problem, found: Fit, softer: Simulator, without: Array) -> list[Missing]:
    """Contacts of another softness by a search from where the first one began: where feet land otherwise than the robot's,
    all that a fit ends at makes up for that, and slopes there lead nowhere.
    """
    free = {p.name: p.nominal for p in softer.parameters.parameters[len(found.space) :]}
    begun = np.where(found.space.free, found.space.nominal, found.values)
    return _tried(problem, found, [Look(CONTACTS, free, 0.0, 0.0, begun)], {CONTACTS: softer}, STAGES, without)


def _tried(
    problem: Problem, place: Fit, looks: Sequence[Look], structures: Mapping[str, Simulator], stages: Sequence[Stage],
    without: Array,
) -> list[Missing]:  # fmt: skip
    """The structures that a score test at a place favours most, fitted from there, up to one that the evidence holds for."""
    tried: list[Missing] = []
    for look in looks[:2]:  # each costs about as much as a quarter of the fit
        wider = problem.by(structures[look.name])
        grown = _grown(wider, place, look, stages)
        if grown is not None:
            shown = compared(without, cautious_errors(wider, grown, by_stretch(wider)))
            tried += [_missing(wider, look, grown, shown)] if shown.gain > 0.0 else []
        if tried and tried[-1].shown.holds:
            break
    return tried


def _grown(problem: Problem, found: Fit, look: Look, stages: Sequence[Stage]) -> Fit | None:
    """The fit with a structure, from where the score test has it; None where the simulation fails with it."""
    more = problem.simulator.parameters.parameters[len(found.space) :]
    space = ParameterSpace((*found.space.parameters, *more)).freeze([p.name for p in more if p.name not in look.sizes])
    start = np.concatenate([look.values, [look.sizes.get(p.name, p.nominal) for p in more]])
    try:
        return fit(problem, space, start, Watch(), stages=stages)
    except (CalibrationError, SimulationFailedError):
        return None


def _still(known: Known, found: Fit, structures: Mapping[str, Simulator]) -> Missing:
    """What an earlier calibration found to be lacking, as it was fitted then; what was held then is where it is found now."""
    look, own = known.look, dict(zip(found.space.names, found.values.tolist(), strict=True))
    parameters = tuple(p for p in structures[look.name].parameters.parameters if p.name in look.sizes)
    names = [p.name for p in (*found.space.parameters, *parameters) if not p.frozen]
    values, low, high = np.array(
        [known.lacked.intervals[n] if n in known.lacked.intervals else [own[n]] * 3 for n in names]
    ).T
    return Missing(look.name, parameters, values, low, high, known.lacked.shown, stands=True)


def _missing(problem: Problem, look: Look, grown: Fit, shown: Evidence) -> Missing:
    low, high = intervals(grown, unit_covariance(problem, grown))
    parameters = tuple(p for p in grown.space.parameters[len(look.values) :] if not p.frozen)
    values = grown.values[grown.space.free]
    return Missing(look.name, parameters, values, low, high, shown, explains=explained(grown.residual))
