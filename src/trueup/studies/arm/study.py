# SPDX-License-Identifier: Apache-2.0
"""The whole study: three regions, hidden effects one by one, the papers' tables, their open questions; into a folder."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from trueup.arrays import Array
from trueup.excitation.cell import Cell
from trueup.formats.aside import write_aside
from trueup.identification.dynamic_model import DynamicModel
from trueup.studies.arm.comparison import DESIGNED, Errors, Region, Scale, compared, prepared, share_of_best
from trueup.studies.arm.excitation import Workshop
from trueup.studies.arm.fitting import Fitted, our_fit, papers_fit
from trueup.studies.arm.hidden import Effects, HiddenArm
from trueup.studies.arm.measuring import papers_columns
from trueup.studies.arm.questions import answered
from trueup.studies.arm.report import Findings, html, markdown
from trueup.studies.arm.robot import COULOMB, QUADRATIC, REGIONS, ROTORS, VISCOUS, limits, ns16
from trueup.studies.arm.saved import Store

Told = Callable[[str, float], None]

FULL = Scale(population=60, generations=20)
QUICK = Scale(excitations=3, tests=5, seconds=25.0, population=20, generations=5)
ABLATED = "B"
"""The region in which effects are left out one by one, and in which the open questions are asked."""
_FITS = {"all effects, our fit for all": None, "all effects, papers' fit for all": ()}
"""Who gets our fit; None is everybody."""


def performed(folder: Path, scale: Scale, told: Told, regions: tuple[str, ...] = tuple(REGIONS)) -> dict[str, float]:
    """Writes `report.html`, `report.md` and `cells.json` into the folder; returns the shares in which ours is best.

    What an earlier run left in the folder is not computed again. Raises OutputError where it is that of another study.
    """
    store = Store.at(folder, scale)
    steps = _Steps(told, sum(map(_steps, regions)))
    findings = Findings(scale, ABLATED if ABLATED in regions else regions[0])
    for name in regions:
        region = _Lazily(name, scale, steps)
        findings.everything[name] = {
            label: store.errors(f"{name} {label}", lambda r=region, x=(label, effects, who): r.compared(*x))
            for label, effects, who in _conditions(name)
        }
        findings.determinants[name] = store.text(f"{name} determinants", lambda r=region: r.determinants())
        if name == findings.shown:
            findings.parameters = store.text(f"{name} parameters", lambda r=region: r.parameters())
            findings.answers = [
                store.text(f"{name} answers {k}", lambda k=k, r=region: r.answers(k)) for k in ("A", "B")
            ]
        steps.done = sum(map(_steps, regions[: regions.index(name) + 1]))
        # After each region, so that a study that is stopped leaves what it has.
        _write(folder, findings)
    rng = np.random.default_rng(scale.seed)
    return {name: share_of_best(each["all effects"], rng)[0] for name, each in findings.everything.items()}


def conditions(*, every: bool) -> dict[str, Effects]:
    """What the arm hides: all, friction of another form, nothing; if `every`, all but each one."""
    found = {
        "all effects": Effects(),
        "friction of another form": Effects(foreign=1.0),
        "friction of another form, no coupling": Effects(foreign=1.0, coupling=0.0),
        "none but noise": Effects.none(),
    }
    if every:
        single = [f.name for f in fields(Effects) if f.name not in ("noise", "foreign")]
        found |= {f"all but {name}": Effects().without(name) for name in single}
    return found


def _conditions(region: str) -> Iterator[tuple[str, Effects, Sequence[str] | None]]:
    """Label, hidden effects, and the algorithms whose recordings get our fit (None: all)."""
    for label, effects in conditions(every=region == ABLATED).items():
        yield label, effects, ("ours",)
    if region == ABLATED:
        for label, who in _FITS.items():
            yield label, Effects(), who


def _steps(region: str) -> int:
    """How often a region says that something is done: test motions, designs, conditions, two open questions."""
    return len(DESIGNED) + 2 + len(list(_conditions(region))) + (2 if region == ABLATED else 0)


@dataclass
class _Steps:
    """Counts what is done, and says it."""

    report: Told
    total: int
    done: int = 0

    def __call__(self, text: str) -> None:
        self.done += 1
        self.report(text, self.done / self.total)


@dataclass
class _Lazily:
    """A region whose excitations and test motions are made when the first part of it is missing."""

    name: str
    scale: Scale
    steps: _Steps
    regions: list[Region] = field(default_factory=list)

    def region(self) -> Region:
        if not self.regions:
            self.regions.append(prepared(self.name, self.scale, self.steps))
        return self.regions[0]

    def workshop(self) -> Workshop:
        return Workshop.of(Cell.of(ns16(), REGIONS[self.name], limits()), self.scale.population, self.scale.generations)

    def compared(self, label: str, effects: Effects, who: Sequence[str] | None) -> Errors:
        region = self.region()
        errors = compared(
            region, effects, self.scale.seed, our_fit_for=tuple(region.excitations[0]) if who is None else who
        )
        self.steps(f"region {self.name}: {label}")
        return errors

    def determinants(self) -> dict[str, list[float]]:
        """As printed, of the excitations that were optimised, brought to 2000 samples."""
        workshop, found = self.workshop(), {}
        printed = replace(workshop.criterion, kind="D", weighting="printed", per_sample=False)
        for algorithm in (*(label for label, _, _ in DESIGNED), "ours"):
            values = []
            for replicate in self.region().excitations:
                total, count = 0.0, 0
                for one in replicate[algorithm]:
                    q, qd, qdd = (x[None, ::5] for x in (one.trajectory.q, one.trajectory.qd, one.trajectory.qdd))
                    M = workshop.model.information(q, qd, qdd, printed.weights, printed.independent)
                    total, count = total + M[0], count + q.shape[1]
                values.append(-float(printed.of_information(np.asarray(total) * (2000.0 / count), 2000)))
            found[algorithm] = values
        return found

    def parameters(self) -> dict[str, Any]:
        """Table III from the first excitation of each algorithm: names, the truth of the rigid part, what was found."""
        region, rng, arm = self.region(), np.random.default_rng(self.scale.seed), HiddenArm(ns16(), Effects())
        papers = region.model
        base, columns = papers.base(), papers_columns(papers)
        found, warmth = {}, float(rng.uniform(-1.0, 1.0))
        for algorithm in (*(label for label, _, _ in DESIGNED), "ours"):
            made = region.excitations[0][algorithm]
            if algorithm == "ours":
                fit: Fitted = our_fit(made, arm, rng, warmth)
            else:
                fit = papers_fit(papers, [one.torque(arm, rng, warmth) for one in made], columns)
            found[algorithm] = base.of(fit.as_papers()).tolist()
        return {"names": list(base.names), "truth": base.of(_truth(papers)).tolist(), "found": found}

    def answers(self, kind: str) -> dict[str, Any]:
        """Which criterion foretells the error, over random excitations of a class."""
        rng, count = np.random.default_rng([self.scale.seed, ord(kind)]), 60 if self.scale.tests >= 20 else 12
        found = answered(kind, self.workshop(), self.region(), Effects(), rng, count=count)
        self.steps(f"region {self.name}: criteria against errors, class {kind}")
        return asdict(found)


def _truth(papers: DynamicModel) -> Array:
    """(p,) the rigid part of the hidden arm, and its friction where no other effect acts."""
    return np.concatenate([papers.tree.weighed().ravel(), ROTORS, COULOMB, VISCOUS, QUADRATIC])


def _write(folder: Path, findings: Findings) -> None:
    text = markdown(findings)
    cells = json.dumps(_cells(findings.everything), indent=1)
    for name, words in (("report.md", text), ("report.html", html(text, findings)), ("cells.json", cells)):
        write_aside(words, folder / name)


def _cells(everything: Mapping[str, Mapping[str, Errors]]) -> dict[str, object]:
    """Mean absolute errors in N m for each region, condition, algorithm, case and axis."""
    return {
        name: {
            label: {f"{a}; {c}": np.round(v.mean(axis=(0, 1)), 4).tolist() for (a, c), v in errors.absolute.items()}
            for label, errors in each.items()
        }
        for name, each in everything.items()
    }
