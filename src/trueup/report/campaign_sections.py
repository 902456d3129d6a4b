# SPDX-License-Identifier: Apache-2.0
"""The sections of a campaign's report, in the order of the questions that its reader asks."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from datetime import datetime

from trueup.campaign.edges import at_edges
from trueup.campaign.events import Scored
from trueup.campaign.history import History, RoundStory, TrialStory, astray, mean_known
from trueup.campaign.plan import Plan
from trueup.errors import counted
from trueup.report.campaign_figures import gap_figure, parameter_figures, ranking_figure, score_figure, search_figure
from trueup.report.campaign_grades import grades_shown
from trueup.report.campaign_tracks import Track, track_figure
from trueup.report.markup import Markup, join, tag
from trueup.report.numbers import duration_text, fixed, ratio_text, significant, with_unit
from trueup.report.parts import (
    Section,
    callout,
    caption,
    cells,
    change,
    empty,
    facts,
    head,
    hero,
    key,
    row,
    sentences,
    table,
)  # fmt: skip
from trueup.watched_run import is_watched


def campaign_sections(
    history: History, plan: Plan, times: dict[int, float], plan_text: str, tracks: Sequence[Track]
) -> tuple[Section, ...]:
    """All sections."""
    simulated = (
        Section("gap", "The gap", "How did the gap between simulator and robot close?", _gap(history)),
        Section(
            "ranking", "Can it be trusted?", "Does the simulator rank candidates as the robot does?", _ranking(history)
        ),
        Section("search", "The search", "How did the search go?", _search(history)),
    )
    return (
        Section("better", "Better?", "Is the robot better, and by how much?", _better(history, tracks)),
        Section("rounds", "Round by round", "What was tried, and what did the robot do?", _rounds(history)),
        *(() if history.on_robot else simulated),
        Section("trials", "Every run", "What became of every run on the robot?", _trials(history)),
        Section(
            "plan", "The plan", "What was planned, and when did it happen?", _plan(history, plan, times, plan_text)
        ),
    )


def _better(history: History, tracks: Sequence[Track]) -> Markup:
    settings, best = history.best
    first, best = history.shown(history.first_score), history.shown(best)
    if not settings:
        return join(callout("warn", "No run has a score yet.", "The robot's runs are listed below as they come."))
    unit, before = history.begun.unit if history.begun else "", significant(first) if math.isfinite(first) else ""
    said = [f" The robot {words}." for words in (history.done_by_best, history.falls_of_best) if words]
    words = tag("p", "".join((_sentence(history, first, best), *said)), class_="verdict-sentence")
    counts = f"{history.counts} on the robot" if history.counts else "the task's score on the robot (lower is better)"
    parts = [
        hero(counts, change(before, significant(best), unit),
             tag("div", words)),
        tag("h3", "The best settings"), facts((name, history.setting(name, value)) for name, value in settings.items()),
        *([caption(f"{edges}.")] if (edges := at_edges(history)) else []),
        tag("h3", "Every candidate on the robot"),
        key(("before", "settings at first" if before else "tried first"), ("after", "on the robot"),
            ("ink", "hollow: what was expected" if history.on_robot else "best so far; hollow: what the simulator expected")),
        score_figure(history), *([grades_shown(history)] if history.on_robot else []),
    ]  # fmt: skip
    if tracks and all(is_watched(t.best) for t in tracks):
        parts.append(
            caption("There is no picture of what it did: its runs were watched, not logged. What was seen is below.")
        )
    elif tracks:
        parts += [
            tag("h3", "What the robot did"),
            key(
                ("before", "with the first settings" if before else "with those tried first"),
                ("after", "with the best"),
                *([("faint", "the path to follow")] if any(t.wanted is not None for t in tracks) else []),
            ),
        ]
        parts += [track_figure(t) for t in tracks if not is_watched(t.best)]
        said = "Positions as they were recorded, of the last run with each of these settings."
        if any(t.wanted is not None for t in tracks):
            said += (
                " The task may judge another point: of a car the front axle, whose rear axle, logged, cuts each curve."
            )
        parts.append(caption(said))
    return join(parts)


def _sentence(history: History, first: float, best: float) -> str:
    """What became of scores as people read them."""
    if not math.isfinite(first):
        return "The settings that the robot had at first were not run, so there is nothing to compare with."
    if (best > first) if history.counts else (best < first <= 0.0):  # of a negative error no share is left
        what, change = history.counts or "score", history.change(history.best[1])
        more = f": {fixed(100 * change, 1)} % more" if math.isfinite(change) else ""
        return f"On the robot the {what} went from {significant(first)} to {significant(best)}{more}."
    if best < first and not history.counts:
        return f"On the robot the score fell to {ratio_text(best, first)}: {fixed(100 * (1 - best / first), 1)} % less."
    return "Nothing that was tried did better on the robot than what it had at first; these settings are kept."


def _rounds(history: History) -> Markup:
    return join(_round(history, r) for r in history.rounds) if history.rounds else empty("Nothing yet.")


def _round(history: History, story: RoundStory) -> Markup:
    whole = f"round-{story.begun.round}/calibration.html"
    link = tag("a", "The whole calibration.", href=whole) if story.calibrated is not None else None
    parts = [tag("h3", f"Round {story.begun.round}"), tag("p", _round_words(story), " ", link)]
    rows = [_candidate(history, story, s) for s in story.scored]
    if rows:
        names = _shown_settings(history)
        units = {n: f", {history.setting(n, 0.0)[2:]}".removesuffix(", ") for n in names}
        of = f", {history.begun.unit}" if history.begun and history.begun.unit else ""
        titles = ("tried", f"expected{of}", f"on the robot{of}", *(n + units[n] for n in names))
        parts.append(table(head(*titles, numbers=range(1, len(titles))), rows, "rounds"))
    return join(parts)


def _round_words(story: RoundStory) -> str:
    parts = []
    done, new = story.calibrated, story.validated
    if done is not None:
        before, after = (with_unit(significant(x), done.unit) for x in (done.error_before, done.error_after))
        count = counted(len(done.recordings), "recording")
        parts.append(
            f"{sum(done.fitted)} parameters fitted to {count}: replay error {before} as shipped, {after} calibrated."
        )
    if story.generations:
        reach = significant(story.begun.radius, 2)
        parts.append(f"{story.tried} candidates simulated within {reach} of each range around the best.")
    if new is not None and math.isfinite(new.replay_calibrated):
        error = with_unit(significant(new.replay_calibrated), new.unit)
        parts.append(f"The new runs, which the fit had not seen, were replayed to {error}.")
    if story.ended is not None:
        wider = "widened" if story.ended.radius > story.begun.radius else "narrowed"
        moved = "same" if story.ended.radius == story.begun.radius else wider
        verdict = "The robot improved" if story.ended.improved else "The robot did not improve"
        parts.append(f"{verdict}." if story.chosen and story.chosen.numbers else f"{verdict}; trust region {moved}.")
    return " ".join(parts) or "Under way."


def _shown_settings(history: History) -> list[str]:
    """Names of settings that differ from run to run, in the task's order; all where none does."""
    tried = [t.planned.settings for t in history.trials]
    names = list(dict.fromkeys(k for settings in tried for k in settings))
    return [n for n in names if len({settings.get(n) for settings in tried}) > 1] or names


