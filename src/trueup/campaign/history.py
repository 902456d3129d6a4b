# SPDX-License-Identifier: Apache-2.0
"""A campaign's events put together by rounds: what its status, its report and its display are made from."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from trueup.campaign.events import (
    Begun,
    Calibrated,
    Chosen,
    Ended,
    Event,
    Generation,
    RoundBegun,
    RoundEnded,
    Scored,
    TrialDone,
    TrialPlanned,
    TrialStarted,
    Validated,
)
from trueup.evidence import HALVED
from trueup.loop.transfer import best_known


@dataclass
class TrialStory:
    """One trial: planned, perhaps under way, perhaps done."""

    planned: TrialPlanned
    started: bool = False
    done: TrialDone | None = None


@dataclass
class RoundStory:
    """One round as far as it went."""

    begun: RoundBegun
    trials: list[TrialStory] = field(default_factory=list)
    scored: list[Scored] = field(default_factory=list)
    calibrated: Calibrated | None = None
    generations: list[Generation] = field(default_factory=list)
    chosen: Chosen | None = None
    validated: Validated | None = None
    ended: RoundEnded | None = None

    def choose(self, event: Chosen) -> None:
        """All at once, or one more where each trial is chosen by those before it."""
        one = self.chosen
        self.chosen = event if one is None else replace(
            event, candidates=one.candidates + event.candidates, predicted=one.predicted + event.predicted,
            spreads=one.spreads + event.spreads, unsafe=one.unsafe + event.unsafe, numbers=one.numbers + event.numbers,
        )  # fmt: skip

    @property
    def tried(self) -> int:
        """Candidates simulated so far."""
        return sum(len(g.losses) for g in self.generations)

    @property
    def best_simulated(self) -> float:
        """The lowest loss so far; NaN without any."""
        losses = [x for g in self.generations for x in g.losses if math.isfinite(x)]
        return min(losses, default=math.nan)

    @property
    def transferred(self) -> list[Scored]:
        """The candidates of the transfer, as the robot scored them."""
        return [s for s in self.scored if s.step == "transfer"]


@dataclass
class History:
    """The whole story so far."""

    begun: Begun | None = None
    rounds: list[RoundStory] = field(default_factory=list)
    ended: Ended | None = None

    @classmethod
    def of(cls, events: Iterable[Event]) -> History:
        """From the events of a journal."""
        history = cls()
        for event in events:
            history.add(event)
        return history

    def add(self, event: Event) -> None:
        """One more event."""
        match event:
            case Begun():
                self.begun = event
            case RoundBegun():
                self.rounds.append(RoundStory(event))
            case Ended():
                self.ended = event
            case TrialPlanned():
                self.rounds[-1].trials.append(TrialStory(event))
            case TrialStarted():
                self._trial(event.trial).started = True
            case TrialDone():
                self._trial(event.trial).done = event
            case Scored():
                self.rounds[-1].scored.append(event)
            case Calibrated():
                self.rounds[-1].calibrated = event
            case Generation():
                self.rounds[-1].generations.append(event)
            case Chosen():
                self.rounds[-1].choose(event)
            case Validated():
                self.rounds[-1].validated = event
            case RoundEnded():
                self.rounds[-1].ended = event

    @property
    def trials(self) -> list[TrialStory]:
        """All trials, in order."""
        return [t for r in self.rounds for t in r.trials]

    @property
    def waiting(self) -> list[TrialStory]:
        """Trials that were planned and have no outcome."""
        return [t for t in self.trials if t.done is None]

    @property
    def on_robot(self) -> bool:
        """Whether settings are found on the robot, by how all of its runs ended."""
        return self.begun is not None and bool(self.begun.grades)

    @property
    def first_grade(self) -> tuple[float, ...]:
        """Of today's settings."""
        return self.begun.first if self.begun else ()

    def early(self, tries: Iterable[Scored]) -> dict[str, float]:
        """In how many runs of these tries each way to end early was taken; half of one where two are as likely."""
        ways = self.begun.ways if self.begun else ()
        even = dict.fromkeys(ways, 0.0)
        for s in tries:
            rows = s.tally or ((0.0, 0.0, *(s.fell * len(s.scores) / len(ways) for _ in ways)),)
            for row in rows:
                for way, n in zip(ways, row[2:], strict=True):
                    even[way] += n
        return even

    def grade(self, numbers: tuple[float, ...]) -> str:
        """A grade of the settings, for people."""
        return ", ".join(n.format(x) for n, x in zip(self.begun.grades if self.begun else (), numbers, strict=True))

    @property
    def first_score(self) -> float:
        """What the robot did with the settings it had at the beginning; NaN where that was never run."""
        start = self.rounds[0].begun.incumbent if self.rounds else ()
        return mean_known([x for r in self.rounds for s in r.scored if s.unit == start for x in s.scores])

    @property
    def best(self) -> tuple[Mapping[str, float], float]:
        """Settings and score of the best on the robot so far; {} and NaN before any run was scored."""
        scored = [s for r in self.rounds for s in r.scored]
        if not any(math.isfinite(x) for s in scored for x in s.scores):
            return {}, math.nan
        ended = [r.ended for r in self.rounds if r.ended is not None]
        if self.on_robot and ended:
            return self.settings(ended[-1].best), ended[-1].score
        unit, score = best_known(
            [np.array(s.unit) for s in scored], [np.array(s.scores) for s in scored], [s.fell for s in scored]
        )
        return self.settings(tuple(unit.tolist())), score

    @property
    def falls_of_best(self) -> str:
        """'fell in 2 of 5 tries' where the robot fell with the best settings; '' elsewhere."""
        tries = self._tries_of_best
        early, runs = self.early(tries), sum(row[0] for s in tries for row in s.tally)
        if self.on_robot and (ended := sum(early.values())) + runs:
            which = ", ".join(f"{way} {n:g}" for way, n in early.items()) if ended else ""
            said = f"ended early in {ended:g} of {runs + ended:g} runs with them" + (f" ({which})" if which else "")
            known = [r.ended.early for r in self.rounds if r.ended is not None and r.ended.early]
            if not known:
                return said
            share, low, high = (100.0 * x for x in known[-1])
            return f"{said}; by all of its runs together {share:.2g} in 100 are expected to (95 %: {low:.2g} to {high:.2g})"
        fell = sum(s.fell for s in tries)
        return f"fell in {fell} of {len(tries)} tries with them" if fell else ""

    @property
    def done_by_best(self) -> str:
        """'did it in 2 of 3 runs' of a task that is done or not, with the best settings; '' of any other."""
        runs = [(s.done, len(s.scores)) for s in self._tries_of_best if math.isfinite(s.done)]
        return (
            f"did it in {sum(round(d * n) for d, n in runs)} of {sum(n for _, n in runs)} runs with them"
            if runs
            else ""
        )

    @property
    def _tries_of_best(self) -> list[Scored]:
        best = self.best[0]
        return [s for r in self.rounds for s in r.scored if best and self.settings(s.unit) == best]

    @property
    def counts(self) -> str:
        """What people count of the task's score, which is minus that; '' where it is an error or a cost as it stands."""
        return self.begun.counts if self.begun else ""

    def shown(self, score: float) -> float:
        """A score as people read it: of a walk its speed."""
        return -score + 0.0 if self.counts else score

    def score(self, value: float) -> str:
        """A score as people read it, with its unit."""
        return f"{self.shown(value):.4g} {self.begun.unit if self.begun else ''}".rstrip()

    def change(self, score: float) -> float:
        """By which share a score differs from the first, above zero for more; NaN where that says nothing."""
        first, last = self.shown(self.first_score), self.shown(score)
        return last / first - 1.0 if first > 0.0 and math.isfinite(last) else math.nan

    def setting(self, name: str, value: float) -> str:
        """A setting with its unit."""
        return f"{value:.5g} {self.begun.units.get(name, '') if self.begun else ''}".rstrip()

    def settings(self, unit: tuple[float, ...]) -> Mapping[str, float]:
        """The settings that a candidate was performed with; {} where it never was."""
        for r in self.rounds:
            for s in r.scored:
                if s.unit == unit:
                    for t in r.trials:
                        if (t.planned.step, t.planned.candidate) == (s.step, s.candidate):
                            return t.planned.settings
        return {}

    @property
    def phase(self) -> str:
        """What it is doing, or was when it stopped."""
        if self.ended is not None:
            return "ended"
        if not self.rounds or self.rounds[-1].ended is not None:
            return "confirm" if self.waiting else "starting"
        last = self.rounds[-1]
        if last.chosen is not None:
            return "transfer"
        if last.generations:
            return "optimize"
        if any(t.done is None for t in last.trials):
            return "experiment"
        return "optimize" if last.calibrated is not None else "calibrate"

    def _trial(self, name: str) -> TrialStory:
        return next(t for t in reversed(self.rounds[-1].trials) if t.planned.trial == name)


