# SPDX-License-Identifier: Apache-2.0
"""Which structure a servo has: candidates are asked about in turn, each kept if left-out recordings want it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trueup.actuators.anywhere import anywhere
from trueup.actuators.fit import WINDOWS, Found, Problem, fit, left_out, widening
from trueup.actuators.structures import ASKEW, BASE, BY_NAME, LOAD, STRUCTURES, USUAL, Structure
from trueup.arrays import Array
from trueup.evidence import Evidence, evidence
from trueup.parameters import Parameter


@dataclass(frozen=True)
class Asked:
    """A structure that was asked about, last of all with what else was kept."""

    name: str
    evidence: Evidence
    without: float
    with_it: float
    """Geometric mean left-out error in rad."""
    least: float
    """What it gains where it gains least; as `Evidence.gain`."""

    @classmethod
    def of(cls, name: str, without: Model, with_it: Model) -> Asked:
        """What left-out errors of two models say."""
        with np.errstate(invalid="ignore"):  # where no fit can be replayed
            least = float(np.min(np.log(without.errors) - np.log(with_it.errors)))
        return cls(name, evidence(without.errors, with_it.errors), without.error, with_it.error, least)

    @property
    def wanted(self) -> bool:
        """Whether left-out data want it: clearly in the mean, or by one standard error and nowhere clearly not.

        A limit acts in those recordings only that reach it: where two of eight are replayed ten times better and six as
        before, the spread of the gain is the structure's own (t = sqrt(2 * 7 / 6) = 1.5, however large the gain).
        """
        spread = self.evidence.standard_error
        return self.evidence.holds or (self.evidence.gain > spread and self.least > -spread)

    @property
    def accepted(self) -> bool:
        """Whether it stays: left-out data want it, or, of what is expected of any servo, do not speak against it."""
        return self.wanted if self.name != LOAD else self.evidence.gain > 0.0


@dataclass(frozen=True, eq=False)
class Model:
    """A servo with some structures."""

    structures: tuple[str, ...]
    optimum: Found
    left_out: Sequence[Mapping[str, float]]
    """Values of fits that never saw one block each."""
    errors: Array
    """(B,) rad, of each block by the fit that never saw it."""

    @property
    def error(self) -> float:
        """Their geometric mean."""
        return float(np.exp(np.mean(np.log(self.errors))))


class Chooser:
    """Fits of servos with different structures, to the same runs."""

    def __init__(
        self, problem: Problem, declared: Mapping[str, Parameter], fixed: Mapping[str, float] | None = None
    ) -> None:
        self.problem, self.declared = problem, declared
        self.fixed = fixed or {}

    def plain(self, structures: tuple[str, ...] = ()) -> Model:
        """The servo of BASE, with some structures, from what errors and loads let guess, and from anywhere."""
        parameters = self.parameters(structures)
        ends = [widening(self.problem, parameters, self.fixed), anywhere(self.problem, parameters, self.fixed)]
        return self._best(structures, ends)

    def trimmed(self, structures: tuple[str, ...]) -> Model:
        """The servo of BASE with many structures at once, as `plain`; then without those that left-out runs do not miss.

        Half of them go at a time, those first without which the loss grows least; fewer where these are missed.
        """
        model = best = self.plain(structures)
        count = 1
        while count:
            needless = self._by_loss(model)
            count = (len(needless) + 1) // 2
            while count:
                names = tuple(s for s in model.structures if s not in needless[:count])
                less = self._best(names, [self._from(model, names)])
                if not Asked.of("", less, best).wanted:
                    model, best = less, min(best, less, key=lambda m: m.error)
                    break
                count //= 2
        return model

    def _by_loss(self, model: Model) -> list[str]:
        """Structures that may go, those first without which a quick fit is worse by least."""
        may = [s for s in model.structures if s != LOAD and not any(BY_NAME[t].requires == s for t in model.structures)]
        if not may:
            return []
        quick = 4  # iterations: they need not be near its end to be put in order
        fits = [self._from(model, tuple(t for t in model.structures if t != s), quick) for s in may]
        losses = self.problem.losses([f.values for f in fits], model.optimum.bend)
        return [may[k] for k in np.argsort(losses)]

    def _from(self, model: Model, names: tuple[str, ...], iterations: int = 30) -> Found:
        """A fit with these of a model's structures only, from where it was found."""
        return fit(self.problem, self.parameters(names), self._start(model, names), iterations=iterations)

    def _start(self, model: Model, names: tuple[str, ...]) -> dict[str, float]:
        """What was found of these of a model's structures."""
        return {**self.fixed, **{p.name: model.optimum.values[p.name] for p in self.parameters(names)}}

    def promise(self, model: Model, structure: Structure) -> Found:
        """What a structure would do to a model's replays in windows: quickly fitted."""
        parameters = self.parameters((*model.structures, structure.name))
        # So many iterations show what a structure promises.
        return fit(self.problem, parameters, model.optimum.values, iterations=8, window=WINDOWS[-2])

    def with_structure(self, model: Model, structure: Structure, promised: Found) -> Model:
        """A model with one more structure: from where it promised to lead, and without regard to what was found before, which
        may hold a fit in a valley of its own.
        """
        names = (*model.structures, structure.name)
        parameters = self.parameters(names)
        ends = [fit(self.problem, parameters, promised.values), widening(self.problem, parameters, self.fixed)]
        return self._best(names, ends)

    def without(self, model: Model, name: str) -> Model:
        """A model with one structure less."""
        names = tuple(s for s in model.structures if s != name)
        again = widening(self.problem, self.parameters(names), self._start(model, names))
        return self._best(names, [self._from(model, names), again])

    def _best(self, names: tuple[str, ...], fits: Sequence[Found]) -> Model:
        """The lowest of several fits, by one and the same loss, with what left-out runs say of it."""
        found = fits[int(np.argmin(self.problem.losses([f.values for f in fits], min(f.bend for f in fits))))]
        each = left_out(self.problem, self.parameters(names), found)
        return Model(names, found, each, self.problem.block_errors(each))

    def parameters(self, structures: Sequence[str]) -> list[Parameter]:
        """Those that are searched."""
        names = dict.fromkeys([*BASE, *(p for s in structures for p in BY_NAME[s].parameters)])
        return [self.declared[n] for n in names if n not in self.fixed]


