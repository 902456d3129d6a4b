# SPDX-License-Identifier: Apache-2.0
"""The report of a grounding: how well learners predict, what the chosen one looks at, what it does for a simulator."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from trueup.errors import counted
from trueup.formats.aside import write_aside
from trueup.report.markup import Markup, join, tag
from trueup.report.numbers import scale_for
from trueup.report.parts import Section, callout, caption, cells, context_table, head, hero, key, page, row, table
from trueup.report.plots import AFTER, FAINT, INK, Plot, span
from trueup.rounding import SAME_INSTANT

Story = Mapping[str, Any]
"""What `trueup ground` writes as grounding.json."""


def write_grounding_report(story: Story, path: Path) -> Path:
    """Writes the report to the HTML file `path` and returns it. Raises OutputError."""
    counts = ((len(story["joints"]), "joint"), (len(story["recordings"]), "recording"), (story["frames"], "frame"))
    sections = [
        Section("learners", "Learners", "How well is the next frame predicted?", _learners(story)),
        *([Section("held", "Held out", "And on runs that were held out?", _judged(story))] if story["judged"] else []),
        *([Section("simulator", "Simulator", "Does the simulator move as the robot did?", _simulator(story))]
          if "simulator" in story else []),
        Section("joints", "Joints", "Which joints are hard?", _joints(story)),
        Section("inputs", "Inputs", "What goes into a prediction?", _inputs(story)),
        Section("details", "Details", "How was this done?", _details(story)),
    ]  # fmt: skip
    title = (
        f"Grounding of {story['simulator']['model']}" if "simulator" in story else "What the joints do with commands"
    )
    write_aside(page("campaign.html", title, [counted(n, noun) for n, noun in counts], sections), path)
    return path


def _learners(story: Story) -> Markup:
    titles = ("learner", "rows out: RAE %", "RRSE %", "runs out: RAE %", "RRSE %", "a second on", "fit, s")
    rows = []
    for each in story["learners"]:
        numbers = [_percent(each[k], m) for k in ("by_row", "by_run") for m in ("rae", "rrse")]
        more = (f"{each['by_run']['ahead']:.3g}", f"{each['by_run']['seconds']:.2f}")
        name = tag("strong", each["learner"]) if each["learner"] == story["chosen"] else each["learner"]
        rows.append(row(join([name, tag("span", f" {each['weka']}", class_="caption")]), cells(*numbers, *more)))
    hold = story["hold"]
    held = ("", "", _percent(hold, "rae"), _percent(hold, "rrse"), f"{hold['ahead']:.3g}", "")
    rows.append(row("hold the last value", cells(*held)))
    best = next(x["by_run"] for x in story["learners"] if x["learner"] == story["chosen"])
    label = f"{story['chosen']}: error of the next frame, in % of the mean's; holding the last value: {_percent(hold, 'rae')}"
    note = (
        "Errors relative to those of the training mean, as Weka has them, means over joints that move: absolute (RAE) and "
        "root squared (RRSE). Rows left out at random have neighbours among those learned from; whole runs have none, so "
        "these decide. "
        "'A second on' goes on from its own predictions, as in a simulator, in spreads of the joints."
    )
    skipped = callout("warn", "Not compared", f"The time was not enough for {', '.join(story['skipped'])}.")
    return join(
        [hero(label, f"{_percent(best, 'rae')} %"), table(head(*titles, numbers=range(1, 7)), rows), caption(note),
         tag("p", f"Why {story['chosen']}: {story['why']}."), skipped if story["skipped"] else Markup("")]
    )  # fmt: skip


def _judged(story: Story) -> Markup:
    scale = scale_for(story["unit"], [s["error"] for s in story["judged"]])
    rows = [
        row(s["name"], cells(scale.text(s["error"]), _percent(s, "rae"), f"{s['ahead']:.3g}")) for s in story["judged"]
    ]
    titles = ("", f"one frame on, {scale.unit}", "RAE %", "a second on, spreads")
    return join(
        [table(head(*titles, numbers=range(1, 4)), rows), caption(f"Held out: {', '.join(story['held_out'])}.")]
    )


def _simulator(story: Story) -> Markup:
    told = story["simulator"]
    rows = [row(r["recording"], _replay(r, told["replays"])) for r in told["replays"]]
    how = f"{', chained' * told['chained']}{', by its inverse model' * told['inverse']}"
    what = {"": "what is predicted is told to it", "command": "what it lacks is added to its commands",
            "torque": "what it lacks is added to its joints as torque"}[told["residual"]]  # fmt: skip
    words = f"{told['share']:.2g} of {what}{how}: {told['why']}."
    note = "Root mean square of simulated minus measured. Refused: it asks for what was not learned."
    why = [callout("warn", name, reason) for name, reason in told["refused"].items()]
    titles = ("recording", "", "channel", "as it is", "grounded", "")
    return join([tag("p", words), table(head(*titles, numbers=(3, 4)), rows), caption(note), *why])


def _replay(each: Story, beside: Sequence[Story]) -> Markup:
    """Cells of one recording's channel, in the unit that fits all recordings' errors of it."""
    scale = scale_for(each["unit"], [r["before"] for r in beside if r["channel"] == each["channel"]])
    after = scale.text(each["after"]) if math.isfinite(each["after"]) else "refused"
    words = cells(each["kind"], each["channel"], kind="")
    return join([words, cells(scale.text(each["before"]), after), cells(scale.unit, kind="")])


def _joints(story: Story) -> Markup:
    best = next(x["by_run"] for x in story["learners"] if x["learner"] == story["chosen"])
    scale, hold = scale_for(story["unit"], best["rmse"]), story["hold"]
    rows = [
        row(
            j,
            cells(
                scale.text(best["rmse"][k]),
                _percent({"rae": [best["rae"][k]]}, "rae") or "stands still",
                scale.text(hold["rmse"][k]),
            ),
        )
        for k, j in enumerate(story["joints"])
    ]
    unit = f", {scale.unit}" if scale.unit else ""
    titles = ("joint", f"{story['chosen']}{unit}", "RAE %", f"hold the last value{unit}")
    note = "One frame on, whole runs left out." + (
        "" if unit else " In the recordings' own unit, which they do not name."
    )
    return join([table(head(*titles, numbers=range(1, 4)), rows), caption(note), *_foretold(story, best["rae"])])


def _foretold(story: Story, errors: Sequence[float]) -> list[Markup]:
    """Seconds of a run left out, of the joints that are hardest to foretell."""
    shown, most = story["shown"], 3
    time, lines = np.array(shown["time"]), {n: np.array(shown[n]) for n in ("command", "measured", "foretold")}
    starts = np.flatnonzero(np.diff(np.floor(time / shown["ahead"] + SAME_INSTANT), prepend=-1.0) > 0)
    moving = [k for k in np.argsort(errors)[::-1].tolist() if math.isfinite(errors[k])]
    figures = []
    for k in moving[:most]:
        own = {n: each[:, k] for n, each in lines.items()}
        plot = Plot(
            (0.0, float(time[-1])),
            span(np.concatenate(list(own.values())).tolist()),
            "s",
            story["unit"],
            width=860,
            height=210,
        )
        plot.curve(time, own["command"], FAINT, dashed=True)
        plot.curve(time, own["measured"], INK)
        for first, last in pairwise([*starts.tolist(), len(time)]):
            plot.curve(time[first:last], own["foretold"][first:last], AFTER)
            plot.dot((float(time[first]), float(own["foretold"][first])), AFTER, size=3.0)
        figures += [
            tag("h4", story["joints"][k]),
            plot.svg(f"{story['joints'][k]}: measured, and foretold for a second on"),
        ]
    several = len(story["recordings"]) > 1  # of one alone stretches are left out
    left_out, without = ("a run left out", "it") if several else ("a stretch left out", "this stretch")
    words = (
        f"{shown['run']}, foretold without {without}: begun anew at each dot, and gone on from what was foretold for a "
        "second (the joints that are hardest to foretell)."
    )
    colours = key(("ink", "measured"), ("after", "foretold"), ("faint", "commanded"))
    return [tag("h3", f"A second on, in {left_out}"), caption(words), colours, *figures] if figures else []


def _inputs(story: Story) -> Markup:
    others = "".join(f", {name} ({', '.join(labels)})" for name, labels in story["others"].items())
    frames = f"{counted(story['history'], 'frame')} of {1e3 * story['period']:.3g} ms"
    words = f"{frames} of joints and commands{others}; view: {story['view']}."
    rows = [row(t["inputs"], cells(f"{t['error']:.3g}")) for t in story["tried"]]
    limits = [row(b["block"], cells(f"{b['limit']:.3g}", str(b["frames"]))) for b in story["domain"]]
    notes = [callout("warn", "Mind", f"{note}.") for note in story["notes"]]
    return join(
        [tag("p", words), *notes, table(head("tried", "a second on", numbers=(1,)), rows),
         caption("Errors on whole runs left out, in spreads of the joints. More goes in where it surely pays."),
         table(head("asked", "far from, deviations", "frames in a row", numbers=(1, 2)), limits),
         caption("Where it may be asked: farther off for longer, a run is refused: one in a hundred of those recorded.")]
    )  # fmt: skip


def _details(story: Story) -> Markup:
    told = {
        "command": tag("code", story["command"]), "learned from": ", ".join(story["recordings"]),
        "CPU time": f"{story['seconds']:.0f} s",
    }  # fmt: skip
    return context_table(told)


def _percent(score: Mapping[str, Any] | None, measure: str) -> str:
    moving = [] if score is None else [x for x in score[measure] if math.isfinite(x)]
    return f"{100 * sum(moving) / len(moving):.2f}" if moving else ""