def astray(event: Validated) -> str:
    """A sentence where the robot's scores are not near what was expected of any candidate; '' where they are.

    A calibrated simulator may be wrong by some share; at half of it or double it mostly does not do the same run.
    """
    both = [(p, m) for p, m in zip(event.predicted, event.measured, strict=True) if p * m > 0.0]
    if len(both) < 2:
        return ""
    ratio = statistics.median(m / p for p, m in both)
    if HALVED <= ratio <= 1.0 / HALVED:
        return ""
    words = f"{ratio:.2g} times" if ratio > 1.0 else f"only {100 * ratio:.2g} % of"
    return (
        f"the robot scored {words} what was expected: do both runs begin alike (the task's trials say with `initial` where), "
        "end alike, and is the same observed?"
    )


def unlike(predicted: float, measured: float, counts: str = "") -> str:
    """A sentence where the calibrated simulator is far off the robot's score with settings that have been run already."""
    if counts:
        predicted, measured = -predicted, -measured
    if not (predicted > 0.0 and measured > 0.0) or HALVED <= measured / predicted <= 1.0 / HALVED:
        return ""
    return (
        f"the calibrated simulator scores {predicted:.3g} with settings that the robot has run at {measured:.3g}: what it "
        "proposes may not work there. Do both runs begin and end alike, and is the same observed? Ctrl-C stops here; "
        "nothing is lost"
    )


def mean_known(values: Iterable[float]) -> float:
    """The mean of the scores that there are; NaN without any."""
    known = [v for v in values if math.isfinite(v)]
    return sum(known) / len(known) if known else math.nan