def choose(chooser: Chooser, offered: Sequence[str], told: Callable[[str, float], None]) -> tuple[Model, list[Asked]]:
    """The model whose structures left-out data want, and what was asked.

    Structures go in one by one, along several ways at once (a beam: of rivals such as limits of voltage and of force, the
    one that helps more at first may be the wrong one): from what was left of all structures at once on a load that hangs as
    it is said to, and of the `USUAL` ones on a load that is askew, which by some degrees hides all else; from the plainest
    servo where neither is better. Then each is asked again whether the others have made it needless. Friction under load,
    which four of four servos had that were studied for it (Duclusaud et al. 2025), stays unless left-out errors are as low
    without it.
    """
    ways = 3  # models that are followed side by side
    told("all at once", np.nan)
    plain = chooser.plain((LOAD,))
    every = (LOAD, *(n for n in offered if n != LOAD and BY_NAME[n].requires in ("", LOAD, *offered)))
    beam = []
    for names in dict.fromkeys((tuple(n for n in every if n != ASKEW), tuple(n for n in every if n in USUAL))):
        if len(names) > 1 and Asked.of("", plain, rich := chooser.trimmed(names)).wanted:
            beam.append(rich)
    beam = beam or [plain]
    best, asked, seen = min(beam, key=lambda m: m.error), {}, {frozenset(m.structures): m for m in beam}
    while beam:
        grown: dict[frozenset[str], Model] = {}
        for parent in beam:
            for name, child in _tried(chooser, parent, offered, seen, told).items():
                asked[frozenset(parent.structures), name] = found = Asked.of(name, parent, child)
                if found.accepted:
                    grown[frozenset(child.structures)] = child
        beam = sorted(grown.values(), key=lambda m: m.error)[:ways]
        best = min([best, *beam], key=lambda m: m.error)
    answers = {name: a for (_, name), a in asked.items()}
    answers |= {name: a for (parent, name), a in asked.items() if parent == frozenset(best.structures)}
    for name in (*(s for s in best.structures if s != LOAD), LOAD):
        one_less = frozenset(best.structures) - {name}, name
        if one_less not in asked and not any(BY_NAME[s].requires == name for s in best.structures):
            told(f"without {name}", best.error)
            less = chooser.without(best, name)
            answers[name] = Asked.of(name, less, best)
            if not answers[name].accepted:
                best = less
    return best, sorted(answers.values(), key=lambda a: -a.evidence.gain)


def _tried(
    chooser: Chooser, parent: Model, offered: Sequence[str], seen: dict[frozenset[str], Model],
    told: Callable[[str, float], None],
) -> dict[str, Model]:  # fmt: skip
    """Models with one more structure, of those that promise most; what was `seen` on other ways is not fitted again."""
    promised = {}
    for s in STRUCTURES:
        if (
            s.name in offered
            and s.name not in parent.structures
            and (not s.requires or s.requires in parent.structures)
        ):
            told(s.name, parent.error)
            promised[s.name] = chooser.promise(parent, s)
    if not promised:
        return {}
    bend = min(f.bend for f in promised.values())
    most = 4  # structures that promise the most are fitted in earnest
    losses = chooser.problem.losses([f.values for f in promised.values()], bend, WINDOWS[-2])
    tried = {}
    for name in [list(promised)[k] for k in np.argsort(losses)[:most]]:
        key = frozenset((*parent.structures, name))
        if key not in seen:
            seen[key] = chooser.with_structure(parent, BY_NAME[name], promised[name])
        tried[name] = seen[key]
    return tried
