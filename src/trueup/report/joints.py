# SPDX-License-Identifier: Apache-2.0
"""Second section: which joint, when, and why not yet?"""

from __future__ import annotations

import math

from trueup.calibration import Calibration, Replay
from trueup.report.figures import error_scale
from trueup.report.hints import Hint, hints
from trueup.report.markup import Markup, breakable, join, tag
from trueup.report.numbers import Scale, fixed, ratio_text
from trueup.report.parts import caption, drawn_later, empty, figure, group_row, table
from trueup.report.summary import (
    Comparison,
    Score,
    amounts,
    column_score,
    comparisons,
    label_score,
    noise_of,
    pooled_score,
)


def joints(calibration: Calibration) -> Markup:
    """A heat table for each channel, the interactive figures, and what is left of each joint's error."""
    groups = comparisons(calibration)
    if not groups:
        return empty("Nothing was replayed.")
    starts = [sum(len(g.replays) for g in groups[:i]) for i in range(len(groups))]  # as figure_data counts them
    several = len(groups) > 1
    return join(
        tag("h3", "Error after calibration, by recording and joint"),
        [_titled(g, heat_table(g, first=first), several) for g, first in zip(groups, starts, strict=True)],
        _figures(),
        tag("h3", "What is left, joint by joint"),
        [_titled(g, _leftovers(g, first), several) for g, first in zip(groups, starts, strict=True)],
        _small_figures(),
    )


def heat_table(group: Comparison, *, first: int = 0) -> Markup:
    """RMSE after, by recording and label, tinted by size; a press shows that replay. `first` numbers the replays."""
    scale, labels = error_scale(group), group.labels
    scores = [[_cell_score(r, label) for label in labels] for r in group.ordered]
    finite = [s.after for row in scores for s in row if s is not None and math.isfinite(s.after)]
    largest = max(finite, default=0.0)
    titles = tag(
        "tr", tag("th", "Recording", scope="col", class_="name"), (_label(label) for label in (*labels, "all"))
    )
    rows: list[Markup] = []
    for index, (replay, row) in enumerate(zip(group.ordered, scores, strict=True)):
        if index in (0, len(group.held_out)) and group.held_out:
            title = "Held out" if index == 0 else "Fitted"
            rows.append(group_row(title, len(labels) + 2))
        cells = [_cell(s, scale, largest, first + index, replay, label) for s, label in zip(row, labels, strict=True)]
        whole = _cell(pooled_score([replay]), scale, largest, first + index, replay, None)
        name = tag("th", replay.recording, scope="row", class_="name", title=replay.recording)
        rows.append(tag("tr", name, cells, whole))
    rows += _noise_row(group, scale)
    text = (
        f"Root mean square error of '{group.channel}' after calibration in {scale.unit or 'its own unit'}; beneath it "
        "the ratio to the error before, marked ▲ where it got worse. Choose a cell to see that replay below."
    )
    columns = len(labels) + 1
    width = f"min-width:{180 + 76 * columns}px;max-width:{180 + 160 * columns}px"
    return join(table(titles, rows, "heat", style=width), caption(text))


def _cell_score(replay: Replay, label: str) -> Score | None:
    return column_score(replay, replay.labels.index(label)) if label in replay.labels else None


def _label(label: str) -> Markup:
    return tag("th", tag("span", breakable(label)), scope="col", title=label, class_="number")


def _cell(score: Score | None, scale: Scale, largest: float, index: int, replay: Replay, label: str | None) -> Markup:
    if score is None:
        return tag("td", "–", class_="number absent")
    part = score.after / largest if largest > 0 and math.isfinite(score.after) else 0.0
    strength = 100 * min(part, 1.0)
    ratio = ratio_text(score.after, score.before)
    content = join(
        tag("span", scale.text(score.after), class_="value"),
        tag("small", f"▲ {ratio}" if score.worse else ratio, class_="worse" if score.worse else None)
        if score.compared
        else "",
    )
    if label is None:
        return tag("td", tag("div", content), class_="number whole")
    button = tag(
        "button",
        content,
        type="button",
        data_replay=str(index),
        data_column=str(replay.labels.index(label)),
        title=f"{replay.recording}, {label}: {amounts(score, scale)}",
    )
    return tag("td", button, class_="number cell", style=f"--heat:{strength:.0f}%")