def _candidate(history: History, story: RoundStory, scored: Scored) -> Markup:
    names = _shown_settings(history)
    settings = next(
        (t.planned.settings for t in story.trials
         if (t.planned.step, t.planned.candidate) == (scored.step, scored.candidate)), {}
    )  # fmt: skip
    picked = story.chosen if scored.step == "transfer" else None
    measured = history.shown(mean_known(scored.scores))
    expected = math.nan
    which = "experiment"
    if picked is not None:
        expected = history.shown(picked.predicted[scored.candidate])
        which = "best so far, again" if scored.candidate == picked.incumbent else f"candidate {scored.candidate}"
    elif scored.step == "confirm":
        which = "the best, once more"
    elif scored.candidate == 0 and story.begun.round == 1:
        which = "as it was"
    done = {1.0: " (done)", 0.0: " (not done)"}.get(scored.done, "")
    early = ", ".join(way for way, n in history.early([scored]).items() if n)
    shown = "fell" if scored.fell else significant(measured, 4) + done + (f" ({early})" if early else "")
    best = story.ended is not None and scored.unit == story.ended.best
    numbers = [significant(settings.get(n, math.nan), 4) for n in names]
    return row(which, cells(significant(expected, 4), shown, *numbers), class_="best" if best else None)


def _gap(history: History) -> Markup:
    if not any(r.calibrated for r in history.rounds):
        return empty("Nothing was calibrated.")
    figure = gap_figure(history)
    legend = key(("before", "new runs, simulator as shipped"), ("after", "new runs, calibrated before they were made"),
                     ("ink", "fitted runs"))  # fmt: skip
    parts = [legend, figure, tag("h3", "The parameters"), tag("div", parameter_figures(history), class_="figures")]
    text = "Dots: estimates of each round; bars: their 95 % intervals; the axis spans what all rounds found."
    return join([*parts, caption(text)])


