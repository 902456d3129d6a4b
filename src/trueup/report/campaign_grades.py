# SPDX-License-Identifier: Apache-2.0
"""What a campaign's report shows of settings that were found on the robot itself: which were run, and how runs ended."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from trueup.campaign.events import Scored
from trueup.campaign.history import History
from trueup.report.markup import Markup, join, tag
from trueup.report.parts import caption, cells, head, key, row, table
from trueup.report.plots import AFTER, BEFORE, INK, Plot, span


@dataclass
class _Grade:
    """All runs of one grade; a lap that was reached counts as one."""

    settings: tuple[float, ...]
    tries: list[Scored] = field(default_factory=list)
    early: dict[str, float] = field(default_factory=dict)

    @property
    def ended(self) -> float:
        return sum(self.early.values())

    @property
    def runs(self) -> float:
        return sum(row[0] for s in self.tries for row in s.tally) + self.ended


def grades_shown(history: History) -> Markup:
    """A picture of the grades that were run, and a table."""
    grades = _grades(history)
    best = next((r.ended.best for r in reversed(history.rounds) if r.ended is not None), ())
    marks = key(("after", "no run ended early"), ("before", "so many did"), ("ink", "best; larger: more runs"))
    rows = [
        row(history.grade(numbers), cells(str(sum(len(s.scores) for s in g.tries)), f"{g.runs:g}",
                                          *(f"{n:g}" for n in g.early.values())),
            class_="best" if g.settings == best else None)
        for numbers, g in sorted(grades.items())
    ]  # fmt: skip
    ways = history.begun.ways if history.begun else ()
    text = (
        "A run that goes on after it has come through counts as one more; one that may have ended in either way, as one that "
        "veered, as half of each. All runs together tell how risk grows."
    )
    return join(
        tag("h3", "Which settings were run, and how runs ended"), marks, _figure(history, grades, best),
        table(head("settings", "trials", "runs", *ways, numbers=range(1, 3 + len(ways))), rows), caption(text),
    )  # fmt: skip


def _grades(history: History) -> dict[tuple[float, ...], _Grade]:
    """By their numbers; the first settings', which nobody chose, are those with which they were run again, if they were."""
    grades: dict[tuple[float, ...], _Grade] = {}
    for story in history.rounds:
        for s in story.scored:
            chosen = story.chosen if s.step == "transfer" else None
            numbers = chosen.numbers[s.candidate] if chosen is not None else history.first_grade
            grade = grades.setdefault(numbers, _Grade(s.unit))
            grade.tries.append(s)
    for grade in grades.values():
        grade.early = history.early(grade.tries)
    return grades


def _figure(history: History, grades: dict[tuple[float, ...], _Grade], best: tuple[float, ...]) -> Markup:
    names = [re.sub(r"\{[^}]*\}", "", n) for n in (history.begun.grades if history.begun else ())]
    points = {numbers: (numbers[0], numbers[1] if len(numbers) > 1 else 0.0) for numbers in grades}
    labels = [re.sub(r"\s+(\S+)\s*$", r", \1", n.strip()) for n in names]
    plot = Plot(
        span([x for x, _ in points.values()]), span([y for _, y in points.values()]), labels[0],
        labels[1] if len(labels) > 1 else "", width=860, height=300,
    )  # fmt: skip
    for numbers, g in grades.items():
        size, at = 3.0 + 1.2 * g.runs**0.5, points[numbers]
        said = f"{history.grade(numbers)}: {g.ended:g} of {g.runs:g} ended early"
        if g.settings == best:
            plot.dot(at, INK, hollow=True, size=size + 2.5)
        plot.dot(at, BEFORE if g.ended else AFTER, size=size, title=said)
        if g.ended:
            plot.text(at, f"{g.ended:g}", anchor="middle", above=size + 3.0)
    return plot.svg("Grades of the settings that were run on the robot")
