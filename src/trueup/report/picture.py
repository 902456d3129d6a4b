# SPDX-License-Identifier: Apache-2.0
"""Still pictures for a paper, a README or a slide: SVG files that need no script, no style sheet and no fonts."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from trueup.calibration import Calibration, Replay
from trueup.errors import unknown_name
from trueup.formats.aside import write_aside
from trueup.report.drawing import COLOURS, EDGE, HEAD, LINE, WIDTH, document, line, title, words
from trueup.report.dumbbell import Axis
from trueup.report.figures import error_scale
from trueup.report.markup import Markup, tag
from trueup.report.numbers import Scale, ratio_text, scale_for, shortened
from trueup.report.panel import Panel, replay_panel
from trueup.report.summary import Comparison, Score, amounts, column_score, comparisons, pooled_score

_NAMES, _AMOUNTS, _ROW = 220, 210, 26
"""Pixels of a row of the comparison: for names on its left and amounts on its right; its height."""


def write_pictures(calibration: Calibration, folder: str | os.PathLike[str]) -> list[Path]:
    """Write `before-after.svg` and `replay-NAME.svg` for each held-out recording (each recording if there is none).

    Raises:
        OutputError: a file cannot be written; older ones are untouched.
    """
    groups = comparisons(calibration)
    if not groups:
        return []
    folder = Path(folder)
    pictures = {"before-after": before_after_picture(calibration)}
    for replay in groups[0].held_out or groups[0].training:
        name = "replay-" + (re.sub(r"[^A-Za-z0-9._-]+", "-", replay.recording).strip("-.") or "recording")[:80]
        while name in pictures:
            name += "-2"
        pictures[name] = replay_picture(replay)
    for name, text in pictures.items():
        write_aside(text, folder / f"{name}.svg")
    return [folder / f"{name}.svg" for name in pictures]


def replay_picture(
    replay: Replay,
    *,
    labels: Sequence[str] | None = None,
    start: float | None = None,
    stop: float | None = None,
    names: Mapping[str, str] | None = None,
) -> str:
    """An SVG with a panel for each of `labels` (default: all): the recording, the replays, and the error beneath.

    `start` and `stop` cut the time in s on the recording's clock. `names`: what 'before' and 'after' are called where no
    calibration lies between them.

    Raises:
        UnknownNameError: a label that the replay does not have.
    """
    chosen = replay.labels if labels is None else tuple(labels)
    for label in chosen:
        if label not in replay.labels:
            raise unknown_name("label", label, replay.labels, f"the replay of '{replay.recording}'")
    scale = scale_for(replay.unit, [column_score(replay, j).after for j in range(len(replay.labels))])
    across = 1 if len(chosen) < 3 else 2
    width, height, top = WIDTH / across, 230, HEAD
    rows = math.ceil(len(chosen) / across)
    parts = [_key(replay, names or {}, with_command=replay.command is not None)]
    for index, label in enumerate(chosen):
        corner = (width * (index % across), top + height * (index // across))
        panel = Panel(*corner, width, height, first=index % across == 0, last=index + across >= len(chosen))
        parts.append(replay_panel(replay, replay.labels.index(label), panel, scale, (start, stop)))
    kind = "held out" if replay.held_out else "fitted"
    return document(parts, top + rows * height + 8, f"Replay of {replay.recording} ({kind})")


def before_after_picture(calibration: Calibration) -> str:
    """An SVG with a line for each recording: replay error before and after, held-out recordings first.

    It shows the main channel. An empty picture says so where nothing was replayed.
    """
    groups = comparisons(calibration)
    if not groups:
        return document([words("Nothing was replayed.", 16, 30)], 50, "Nothing was replayed")
    return _before_after(groups[0], error_scale(groups[0]))


def _before_after(group: Comparison, scale: Scale) -> str:
    scores = {id(r): pooled_score([r]) for r in group.replays}
    axis = Axis.over(scores.values(), scale)
    left, right, row, y = _NAMES, WIDTH - _AMOUNTS, _ROW, 20

    def place(value: float) -> float:
        return left + (right - left) * axis.percent(value) / 100.0

    parts, top = [], y + 6
    for name, replays in (("Held out", group.held_out), ("Fitted", group.training)):
        if not replays:
            continue
        y += row
        parts.append(words(name, EDGE, y, bold=True, colour="soft"))
        for replay in replays:
            y += row
            parts += _before_after_row(replay, scores[id(replay)], scale, y, place)
        y += 6
    bottom = y + 8
    marks = [(place(m), text) for m, text in zip(axis.marks(), axis.mark_texts(), strict=True)]
    grid = [line(x, top, x, bottom, "grid") for x, _ in marks]
    texts = [words(text, x, bottom + 16, anchor="middle", colour="soft") for x, text in marks]
    unit = f" in {scale.unit}" if scale.unit else ""
    below = words(f"Root mean square replay error{unit}", (left + right) / 2, bottom + 36, anchor="middle")
    key = [_key_dot("before", left), _key_dot("after", left + 90)]
    return document([*grid, *parts, *texts, below, *key], bottom + 50, "Replay error before and after calibration")


def _before_after_row(
    replay: Replay, score: Score, scale: Scale, y: float, place: Callable[[float], float]
) -> list[Markup]:
    middle = y - 4
    parts = [words(shortened(replay.recording, 26), 2 * EDGE, y)]
    ends = {"before": score.before * scale.factor, "after": score.after * scale.factor}
    shown = {kind: place(v) for kind, v in ends.items() if math.isfinite(v)}
    if len(shown) == 2:
        parts.append(line(shown["before"], middle, shown["after"], middle, "command", width=2 * LINE))
    parts += [tag("circle", cx=x, cy=middle, r=5, fill=COLOURS[kind]) for kind, x in shown.items()]
    parts.append(words(amounts(score, scale), WIDTH - 66, y, anchor="end"))
    ratio = ratio_text(score.after, score.before)
    parts.append(words(ratio, WIDTH - EDGE, y, anchor="end", bold=True, colour="bad" if score.worse else "ink"))
    return parts


def _key(replay: Replay, names: Mapping[str, str], *, with_command: bool) -> Markup:
    kind = "" if names else " (held out)" if replay.held_out else " (fitted)"
    parts = [title(f"{shortened(replay.recording, 36)}{kind}")]
    x = WIDTH - EDGE
    known = ("before",) if np.isfinite(replay.before).any() else ()
    for name in ("after", *known, "measured") + (("command",) if with_command else ()):
        called = shortened(names.get(name, name), 20)
        parts.append(words(called, x, 24, anchor="end"))
        x -= 9 * len(called) + 5
        dash = "4 3" if name == "command" else None
        parts.append(line(x - 22, 20, x, 20, name, width=LINE if dash else 2 * LINE, dash=dash))
        x -= 38
    return tag("g", parts)


def _key_dot(kind: str, x: float) -> Markup:
    return tag("g", tag("circle", cx=x + 5, cy=14, r=5, fill=COLOURS[kind]), words(kind, x + 16, 18))
