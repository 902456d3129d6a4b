# SPDX-License-Identifier: Apache-2.0
"""The papers' open questions, on random excitations: which criterion foretells the error, and which the friction's?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import rankdata, spearmanr

from trueup.arrays import Array
from trueup.excitation.criteria import Criterion
from trueup.excitation.periodic import Sines, at_rest
from trueup.excitation.planner import ViaPoints
from trueup.excitation.trajectories import Motions, Trajectory
from trueup.studies.arm.comparison import CASES, Errors, Region
from trueup.studies.arm.excitation import FAST, RATE, Workshop, filled
from trueup.studies.arm.fitting import PapersFit, papers_fit
from trueup.studies.arm.hidden import Effects, HiddenArm
from trueup.studies.arm.measuring import papers_columns, runs, separate
from trueup.studies.arm.robot import JOINTS, NOMINAL, ns16

_CRITERIA = {
    "D as printed": {"kind": "D", "weighting": "printed"},
    "D": {"kind": "D"},
    "A": {"kind": "A"},
    "E": {"kind": "E"},
    "condition number": {"kind": "condition"},
    "D of friction": {"kind": "D", "friction": "alone"},
    "prediction": {"kind": "prediction"},
}
_OUTCOMES = ("1 local, fast", "2 wide sines", "3 wide planner, gentle")


@dataclass(frozen=True, eq=False)
class Answers:
    """Rank correlations over random excitations of a class: criterion's loss against what was got wrong."""

    kind: str
    count: int
    """Of excitations."""
    correlation: Mapping[str, Mapping[str, float]]
    """Criterion -> outcome -> Spearman's coefficient; outcomes are test cases, and 'friction'."""


def answered(
    kind: str, workshop: Workshop, region: Region, effects: Effects, rng: np.random.Generator, *, count: int = 40,
    seconds: float = 20.0,
) -> Answers:  # fmt: skip
    """`count` random excitations of class 'A' (sines) or 'B' (via points), each repeated for the same time."""
    arm, columns = HiddenArm(ns16(), effects), papers_columns(region.model)
    measured = {case: separate(arm, region.tests[case], rng) for case in _OUTCOMES}
    criteria = {name: _criterion(workshop, name, region) for name in _CRITERIA}
    loss: dict[str, list[float]] = {name: [] for name in criteria}
    error: dict[str, list[float]] = {name: [] for name in (*_OUTCOMES, "friction")}
    warmth = 0.0
    for motion in _random(kind, workshop, rng, count):
        made = runs(region.model, filled(seconds, lambda i, m=motion: m))
        fit = papers_fit(region.model, [one.torque(arm, rng, warmth) for one in made], columns)
        for name, criterion in criteria.items():
            loss[name].append(_loss(criterion, motion))
        for case in _OUTCOMES:
            wrong = [np.abs(r.torque - r.predict(fit.parameters)).mean(axis=0) for r in measured[case]]
            error[case].append(float(np.mean(np.array(wrong) / NOMINAL)))
        error["friction"].append(_friction_error(fit, arm, warmth))
    return Answers(
        kind, count, {c: {o: float(np.asarray(spearmanr(loss[c], error[o])[0])) for o in error} for c in criteria}
    )


def _criterion(workshop: Workshop, name: str, region: Region) -> Criterion:
    made = Criterion.of(workshop.model, NOMINAL, **_CRITERIA[name])  # type: ignore[arg-type]
    if made.kind != "prediction":
        return made
    # Motions of the region's users, not those of the test cases.
    motions = ViaPoints(workshop.cell, settings=FAST).motions(np.random.default_rng(77).uniform(size=(30, 37)), 200)
    return made.for_motions(motions)


def _random(kind: str, workshop: Workshop, rng: np.random.Generator, count: int) -> list[Trajectory]:
    template = Sines(workshop.limits, longest=10.0) if kind == "A" else ViaPoints(workshop.cell, settings=FAST)
    found: list[Trajectory] = []
    while len(found) < count:
        genes = rng.uniform(size=(1, template.size))
        look = template.motions(genes, 161)
        if look.possible[0]:
            samples = int(np.ceil(float(look.duration[0]) * RATE)) + 1
            motion = template.motions(genes, samples).single(0, JOINTS, kind)
            found.append(at_rest(motion, workshop.limits, RATE) if kind == "A" else motion)
    return found


def _loss(criterion: Criterion, t: Trajectory) -> float:
    at = np.linspace(0, len(t.time) - 1, 400).astype(int)
    motions = Motions(t.time[None, at], t.q[None, at], t.qd[None, at], t.qdd[None, at])
    return float(criterion.losses(motions)[0])


def _friction_error(fit: PapersFit, arm: HiddenArm, warmth: float) -> float:
    """Root mean square over all axes and speeds up to a fifth of the limits, as a share of nominal torque."""
    share = np.linspace(0.02, 0.2, 25)
    speed = np.concatenate([-share[::-1], share])[:, None] * np.abs(arm.tree.speed)
    n, sign = arm.tree.n, np.sign(speed)
    f0, f1, f2 = fit.parameters[11 * n : 14 * n].reshape(3, n)
    fitted = f0 * sign + f1 * speed + f2 * sign * speed**2
    return float(np.sqrt(np.mean(((fitted - arm.friction(speed, np.zeros_like(speed), warmth)) / NOMINAL) ** 2)))


def after_search(determinants: Mapping[str, Sequence[float]], errors: Errors) -> dict[str, tuple[Array, Array]]:
    """For each algorithm ranks (excitations,) of log det and of the mean error over all cases and axes, in % of nominal.

    What random excitations show need not hold among those that were searched for: all of them are good.
    """
    found = {}
    for algorithm, values in determinants.items():
        wrong = np.mean(
            [(errors.absolute[algorithm, case] / NOMINAL).mean(axis=(1, 2)) for case in CASES], axis=0
        )  # (excitations,)
        found[algorithm] = rankdata(values) - 0.5 * (len(values) + 1), rankdata(wrong) - 0.5 * (len(values) + 1)
    return found
