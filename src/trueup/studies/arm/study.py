# SPDX-License-Identifier: Apache-2.0
"""The whole study: three regions, hidden effects one by one, the papers' tables, their open questions; into a folder."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trueup.identification.estimation.torque_model import TorqueModel
from trueup.identification.excitation.cell import Cell
from trueup.report.markup import Markup, join
from trueup.studies.arm import tables
from trueup.studies.arm.comparison import CASES, Errors, Region, Scale, compared, prepared, share_of_best
from trueup.studies.arm.excitation import Workshop
from trueup.studies.arm.figures import distributions, page, torques
from trueup.studies.arm.fitting import our_fit, papers_fit
from trueup.studies.arm.hidden import Effects, HiddenArm
from trueup.studies.arm.measuring import PAPERS, papers_columns
from trueup.studies.arm.questions import answered, ordering
from trueup.studies.arm.robot import COULOMB, QUADRATIC, REGIONS, ROTORS, VISCOUS, limits, ns16

Array = NDArray[np.float64]
Told = Callable[[str], None]

FULL = Scale(population=60, generations=20)
QUICK = Scale(excitations=3, tests=5, seconds=25.0, population=20, generations=5)
_ABLATED = "B"
"""The region in which effects are left out one by one."""


def performed(folder: Path, scale: Scale, told: Told, regions: tuple[str, ...] = tuple(REGIONS)) -> dict[str, float]:
    """Writes `report.html`, `report.md` and `cells.json` into the folder; returns the shares in which ours is best."""
    rng = np.random.default_rng(scale.seed)
    everything: dict[str, dict[str, Errors]] = {}
    determinants: dict[str, dict[str, Array]] = {}
    parts: dict[str, str] = {}
    for name in regions:
        region = prepared(name, scale, told)
        workshop = Workshop.of(Cell.of(ns16(), REGIONS[name], limits()), scale.population, scale.generations)
        determinants[name] = _determinants(region, workshop)
        everything[name] = {}
        for label, effects in conditions(every=name == _ABLATED).items():
            told(f"region {name}: {label}")
            everything[name][label] = compared(region, effects, scale.seed)
        if name == _ABLATED:
            told(f"region {name}: all recordings with our fit, ours with the papers' fit")
            everything[name]["all effects, our fit for all"] = compared(
                region, Effects(), scale.seed, our_fit_for=tuple(region.excitations[0])
            )
            everything[name]["all effects, papers' fit for all"] = compared(
                region, Effects(), scale.seed, our_fit_for=()
            )
            parts["three"] = _parameters(region, scale.seed)
            told(f"region {name}: criteria against errors")
            count = 40 if scale.tests >= 20 else 12
            answers = [answered(kind, workshop, region, Effects(), rng, count=count) for kind in ("A", "B")]
            parts["correlations"] = tables.correlations(answers)
        # After each region, so that a study that is stopped leaves what it has.
        folder.mkdir(parents=True, exist_ok=True)
        text = _report(everything, determinants, parts, scale, rng)
        (folder / "report.md").write_text(text, encoding="utf-8")
        (folder / "report.html").write_text(page(text, _figures(everything)), encoding="utf-8")
        (folder / "cells.json").write_text(json.dumps(_cells(everything), indent=1), encoding="utf-8")
    return {name: share_of_best(each["all effects"], rng)[0] for name, each in everything.items()}


def conditions(*, every: bool) -> dict[str, Effects]:
    """All effects, none, and if `every` all but each one."""
    found = {"all effects": Effects(), "none but noise": Effects.none()}
    if every:
        found |= {f"all but {f.name}": Effects().without(f.name) for f in fields(Effects) if f.name != "noise"}
    return found


def _determinants(region: Region, workshop: Workshop) -> dict[str, Array]:
    """As printed, of the excitations that were optimised, brought to 2000 samples."""
    printed = replace(workshop.criterion, kind="D", weighting="printed", per_sample=False)
    found: dict[str, Array] = {}
    for algorithm in ("A", "A_local", "B fast", "B slow", "ours"):
        values = []
        for replicate in region.excitations:
            total, count = 0.0, 0
            for one in replicate[algorithm]:
                t = one.trajectory
                grams = workshop.model.grams(t.q[None, ::5], t.qd[None, ::5], t.qdd[None, ::5], printed.independent)
                total, count = total + np.einsum("i,ijk->jk", printed.weights**2, grams[0]), count + len(t.time[::5])
            values.append(-float(printed.of_information(np.asarray(total) * (2000.0 / count), 2000)))
        found[algorithm] = np.array(values)
    return found


def _parameters(region: Region, seed: int) -> str:
    """Table III from the first excitation of each algorithm."""
    model, rng, arm = region.model, np.random.default_rng(seed), HiddenArm(ns16(), Effects())
    papers = model.only([k for k, (_, e) in enumerate(model.effects) if e.kind in PAPERS])
    base, columns = papers.base(np.random.default_rng(0)), papers_columns(model)
    found: dict[str, Array] = {}
    warmth = float(rng.uniform(-1.0, 1.0))
    for algorithm in ("A", "A_local", "B fast", "B slow", "ours"):
        made = region.excitations[0][algorithm]
        rows = [one.torque(arm, rng, warmth) for one in made]
        fit = our_fit(model, made, rows, columns) if algorithm == "ours" else papers_fit(rows, columns)
        found[algorithm] = base.of(fit.parameters[: papers.p])
    return tables.table_three(base.names, base.of(_truth(papers)), found)


def _truth(papers: TorqueModel) -> Array:
    """(p,) the rigid part of the hidden arm, and its friction where no other effect acts."""
    return np.concatenate([papers.tree.weighed().ravel(), ROTORS, COULOMB, VISCOUS, QUADRATIC])


def _report(
    everything: Mapping[str, Mapping[str, Errors]], determinants: Mapping[str, Mapping[str, Array]],
    parts: Mapping[str, str], scale: Scale, rng: np.random.Generator,
) -> str:  # fmt: skip
    lines = [
        "# Local and global identification of a stand-in NS16",
        f"{scale.excitations} independently optimised excitations an algorithm, {scale.tests} test trajectories a case, "
        f"{scale.seconds:g} s of recording for every algorithm. Brackets are 95 % intervals: excitations and test "
        "trajectories drawn anew. Errors are in % of nominal torque unless they say N m.",
    ]
    for name, each in everything.items():
        share, words = share_of_best(each["all effects"], rng)
        lines.append(
            f"## Region {name}: ours is best, or not surely worse than the best, in {100 * share:.0f} % of cells"
        )
        lines.append(tables.table(("case", *(f"axis {k}" for k in range(1, 7))), [[c, *words[c]] for c in CASES]))
        for label in ("all effects", "none but noise"):
            found = {**ordering(each[label].absolute, "fast"), **ordering(each[label].absolute, "slow")}
            lines.append(
                f"The papers' picture with {label}:\n\n" + tables.table(("claim", "here"), list(found.items()))
            )
    lines += ["## Table I", tables.table_one(determinants)]
    for name, each in everything.items():
        lines += [f"## Table II, region {name}, all effects", tables.table_two(each["all effects"], rng)]
    shown = everything.get(_ABLATED, next(iter(everything.values())))
    lines += ["## Table III", parts.get("three", ""), "## Effects left out one by one", tables.factors(shown, rng)]
    lines += [
        "## Postures in which the mass matrix is not positive definite",
        tables.shares(shown),
        "## Which criterion foretells the error?",
    ]
    lines += ["Spearman's rank correlation of a criterion's loss with the error; 1 is a perfect forecast."]
    lines += [parts.get("correlations", "")]
    return "\n\n".join(lines) + "\n"


def _figures(everything: Mapping[str, Mapping[str, Errors]]) -> dict[str, Markup]:
    """By the heading that each stands under."""
    return {
        f"Table II, region {name}, all effects": join(torques(each["all effects"]), distributions(each["all effects"]))
        for name, each in everything.items()
    }


def _cells(everything: Mapping[str, Mapping[str, Errors]]) -> dict[str, object]:
    """Mean absolute errors in N m for each region, condition, algorithm, case and axis."""
    return {
        name: {
            label: {f"{a}; {c}": np.round(v.mean(axis=(0, 1)), 4).tolist() for (a, c), v in errors.absolute.items()}
            for label, errors in each.items()
        }
        for name, each in everything.items()
    }