def _noise_row(group: Comparison, scale: Scale) -> list[Markup]:
    noise = [label_score(group.replays, label).noise for label in group.labels]
    if not any(math.isfinite(n) for n in noise):
        return []
    whole = pooled_score([r for r in group.replays if not any(map(math.isnan, noise_of(r)))]).noise
    cells = [tag("td", scale.text(n, 2), class_="number") for n in (*noise, whole)]
    return [tag("tr", tag("th", "measurement noise", scope="row"), cells, class_="noise")]


def _titled(group: Comparison, body: Markup, several: bool) -> Markup:
    return join(tag("h4", group.title), body) if several else body


def _leftovers(group: Comparison, first: int) -> Markup:
    scale = error_scale(group)
    judged = group.held_out or group.training
    found = hints(judged, scale)
    if not found:
        return empty("No error could be computed.")
    titles = tag(
        "tr",
        tag("th", "Joint"),
        tag("th", "Error after", tag("small", scale.unit), class_="number"),
        tag("th", "What it looks like"),
        tag("th", "Largest", class_="where"),
    )
    number = {r.recording: first + i for i, r in enumerate(group.ordered)}
    rows = [_leftover(hint, scale, number[hint.recording]) for hint in found]
    which = "the held-out recordings" if group.held_out else "the fitted recordings"
    text = (
        f"Patterns in the error of {which}. They are hints to look for a missing effect, not proofs: "
        "several can look alike in one motion."
    )
    return join(table(titles, rows, "leftovers"), caption(text))


def _leftover(hint: Hint, scale: Scale, index: int) -> Markup:
    moment = f"{fixed(hint.start, 1)} to {fixed(hint.stop, 1)} s"
    where = join(tag("span", hint.recording, title=hint.recording), tag("small", moment))
    return tag(
        "tr",
        tag("th", hint.label, scope="row", class_="name", title=hint.label),
        tag("td", scale.text(hint.score.after), class_="number"),
        tag("td", hint.sentence),
        tag("td", tag("button", where, type="button", class_="link", data_moment=str(index), data_label=hint.label)),
    )


def _figures() -> Markup:
    choose = tag(
        "div",
        tag("label", tag("span", "Recording"), tag("select", id="recording")),
        tag("div", id="labels", class_="segments", role="group", aria_label="Joint"),
        class_="controls",
    )
    zoom = tag(
        "div",
        tag("button", "Worst moment", type="button", id="worst"),
        tag("button", "Whole recording", type="button", id="whole"),
        class_="zoom",
    )
    return tag(
        "div",
        tag("h3", "Replay against the recording"),
        choose,
        tag("div", tag("p", id="replay-title", aria_live="polite"), zoom, class_="figure-title controls"),
        drawn_later("replay", "figure tall"),
        tag("p", id="replay-caption", class_="caption"),
        tag(
            "noscript",
            tag("p", "The figures are drawn by JavaScript inside this file, which this viewer does not run."),
        ),
        id="replay",
    )


def _small_figures() -> Markup:
    chosen = tag("small", class_="chosen")
    frequency = "Amplitude density of the error (Welch). At the dotted line only noise is left."
    speed = "Mean error at each measured speed. A step at zero is friction or backlash, a slope delay or damping."
    return tag(
        "div",
        figure(join("Error by frequency ", chosen), drawn_later("spectrum"), note=frequency),
        figure(join("Error by speed ", chosen), drawn_later("speed"), note=speed),
        class_="pair",
    )
