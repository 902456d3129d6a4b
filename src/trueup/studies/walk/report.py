# SPDX-License-Identifier: Apache-2.0
"""The study's report: what each way gained at which falls, the paper's figure 4 with its guidance, and the walks as films."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueup.errors import counted
from trueup.report.markup import Markup, join, tag
from trueup.report.parts import Section, caption, cells, facts, head, hero, key, page, row, table
from trueup.report.plots import AFTER, BAD, BEFORE, INK, SOFT, Plot
from trueup.studies.walk.comparison import Result, over
from trueup.studies.walk.ways import CONTROL, WAYS

PAPER = 26.7
"""% that the paper's walk became faster, at its best step size, over the start walk at its own."""


def html(results: Sequence[Result], film: str = "") -> str:
    """The report as one HTML document. Raises ValueError without results."""
    if not results:
        raise ValueError("the study has no results to report")
    shown = max(_judged(results), key=lambda r: (r.falls <= 0.03, r.gain))
    parts = [
        Section("ways", "Ways", "How much faster do walks get in sixty trials, how often do they fall?", _ways(results)),
        Section("iterations", "Figure 4", "What happened on the way?", _iterations(shown)),
        Section("robots", "Robots", "Is it so on all of them?", _robots(results)),
    ]  # fmt: skip
    if film:
        parts.insert(2, Section("film", "Film", "How does it walk?", Markup(film)))
    robots, seeds = len({r.robot for r in results}), len({r.seed for r in results})
    subtitle = [
        f"{counted(robots, 'stand-in')} of a NAO, fixed beforehand",
        f"{'one search' if seeds == 1 else f'{seeds} searches'} on each",
        "after Farchy et al. 2013",
    ]
    return page("campaign.html", "A walk that gets faster on the robot", subtitle, parts)


def _judged(results: Sequence[Result]) -> list[Result]:
    """Those of the first way: the one that the others stand beside."""
    return [r for r in results if r.way == results[0].way]


def _ways(results: Sequence[Result]) -> Markup:
    rows = []
    for way in dict.fromkeys(r.way for r in results):
        mine = [r for r in results if r.way == way]
        gains, falls = np.array([(100.0 * r.gain, 100.0 * r.falls) for r in mine]).T
        against = "", ""
        if way != CONTROL:
            more, fewer = (over(results, way, CONTROL, f) for f in (_gain, _falls))
            against = (str(more), str(fewer)) if np.isfinite(more.mean) else against
        rows.append(row(
            way, cells(f"{np.median(gains):+.0f}", f"{gains.min():+.0f} to {gains.max():+.0f}", f"{np.median(falls):.3g}",
                       f"{falls.mean():.1f}", *against, str(max(r.trials for r in mine)),
                       f"{max(r.seconds for r in mine) / 60.0:.0f}", f"{np.median([r.cpu for r in mine]):.0f}"),
            title=WAYS[way].name if way in WAYS else way,
        ))  # fmt: skip
    judged = _judged(results)
    top = hero(
        "faster than the start walk at its own best step size, in the median",
        f"{np.median([100.0 * r.gain for r in judged]):.0f} %",
        facts([("falls in 100 fresh runs, median", f"{np.median([100.0 * r.falls for r in judged]):.3g}"),
               ("the paper's robot", f"{PAPER} %, none of five fell")]),
    )  # fmt: skip
    words = (
        "Each walk that was found is judged by fresh runs that nothing was chosen by. The last columns but three: mean "
        "difference on the same robots with the same seeds, 95 % bootstrap interval over robots. Nothing is shown by what is "
        "not better than a simulator that is only made noisy."
    )
    titles = ("way", "gain, %", "range", "falls in 100, median", "mean", f"gain over {CONTROL}", f"falls over {CONTROL}",
              "robot trials", "robot min", "CPU s")  # fmt: skip
    return join(top, table(head(*titles, numbers=range(1, 10)), rows), caption(words))


def _iterations(r: Result) -> Markup:
    """Speed of every walk that was tried, in order: the paper's figure 4."""
    speeds = [100.0 * s.speed for s in r.steps]
    promised = [100.0 * s.promised for s in r.steps]
    goal = 100.0 * r.start_speed
    most = 1.12 * max(v for v in (*speeds, *promised, goal) if np.isfinite(v))
    plot = Plot((0.5, len(r.steps) + 0.5), (0.0, most), "walks tried on the robot", "cm/s", height=340)
    plot.line([(0.5, goal), (len(r.steps) + 0.5, goal)], SOFT, dashed=True)
    plot.text((len(r.steps) + 0.4, goal), "start walk at its best step size", anchor="end", above=5)
    for k, s in enumerate(r.steps, 1):
        said = f"round {s.round}: {100 * s.speed:.1f} cm/s, {s.falls} of {s.runs} fell"
        if np.isfinite(s.promised):
            said += f"; promised {100 * s.promised:.1f}"
            plot.dot((k, 100.0 * s.promised), BEFORE, hollow=True, title=said)
        reached = 100.0 * s.speed if np.isfinite(s.speed) else 0.0
        plot.dot((k, reached), AFTER if s.falls == 0 else BAD, size=3.0 + 0.4 * s.runs, title=said)
        if k > 1 and s.round != r.steps[k - 2].round:
            plot.line([(k - 0.5, plot.y[0]), (k - 0.5, plot.y[1])], SOFT, width=0.7)
            plot.text((k - 0.4, plot.y[1]), f"round {s.round}", INK, above=-13)
    words = [tag("li", f"Round {k}: {'; '.join(each) or 'all parameters'}.") for k, each in enumerate(r.words, 1)]
    legend = key(
        ("after", "stood in all its runs; larger: more runs"), ("bad", "fell or veered in some; at 0: in all"),
        ("before", "promised, falls taken off"),
    )  # fmt: skip
    found = f"found {100 * r.speed:.1f} cm/s, {100 * r.falls:.0f} falls in 100 fresh runs"
    note = caption(f"{r.way}, robot {r.robot}, seed {r.seed}: {found}.")
    svg = plot.svg("speed of each walk that was tried, in order")
    return join(legend, svg, tag("ul", words) if words else "", note)


def _robots(results: Sequence[Result]) -> Markup:
    ways = list(dict.fromkeys(r.way for r in results))
    rows = []
    for robot in dict.fromkeys(r.robot for r in results):
        mine = [r for r in results if r.robot == robot]
        shown = [", ".join(f"{100 * r.speed:.1f} ({100 * r.falls:.0f})" for r in mine if r.way == w) for w in ways]
        start = mine[0]
        rows.append(row(f"stand-in {robot}", cells(f"{100 * start.start_speed:.1f} ({100 * start.start_falls:.0f}) at "
                                                   f"{100 * start.start_share:.0f} %", *shown)))  # fmt: skip
    words = "cm/s of arrivals (falls in 100) of each search's walk; the start walk at its own best step size."
    return join(table(head("", "start walk", *ways, numbers=range(1, 2 + len(ways))), rows), caption(words))


def _gain(r: Result) -> float:
    return 100.0 * r.gain


def _falls(r: Result) -> float:
    return 100.0 * r.falls
