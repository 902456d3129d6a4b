# SPDX-License-Identifier: Apache-2.0
"""The figures of a campaign's report: scores on the robot, the gap, the parameters, the ranking, the search."""

from __future__ import annotations

import math
from collections.abc import Sequence

from trueup.campaign.history import History, mean_known
from trueup.report.markup import Markup, join, tag
from trueup.report.numbers import shortened, significant
from trueup.report.plots import AFTER, BEFORE, FAINT, INK, SOFT, Plot, span

_ROUNDS = "round"


def score_figure(history: History) -> Markup:
    """Every candidate's scores on the robot, in the order in which they were run, and the best so far."""
    entries = [(r, s) for r in history.rounds for s in r.scored]
    expected = [
        history.shown(r.chosen.predicted[s.candidate]) if s.step == "transfer" and r.chosen is not None else math.nan
        for r, s in entries
    ]
    scores = [[history.shown(x) for x in s.scores] for _, s in entries]
    values, better = [x for each in scores for x in each], max if history.counts else min
    marks = _round_marks([r.begun.round for r, _ in entries])
    ends = any(history.early([s for _, s in entries]).values())
    what = (
        f"{history.counts} less what falls cost"
        if history.counts and ends
        else f"{history.counts or 'score'} on the robot"
    )
    plot = Plot((-0.6, len(entries) - 0.4), span([*values, *expected], zero=True), "candidates, as they were run", what,
                width=860, x_marks=marks)  # fmt: skip
    best, steps = math.nan, []
    first = entries[0][1].unit if entries else ()
    for k, ((_, s), made, hoped) in enumerate(zip(entries, scores, expected, strict=True)):
        known = [x for x in made if math.isfinite(x)]
        mean = mean_known(known)
        previous, best = best, (better(best, mean) if math.isfinite(best) else mean) if known else best
        steps += (
            [(k - 0.5, previous), (k - 0.5, best), (k + 0.5, best)] if math.isfinite(previous) else [(k - 0.5, best)]
        )
        plot.dot((k, hoped), SOFT, hollow=True, title=f"expected {significant(hoped)}")
        for x in known:
            plot.dot((k, x), BEFORE if s.unit == first else AFTER, title=f"{significant(x, 4)} on the robot")
        if s.fell:
            plot.text((k, plot.y[1]), "fell", anchor="middle", above=-12)
    if not history.on_robot:  # one run's luck is no best there
        plot.line(steps, INK, width=1.4)
    return plot.svg("Scores of all candidates on the robot, by round")


def gap_figure(history: History) -> Markup:
    """Replay errors by round: fitted recordings, and new ones that the calibration had not seen."""
    rounds = [r for r in history.rounds if r.calibrated is not None]
    fitted = [(r.begun.round, r.calibrated.error_after) for r in rounds if r.calibrated]
    shipped = [(r.begun.round, r.validated.replay_shipped) for r in rounds if r.validated]
    unseen = [(r.begun.round, r.validated.replay_calibrated) for r in rounds if r.validated]
    unit = next((r.calibrated.unit for r in rounds if r.calibrated), "")
    values = [y for _, y in (*fitted, *shipped, *unseen)]
    plot = Plot(_round_range(history), span(values, zero=True), _ROUNDS, f"replay error, {unit}" if unit else "replay error",
                width=860, height=260, x_marks=_round_numbers(history))  # fmt: skip
    for points, colour in ((shipped, BEFORE), (unseen, AFTER), (fitted, INK)):
        plot.line(points, colour)
        for p in points:
            plot.dot(p, colour, title=significant(p[1], 4))
    return plot.svg("Replay error by round")


def parameter_figures(history: History) -> Markup:
    """Each fitted parameter's estimate and interval, round by round."""
    found = [r.calibrated for r in history.rounds if r.calibrated is not None]
    names = [n for n in dict.fromkeys(n for c in found for n, f in zip(c.names, c.fitted, strict=True) if f)]
    figures = []
    for name in names:
        rows = [(c.round, c.values[k], c.low[k], c.high[k], c.units[k]) for c in found for k in (c.names.index(name),)]
        unit = "" if rows[0][4] in ("", "1", "-") else f", {rows[0][4]}"
        plot = Plot(_round_range(history), span([x for row in rows for x in row[1:4]]), width=300, height=150,
                    x_marks=_round_numbers(history))  # fmt: skip
        for r, value, low, high, _ in rows:
            plot.bar(r, low, high, AFTER)
            plot.dot((r, value), AFTER, title=f"{significant(value, 4)} ({significant(low)} to {significant(high)})")
        words = tag("p", shortened(name, 30) + unit, title=name, class_="key")
        figures.append(tag("div", words, plot.svg(f"{name} by round")))
    return join(figures)


def ranking_figure(history: History) -> Markup:
    """What the simulator expected of each candidate against what the robot did; the diagonal is agreement."""
    apart = 14  # Pixels between numbers that can be read
    pairs = [(r.begun.round, history.shown(p), history.shown(m)) for r in history.rounds if r.validated is not None
             for p, m in zip(r.validated.predicted, r.validated.measured, strict=True) if math.isfinite(m)]  # fmt: skip
    both = span([x for _, p, m in pairs for x in (p, m)], margin=0.15)
    plot = Plot(both, both, "expected by the simulator", "on the robot", width=560, height=380)
    plot.line([(both[0], both[0]), (both[1], both[1])], FAINT, dashed=True)
    last, written = max((r for r, _, _ in pairs), default=1), list[tuple[float, float]]()
    for r, p, m in pairs:
        plot.dot(
            (p, m), AFTER if r == last else SOFT, title=f"round {r}: expected {significant(p)}, was {significant(m)}"
        )
        place = plot.at((p, m))
        if all(math.dist(place, other) > apart for other in written):  # numbers would cover each other
            plot.text((p, m), str(r), above=7)
            written.append(place)
    return tag("div", plot.svg("Expected against measured scores"), style="max-width:640px")


def search_figure(history: History) -> Markup:
    """The loss of every simulated candidate, and the lowest so far in each round."""
    rounds = [(r.begun.round, [x for g in r.generations for x in g.losses]) for r in history.rounds if r.generations]
    everything = sorted(x for _, losses in rounds for x in losses if math.isfinite(x))
    usual = everything[: max(1, int(0.95 * len(everything)))]  # the worst would squeeze all others together
    count = sum(len(losses) for _, losses in rounds)
    plot = Plot((0, count), span(usual), "candidates simulated", "loss in simulation", width=860, height=280)
    at = 0
    for number, losses in rounds:
        best, line = math.inf, []
        for k, x in enumerate(losses):
            best = min(best, x) if math.isfinite(x) else best
            line.append((at + k, best if best <= plot.y[1] else math.nan))
            if math.isfinite(x) and x <= plot.y[1]:
                plot.dot((at + k, x), FAINT, size=1.8)
        plot.line(line, AFTER, width=2.0)
        plot.text((at, plot.y[1]), f"round {number}", above=-12)
        at += len(losses)
    return plot.svg("Loss of all simulated candidates")


def _round_marks(rounds: Sequence[int]) -> list[tuple[float, str]]:
    """One mark in the middle of each round's candidates."""
    places = {r: [k for k, x in enumerate(rounds) if x == r] for r in dict.fromkeys(rounds)}
    return [(sum(ks) / len(ks), f"round {r}") for r, ks in places.items()]


def _round_range(history: History) -> tuple[float, float]:
    return 0.5, len(history.rounds) + 0.5


def _round_numbers(history: History) -> list[tuple[float, str]]:
    return [(r.begun.round, str(r.begun.round)) for r in history.rounds]
