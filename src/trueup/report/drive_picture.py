# SPDX-License-Identifier: Apache-2.0
"""A still picture of a predicted drive: the way from above, and beneath it how far predictions stray in place and heading."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trueup.calibration import Replay
from trueup.report.marks import mark_texts, nice_marks
from trueup.report.markup import Markup, tag
from trueup.report.panel import COLOURS, SAMPLES

Array = NDArray[np.float64]

_WIDTH, _EDGE, _STRIP = 900.0, 56.0, 110.0
_HIGHEST, _LOWEST = 560.0, 160.0  # of the map


def drive_picture(position: Replay, heading: Replay, *, compared: bool = False) -> str:
    """An SVG of one drive: position (x, y in m) and heading (rad) as predicted anew every few seconds.

    `compared`: `before` of both is another car's prediction, drawn too.
    """
    thin = slice(None, None, max(1, len(position.time) // SAMPLES))
    time, seen, mine, other = (a[thin] for a in (position.time, position.measured, position.after, position.before))
    lines = [("measured", seen), *([("before", other)] if compared else []), ("after", mine)]
    view, height = _view([lines[0], *((c, _cut(p, seen)) for c, p in lines[1:])])
    off = [(c, np.linalg.norm(p - seen, axis=1)) for c, p in lines[1:]]
    turned = [("after", heading.after), *([("before", heading.before)] if compared else [])]
    aside = [(c, np.degrees(np.abs(_turn(a[thin, 0] - heading.measured[thin, 0])))) for c, a in turned][::-1]
    top = 44.0 + height + 30.0
    words = "grey: tracked; blue: predicted" + ("; orange: predicted by the other car" if compared else "")
    parts = [
        _text(f"{position.recording}, predicted anew every few seconds", 14, 22, weight="600", size=14),
        _text(words, _WIDTH - 16, 22, anchor="end", fill=COLOURS["soft"]), view,
        _strip("position, m off", time, off, top, last=False),
        _strip("heading, deg off", time, aside, top + _STRIP, last=True),
    ]  # fmt: skip
    whole = top + 2 * _STRIP + 34.0
    opening = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH:.0f} {whole:.0f}" width="{_WIDTH:.0f}" '
        f'height="{whole:.0f}" font-family="system-ui, sans-serif" font-size="12" fill="{COLOURS["ink"]}" role="img">'
    )
    ground = tag("rect", width=_WIDTH, height=whole, fill="#ffffff")
    name = tag("title", f"Predicted drive {position.recording}")
    return "\n".join(['<?xml version="1.0" encoding="UTF-8"?>', opening, name, ground, *parts, "</svg>", ""])


def _view(lines: list[tuple[str, Array]]) -> tuple[Markup, float]:
    """The way from above, to scale, y upward, and its height in pixels."""
    seen = lines[0][1]
    low, high = np.nanmin(seen, axis=0), np.nanmax(seen, axis=0)
    size = np.maximum(high - low, 1e-3)
    scale = min((_WIDTH - 2 * _EDGE) / size[0], (_HIGHEST - 40.0) / size[1])
    height = max(_LOWEST, float(scale * size[1]) + 40.0)
    left = 0.5 * (_WIDTH - scale * size[0])
    room = tag("clipPath", tag("rect", x=0, y=34, width=_WIDTH, height=height + 4), id="map")
    drawn = [
        tag("path", d=_path(left + (p[:, 0] - low[0]) * scale, 44.0 + height - 20.0 - (p[:, 1] - low[1]) * scale),
            fill="none", stroke=COLOURS[colour], stroke_width=2.4 if colour == "measured" else 1.2,
            stroke_opacity=0.35 if colour == "measured" else 1.0)
        for colour, p in lines
    ]  # fmt: skip
    marks = nice_marks(0.0, float(size.max()), 4)
    length = marks[1] if len(marks) > 1 else marks[0]
    y = 44.0 + height + 8.0
    ruler = tag("line", x1=_EDGE, x2=_EDGE + length * scale, y1=y, y2=y, stroke=COLOURS["ink"], stroke_width=1.5)
    words = _text(f"{length:g} m", _EDGE + length * scale + 6, y + 4, fill=COLOURS["soft"])
    return tag("g", room, tag("g", drawn, clip_path="url(#map)"), ruler, words), height


def _cut(predicted: Array, seen: Array) -> Array:
    """The prediction with a gap before each new one, which takes it back to where the car was."""
    step = np.linalg.norm(np.diff(seen, axis=0), axis=1)
    back = np.linalg.norm(np.diff(predicted - seen, axis=0), axis=1) > 2.0 * np.nanmedian(step) + 1e-9
    return np.where(np.concatenate([[False], back])[:, None], np.nan, predicted)


def _strip(title: str, time: Array, lines: list[tuple[str, Array]], top: float, *, last: bool) -> Markup:
    """Errors (T,) over time from zero up."""
    left, right, bottom, ceiling = _EDGE, _WIDTH - 16.0, top + _STRIP - 18.0, top + 20.0
    highest = max(*(float(np.nanmax(e, initial=0.0)) for _, e in lines), 1e-6)
    x = left + (time - time[0]) / max(float(time[-1] - time[0]), 1e-9) * (right - left)
    parts = [_text(title, left, top + 10, weight="600")]
    marks = nice_marks(0.0, highest, 3)
    for mark, text in zip(marks, mark_texts(marks), strict=True):
        y = bottom - mark / highest * (bottom - ceiling)
        parts.append(tag("line", x1=left, x2=right, y1=y, y2=y, stroke=COLOURS["grid"]))
        parts.append(_text(text, left - 6, y + 4, anchor="end", fill=COLOURS["soft"]))
    for colour, e in lines:
        line = _path(x, bottom - e / highest * (bottom - ceiling))
        parts.append(tag("path", d=line, fill="none", stroke=COLOURS[colour], stroke_width=1.1))
    if last:
        marks = nice_marks(float(time[0]), float(time[-1]), 7)
        for mark, text in zip(marks, mark_texts(marks), strict=True):
            at = left + (mark - float(time[0])) / max(float(time[-1] - time[0]), 1e-9) * (right - left)
            shown = f"{text} s" if mark == marks[-1] else text
            parts.append(_text(shown, at, bottom + 16, anchor="middle", fill=COLOURS["soft"]))
    return tag("g", parts)


def _turn(angle: Array) -> Array:
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def _path(x: Array, y: Array) -> str:
    """A line with gaps where nothing is known."""
    down, pieces = False, []
    for a, b in zip(x.tolist(), y.tolist(), strict=True):
        if not (np.isfinite(a) and np.isfinite(b)):
            down = False
            continue
        pieces.append(f"{'L' if down else 'M'}{a:.1f} {b:.1f}")
        down = True
    return "".join(pieces) or "M0 0"


def _text(
    text: str, x: float, y: float, *, anchor: str | None = None, weight: str | None = None, size: float | None = None,
    fill: str | None = None,
) -> Markup:  # fmt: skip
    return tag("text", text, x=x, y=y, text_anchor=anchor, font_weight=weight, font_size=size, fill=fill)
