# SPDX-License-Identifier: Apache-2.0
"""What a campaign's report shows of settings that were found on the robot itself: which were run, and how runs ended."""

from __future__ import annotations

import re
from dataclasses import dataclass

from trueup.campaign.history import History
from trueup.report.markup import Markup, join, tag
from trueup.report.parts import caption, cells, head, key, row, table
from trueup.report.plots import AFTER, BEFORE, INK, Plot, span


@dataclass
class _Grade:
    """All runs of one grade; a lap that was reached counts as one."""

    settings: tuple[float, ...]
    arrived: float = 0.0
    ended: float = 0.0
    trials: int = 0

    @property
    def runs(self) -> float:
        return self.arrived + self.ended


def grades_shown(history: History) -> Markup:
    """A picture of the grades that were run, and a table."""
    grades = _grades(history)
    best = next((r.ended.best for r in reversed(history.rounds) if r.ended is not None), ())
    marks = key(
        ("after", "nothing fell"), ("before", "some fell or veered, so many"), ("ink", "best; larger: more runs")
    )
    rows = [
        row(history.grade(numbers), cells(str(g.trials), f"{g.runs:.0f}", f"{g.ended:.0f}"),
            class_="best" if g.settings == best else None)
        for numbers, g in sorted(grades.items())
    ]  # fmt: skip
    text = "A run that goes on after it has come through counts as one more. All runs together tell how risk grows."
    return join(
        tag("h3", "Which settings were run, and how runs ended"), marks, _figure(history, grades, best),
        table(head("settings", "trials", "runs", "fell or veered", numbers=range(1, 4)), rows), caption(text),
    )  # fmt: skip


def _grades(history: History) -> dict[tuple[float, ...], _Grade]:
    """By their numbers; the first settings', which nobody chose, are those with which they were run again, if they were."""
    grades: dict[tuple[float, ...], _Grade] = {}
    for story in history.rounds:
        for s in story.scored:
            chosen = story.chosen if s.step == "transfer" else None
            numbers = chosen.numbers[s.candidate] if chosen is not None else history.first_grade
            grade = grades.setdefault(numbers, _Grade(s.unit))
            grade.trials += len(s.scores)
            grade.arrived += sum(part[0] for part in s.tally)
            grade.ended += sum(sum(part[2:]) for part in s.tally) if s.tally else len(s.scores) * s.fell
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
        said = f"{history.grade(numbers)}: {g.ended:.0f} of {g.runs:.0f} fell or veered"
        if g.settings == best:
            plot.dot(at, INK, hollow=True, size=size + 2.5)
        plot.dot(at, BEFORE if g.ended else AFTER, size=size, title=said)
        if g.ended:
            plot.text(at, f"{g.ended:.0f}", anchor="middle", above=size + 3.0)
    return plot.svg("Grades of the settings that were run on the robot")