def _ranking(history: History) -> Markup:
    rows = []
    for r in history.rounds:
        v = r.validated
        if v is None:
            continue
        compared = sum(math.isfinite(m) for m in v.measured)
        numbers = (str(compared), fixed(v.tau, 2), _interval(v.low, v.high), fixed(v.spearman, 2), fixed(v.tau_all, 2),
                 _interval(v.low_all, v.high_all))  # fmt: skip
        rows.append(row(str(v.round), cells(*numbers)))
    if not rows:
        return empty("No candidates have been compared yet.")
    titles = ("round", "candidates", "Kendall's tau", "95 % interval", "Spearman's rho", "tau of all rounds so far",
              "95 % interval")  # fmt: skip
    text = (
        "1: simulator and robot put the candidates in the same order; 0: no relation; −1: the reverse. The interval is exact "
        "under Mallows' model of rankings, and wide as long as few candidates were compared."
    )
    doubts = [
        callout("warn", f"Round {r.begun.round}", s[0].upper() + s[1:])
        for r in history.rounds if r.validated is not None and (s := astray(r.validated))
    ]  # fmt: skip
    return join(*doubts, ranking_figure(history), table(head(*titles, numbers=range(1, 7)), rows), caption(text))


def _interval(low: float, high: float) -> str:
    return f"{fixed(low, 2)} to {fixed(high, 2)}" if math.isfinite(low) else "—"


def _search(history: History) -> Markup:
    done = [r for r in history.rounds if r.generations]
    if not done:
        return empty("Nothing was searched yet.")
    ends = [f"round {r.begun.round}: {r.chosen.ended}" for r in done if r.chosen is not None]
    return join(search_figure(history), sentences(ends))


def _trials(history: History) -> Markup:
    rows = [_trial(t) for t in history.trials]
    if not rows:
        return empty("None yet.")
    return table(head("run", "round", "of", "settings", "outcome", "recordings"), rows)


def _trial(story: TrialStory) -> Markup:
    p, done = story.planned, story.done
    settings = ", ".join(f"{k} {significant(v, 4)}" for k, v in p.settings.items())
    outcome = done.outcome if done else "waited for" if story.started else "planned"
    note = tag("small", f" {done.note}") if done and done.note else None
    files: Iterable[Markup] = (tag("a", f, href=f"recordings/{f}") for f in (done.recordings if done else ()))
    recorded = [join(f, " ") for f in files]
    return row(p.trial, cells(f"{p.round}, {p.step}", p.of, settings, join(outcome, note), recorded, kind=""))


def _plan(history: History, plan: Plan, times: dict[int, float], plan_text: str) -> Markup:
    begun: list[tuple[str, str]] = [("seed", str(plan.seed))]
    if history.begun is not None:
        begun += [("trueup", history.begun.version), ("plan and seed, SHA-256", history.begun.plan[:16] + "…")]
    if times and 0.0 < min(times.values()) <= max(times.values()) < 253e9:  # s: until the year 9999
        first, last = (datetime.fromtimestamp(f(times.values())) for f in (min, max))
        begun += [("begun", f"{first:%Y-%m-%d %H:%M}"), ("last event", f"{last:%Y-%m-%d %H:%M}"),
                  ("from first to last", duration_text((last - first).total_seconds()))]  # fmt: skip
    text = tag("pre", plan_text, class_="plan") if plan_text else None
    return join(facts(begun), text)
