# SPDX-License-Identifier: Apache-2.0
"""The study's report: what it shows first, then factors, the papers' open questions, and their tables and figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from trueup.report.markup import Markup
from trueup.studies.arm import tables
from trueup.studies.arm.comparison import Errors, Scale, share_of_best
from trueup.studies.arm.factors import ratios
from trueup.studies.arm.figures import distributions, page, torques
from trueup.studies.arm.questions import after_search

_LEVELS = {
    "B and case 1 slow instead of fast": ("speed", "fast", "slow"),
    "wide planner abrupt instead of gentle": ("ramp", "gentle", "abrupt"),
}
_ALL = "all effects"


@dataclass
class Findings:
    """All that the report tells; a region at a time is added."""

    scale: Scale
    shown: str
    """The region whose details are shown."""
    everything: dict[str, dict[str, Errors]] = field(default_factory=dict)
    determinants: dict[str, Any] = field(default_factory=dict)
    """Region -> algorithm -> log10 det of each excitation."""
    parameters: Any = None
    answers: list[Any] = field(default_factory=list)

    @property
    def details(self) -> Mapping[str, Errors]:
        """Every condition of the region that is shown, or of the first one."""
        return self.everything.get(self.shown, next(iter(self.everything.values())))


def markdown(findings: Findings) -> str:
    """The report's text."""
    rng = np.random.default_rng(findings.scale.seed)
    parts = [_opening(findings.scale), *_shares(findings, rng), *_ordering(findings), *_questions(findings, rng)]
    parts += ["## Effects left out one by one", f"Region {findings.shown}.", tables.factors(findings.details, rng)]
    parts += ["## Postures in which the mass matrix is not positive definite", tables.shares(findings.details)]
    parts += ["## Predicted torque and errors", "## Table I", tables.table_one(findings.determinants)]
    for name, each in findings.everything.items():
        parts += [f"## Table II, region {name}", tables.table_two(each[_ALL], rng)]
    if findings.parameters is not None:
        parts += ["## Table III", tables.table_three(**findings.parameters)]
    return "\n\n".join(parts) + "\n"


def html(text: str, findings: Findings) -> str:
    """The text with the papers' figures, their long tables folded."""
    errors = findings.details[_ALL]
    figures: dict[str, Sequence[Markup]] = {"Predicted torque and errors": (torques(errors), distributions(errors))}
    return page(text, figures, folded=("Table II", "Table III"))


def _opening(scale: Scale) -> str:
    return (
        "# Local and global identification of a stand-in NS16\n\n"
        f"{scale.excitations} independently made excitations an algorithm, {scale.tests} test trajectories a case, "
        f"{scale.seconds:g} s of recording for every algorithm. Brackets are 95 % intervals: excitations and test "
        "trajectories drawn anew. Errors are mean absolute ones in % of nominal torque unless they say otherwise."
    )


def _shares(findings: Findings, rng: np.random.Generator) -> list[str]:
    rows = []
    for region, each in findings.everything.items():
        for label, errors in each.items():
            if not label.startswith("all but"):
                share, words = share_of_best(errors, rng)
                lost = sorted({w for row in words.values() for w in row} - {"best", "even"})
                rows.append([region, label, f"{100 * share:.0f} %", ", ".join(lost) or "-"])
    parts = ["## What it shows", "Mean over six axes and all motions, all effects:"]
    parts += [
        f"**Region {region}**\n\n" + tables.summary(each[_ALL], rng) for region, each in findings.everything.items()
    ]
    return [
        *parts, "Cells of case and axis in which ours is best, or not surely worse than the best:",
        tables.table(("region", "hidden", "share of cells", "who is surely better elsewhere"), rows),
    ]  # fmt: skip


def _ordering(findings: Findings) -> list[str]:
    found = ratios(findings.everything, findings.scale.seed)
    main = [
        "## Where the papers' ordering appears",
        "Ratios of mean absolute errors, geometric mean over axes with interval; then on how many of six axes it is surely "
        "below / surely above one. The papers: B below one in its region, above one elsewhere; A far above one on abrupt "
        "wide planner motion.",
        tables.ratio_table({k: v for k, v in found.items() if not _single(k[0].effects)}),
        "**What each factor does to these ratios**, averaged over the others (second level over first, paired):",
        tables.main_effects_table(found, _LEVELS | _effect_levels(findings.details)),
    ]
    singles = {k: v for k, v in found.items() if _single(k[0].effects)}
    if singles:
        main += ["Effects left out one by one:", tables.ratio_table(singles)]
    return main


def _single(effects: str) -> bool:
    return effects.startswith("all but") or effects.endswith("for all")


def _effect_levels(each: Mapping[str, Errors]) -> dict[str, tuple[str, str, str]]:
    others = [label for label in each if label != _ALL]
    return {f"{label} instead of all effects": ("effects", _ALL, label) for label in others}


def _questions(findings: Findings, rng: np.random.Generator) -> list[str]:
    ranks = [after_search(findings.determinants[r], each[_ALL]) for r, each in findings.everything.items()]
    parts = ["## The papers' open questions"]
    if findings.answers:
        parts += [
            "**Does a larger determinant predict a smaller error, and which criterion serves the friction?** Random "
            "excitations: Spearman's rank correlation of a criterion's loss with the error; 1 is a perfect forecast.",
            tables.correlations(findings.answers),
        ]
    return [
        *parts,
        "**And among excitations that were searched for?** Rank correlation of log det with *minus* the mean error over "
        "all cases, within each algorithm and region:",
        tables.after_search_table(ranks, rng),
        "**Local or global?** Ratios of errors, all effects, all regions:",
        tables.local_or_global({r: each[_ALL] for r, each in findings.everything.items()}, findings.scale.seed),
    ]
