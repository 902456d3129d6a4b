# SPDX-License-Identifier: Apache-2.0
"""A still picture of a predicted drive: the way from above, and beneath it how far predictions stray in place and heading."""

from __future__ import annotations

import numpy as np

from trueup.arrays import Array
from trueup.calibration import Replay
from trueup.report.drawing import EDGE, FOOT, HEAD, LINE, SAMPLES, WIDTH, Box, document, ruler, stroke, title, words
from trueup.report.marks import nice_marks
from trueup.report.markup import Markup, join, tag
from trueup.rounding import TINY
from trueup.samples import wrapped

_NUMBERS, _STRIP = 56, 110
"""Pixels left of the error's axes, for numbers; of one error over time, with its title."""
_HIGHEST, _LOWEST = 560, 160
"""Pixels of the map, whatever the shape of the way."""


def drive_picture(position: Replay, heading: Replay, *, compared: bool = False) -> str:
    """An SVG of one drive: position (x, y in m) and heading (rad) as predicted anew every few seconds.

    `compared`: `before` of both is another car's prediction, drawn too.
    """
    thin = slice(None, None, max(1, len(position.time) // SAMPLES))
    time, seen, mine, other = (a[thin] for a in (position.time, position.measured, position.after, position.before))
    ways = [*([("before", other)] if compared else []), ("after", mine)]
    drawn, height = _view(seen, [(colour, _cut(p, seen)) for colour, p in ways])
    off = [(colour, np.linalg.norm(p - seen, axis=1)) for colour, p in ways]
    turned = [*([("before", heading.before)] if compared else []), ("after", heading.after)]
    aside = [(c, np.degrees(np.abs(wrapped(a[thin, 0] - heading.measured[thin, 0])))) for c, a in turned]
    top = HEAD + height + FOOT
    key = "grey: tracked; blue: predicted" + ("; orange: predicted by the other car" if compared else "")
    parts = [
        title(f"{position.recording}, predicted anew every few seconds"),
        words(key, WIDTH - EDGE, 22, anchor="end", colour="soft"), drawn,
        _strip("position, m off", time, off, top, last=False),
        _strip("heading, deg off", time, aside, top + _STRIP, last=True),
    ]  # fmt: skip
    return document(parts, top + 2 * _STRIP + FOOT, f"Predicted drive {position.recording}")


def _view(seen: Array, ways: list[tuple[str, Array]]) -> tuple[Markup, float]:
    """The way from above, to scale, y upward, and its height in pixels; predictions leave it where they run away."""
    low, high = np.nanmin(seen, axis=0), np.nanmax(seen, axis=0)
    room = (high - low).max() / 4  # by so much predictions may leave the way and still be seen
    low = np.fmax(np.fmin.reduce([low, *(np.nanmin(p, axis=0) for _, p in ways)]), low - room)
    high = np.fmin(np.fmax.reduce([high, *(np.nanmax(p, axis=0) for _, p in ways)]), high + room)
    size = np.maximum(high - low, TINY)
    scale = float(min((WIDTH - 2 * _NUMBERS) / size[0], (_HIGHEST - HEAD) / size[1]))
    height = max(_LOWEST, scale * float(size[1]) + HEAD)
    left, bottom = (WIDTH - scale * float(size[0])) / 2, HEAD + height - HEAD / 2
    tracked, *predicted = (
        stroke(left + (p[:, 0] - low[0]) * scale, bottom - (p[:, 1] - low[1]) * scale, colour, width=width)
        for colour, p, width in (("measured", seen, 2 * LINE), *((c, p, LINE) for c, p in ways))
    )
    pale = tag("g", tracked, opacity="0.35")
    frame = Box(0, WIDTH, HEAD - EDGE, HEAD + height, 0.0, 1.0, 0.0, 1.0)
    below = ruler(_NUMBERS, HEAD + height + 8, scale, float(size.max()), 4)
    return join(frame.clipped("map", pale, *predicted), below), height


def _cut(predicted: Array, seen: Array) -> Array:
    """The prediction with a gap before each new one, which takes it back to where the car was."""
    step = np.linalg.norm(np.diff(seen, axis=0), axis=1)
    rounding = float(np.finfo(np.float32).eps)  # m: a car that stands does not jump
    back = np.linalg.norm(np.diff(predicted - seen, axis=0), axis=1) > max(2.0 * float(np.nanmedian(step)), rounding)
    return np.where(np.concatenate([[False], back])[:, None], np.nan, predicted)


def _strip(name: str, time: Array, lines: list[tuple[str, Array]], top: float, *, last: bool) -> Markup:
    """Errors (T,) over time from zero up."""
    highest = max(float(np.nanmax(e, initial=0.0)) for _, e in lines) or 1.0
    box = Box(_NUMBERS, WIDTH - EDGE, top + 20, top + _STRIP - 18, float(time[0]), float(time[-1]), 0.0, highest)
    curves = [box.curve(time, e, colour, width=LINE) for colour, e in lines]
    return tag("g", words(name, box.left, top + 10, bold=True), *box.rows(nice_marks(0.0, highest, 3)), *curves,
               *(box.seconds() if last else []))  # fmt: skip
