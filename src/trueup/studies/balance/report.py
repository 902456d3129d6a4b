# SPDX-License-Identifier: Apache-2.0
"""The study's report: what transferred, after how many rounds, with what data; figures and Table I as the paper has them."""

from __future__ import annotations

from typing import Any

import numpy as np

from trueup.report.markup import Markup, join, tag
from trueup.report.parts import Section, caption, cells, facts, head, hero, page, row, sentences, table
from trueup.studies.balance.pictures import orientation, replay, strip
from trueup.studies.balance.plan import SCENES
from trueup.studies.balance.study import Findings

PAPER = {"lean-to-stand": 1, "sit-to-stand": 0, "kneel-to-stand": 1, "stand-to-handstand": 2}
"""Calibrations that the paper's robot needed."""
TABLE_ONE = {
    "I": "SFF", "II": "FSF", "III": "SFS", "I+II": "SSS", "I+III": "SFS", "II+III": "SSS", "I+II+III": "SSS",
}  # fmt: skip
"""The paper's Table I: calibrated on, and whether tasks I, II and III succeeded."""
_NUMERALS: dict[str, str] = dict(zip(SCENES, ("I", "II", "III", "IV"), strict=True))


def html(findings: Findings) -> str:
    """The report as one HTML document."""
    parts = [
        Section("transfer", "Transfer", "Does a motion found in simulation work on the robot?", _transfer(findings))
    ]
    for scene in findings.campaigns:
        question = f"Task {_NUMERALS[scene]}, {scene.replace('-', ' ')}"
        parts.append(Section(scene, scene.replace("-to-stand", "").split("-")[-1], question, _scene(findings, scene)))
    if findings.subsets:
        parts.append(Section("table", "Table I", "Does a calibration hold for other tasks?", _table_one(findings)))
    parts.append(
        Section("errors", "Errors", "How much nearer does a calibration bring the simulator?", _errors(findings))
    )
    subtitle = [f"{_robots(findings)} stand-ins in DART, truths fixed by their numbers",
                f"at most {findings.size.depth.rounds} calibrations", "three repeats a round"]  # fmt: skip
    return page("campaign.html", "Humanoid transitions by calibrated simulation", subtitle, parts)


def _transfer(f: Findings) -> Markup:
    rounds = f.size.depth.rounds
    titles = ("task", "stand-ins", "as it was", "after 1", f"after {rounds}", "rounds", "the paper", "robot, s",
              "randomised", "on the robot: runs")  # fmt: skip
    rows = []
    for scene in f.size.scenes:
        if scene not in f.campaigns:
            why = "no motion was found in the simulator itself" if scene in f.first else "not computed yet"
            rows.append(row(_name(scene), tag("td", why, colspan="9")))
            continue
        needed, done = f.needed(scene), f.campaigns[scene].values()
        seconds = [sum(r["seconds"] for r in each) for each in done]
        runs = [n for n in f.oracle.get(scene, {}).values() if n]
        rows.append(row(_name(scene), cells(
            str(len(done)), *(_share(f.share(scene, k)) for k in (0, 1, rounds)), _median(needed), str(PAPER[scene]),
            f"{np.median(seconds):.1f}", _share(f.blindly(scene)),
            f"{_median(runs)} ({len(runs)} of {len(f.oracle[scene])})" if scene in f.oracle else "",
        )))  # fmt: skip
    top = hero("of all stand-ins, mean of tasks", _share(f.overall(rounds)),
               facts([("without calibration", _share(f.overall(0)))]))  # fmt: skip
    words = (
        "A motion works where most of three repeats end upright (or inverted), high and still. Medians of rounds "
        "(calibrations until it works) and of seconds that the robot ran in all rounds. Randomised: one motion searched in "
        "models drawn widely around the file, never calibrated. On the robot: CMA-ES that tries every candidate on the robot "
        "itself; median of its runs, where it found one."
    )
    return join(top, table(head(*titles, numbers=range(1, 10)), rows), caption(words))


def _scene(f: Findings, scene: str) -> Markup:
    rounds = f.campaigns[scene]
    rows = [
        row(f"stand-in {n}", tag("td", ", ".join(f"{sum(r['stood'])} of {len(r['stood'])}" for r in each)),
            cells(*(f"{each[0]['errors'][0]:.3f}", f"{each[-1]['errors'][1]:.3f}" if len(each) > 1 else "")))
        for n, each in rounds.items()
    ]  # fmt: skip
    shown = max(rounds.values(), key=lambda each: (each[-1]["succeeded"], len(each) == 2, len(each)))
    first, last = shown[0]["poses"], shown[-1]["poses"]
    parts = [
        tag("h3", "The first motion, before any calibration"),
        strip(scene, {w: first[w] for w in ("file", "robot")}),
        orientation({w: first[w] for w in ("robot", "file", "fitted") if w in first}),
    ]  # fmt: skip
    if len(shown) > 1:
        parts += [tag("h3", "The last one, as the simulator foretold it and as the robot did it"),
                  strip(scene, {w: last[w] for w in ("calibrated", "robot")})]  # fmt: skip
    told = ("file", "calibrated", "robot") if len(shown) > 1 else ("file", "robot")
    titles = ("", "repeats that stood, by round", "error by the file, rad", "by the last calibration, rad")
    parts += [replay(scene, {w: last[w] for w in told}), table(head(*titles, numbers=(2, 3)), rows)]
    return join(*parts)


def _table_one(f: Findings) -> Markup:
    scenes = [s for s in SCENES[:3] if s in f.campaigns]
    before = {s: [each[0]["succeeded"] for n, each in f.campaigns[s].items() if n in f.size.numbers[: f.size.subsets]]
              for s in scenes}  # fmt: skip
    rows = [row("none", *(tag("td", f"{sum(before[s])} of {len(before[s])}") for s in scenes))]
    for on, per in f.subsets.items():
        numerals = "+".join(_NUMERALS[s] for s in on.split("+"))
        told = [f"{sum(per[s])} of {len(per[s])} ({TABLE_ONE[numerals][SCENES.index(s)]})" for s in scenes]
        rows.append(row(numerals, *(tag("td", t) for t in told)))
    words = (
        "Stand-ins on which the task in the column worked, with a simulator calibrated on the tasks of the row; the "
        "paper's one robot in brackets (S succeeded, F failed)."
    )
    return join(table(head("calibrated on", *(_name(s) for s in scenes)), rows), caption(words))


def _errors(f: Findings) -> Markup:
    kinds = {
        "Motions that were not fitted ({}, each tried after one calibration on others)": f.unfitted(),
        "Repeats of the fitted motions that were left out of the fit ({}, as in the paper's Figure 5)": f.left_out(),
    }
    lines = [
        f"{kind.format(count)}: the simulated torso is {before:.3f} rad from the robot's by the model file and "
        f"{after:.3f} rad as calibrated, {after / before:.2f} of it."
        for kind, (count, before, after) in kinds.items()
        if count
    ]
    if not lines:
        return tag("p", "No round followed a calibration.")
    return sentences(
        [*lines, "Each run is compared by itself, its fall included; when a fall begins decides most of it."]
    )


def _robots(f: Findings) -> int:
    """Stand-ins of which any task is told."""
    return len({n for per in f.campaigns.values() for n in per})


def _name(scene: str) -> str:
    return f"{_NUMERALS[scene]} {scene.replace('-', ' ')}"


def _share(value: float) -> str:
    return f"{100.0 * value:.0f} %" if np.isfinite(value) else ""


def _median(values: list[Any]) -> str:
    return f"{np.median(values):g}" if values else ""
