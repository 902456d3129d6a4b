# SPDX-License-Identifier: Apache-2.0
"""One panel of a still picture: a joint's replay and beneath it the error, as SVG."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueup.calibration import Array, Replay
from trueup.report.encoding import kept_samples
from trueup.report.marks import mark_texts, nice_marks
from trueup.report.markup import Markup, join, tag
from trueup.report.numbers import Scale, shortened, with_unit
from trueup.report.summary import column_score

COLOURS = {
    "measured": "#30363b",
    "before": "#d8690f",
    "after": "#0b67ad",
    "command": "#9aa3aa",
    "ink": "#1f2429",
    "soft": "#5c656e",
    "grid": "#e6e8e7",
    "bad": "#a3271a",
}
"""Colours that differ in lightness too, so that they survive colour blindness and grey printing."""

SAMPLES = 1600
"""Samples of a line in a picture: about four for each pixel."""


@dataclass(frozen=True)
class Panel:
    """Where a panel lies, in pixels, and whether it is at the left and lower edge of the picture."""

    x: float
    y: float
    width: float
    height: float
    first: bool
    last: bool


@dataclass(frozen=True)
class Box:
    """An axis rectangle: data (x0..x1, y0..y1) onto pixels (left..right, bottom..top)."""

    left: float
    right: float
    top: float
    bottom: float
    x0: float
    x1: float
    y0: float
    y1: float

    def x(self, values: Array) -> Array:
        """Pixels from the left of `values` on the horizontal axis."""
        return self.left + (values - self.x0) / (self.x1 - self.x0) * (self.right - self.left)

    def y(self, values: Array) -> Array:
        """Pixels from the top of `values` on the vertical axis, a hundred box heights away at most."""
        part = np.clip((values - self.y0) / (self.y1 - self.y0), -100.0, 101.0)
        return self.bottom - part * (self.bottom - self.top)


def replay_panel(
    replay: Replay, column: int, panel: Panel, scale: Scale, window: tuple[float | None, float | None]
) -> Markup:
    """The SVG group of one column of `replay`, within `window` (s, None: open)."""
    start = replay.time[0] if window[0] is None else window[0]
    stop = replay.time[-1] if window[1] is None else window[1]
    inside = (replay.time >= start) & (replay.time <= stop)
    lines = {"measured": replay.measured[inside, column], "before": replay.before[inside, column]}
    lines["after"] = replay.after[inside, column]
    if replay.command is not None:
        lines = {"command": replay.command[inside, column], **lines}
    time = replay.time[inside]
    errors = {k: (lines[k] - lines["measured"]) * scale.factor for k in ("before", "after")}
    kept = kept_samples([lines["measured"], errors["before"], errors["after"]], SAMPLES)
    upper, lower = _boxes(panel, float(start), float(stop), lines, errors)
    score = column_score(replay, column)
    amounts = f"{scale.text(score.before)} → {with_unit(scale.text(score.after), scale.unit)}"
    parts = [
        *_frame(upper, replay.unit if panel.first else "", nice_marks(upper.y0, upper.y1, 4), with_time=False),
        *_frame(lower, f"error, {scale.unit}" if panel.first else "", _either_side(lower.y1), with_time=panel.last),
        _clipped(upper, f"value-{column}", [_curve(time[kept], v[kept], upper, name) for name, v in lines.items()]),
        _clipped(lower, f"error-{column}", [_curve(time[kept], v[kept], lower, name) for name, v in errors.items()]),
        tag(
            "text",
            shortened(replay.labels[column], 30 if panel.width < 500 else 60),
            x=upper.left,
            y=upper.top - 7,
            font_weight="600",
        ),
        tag("text", amounts, x=upper.right, y=upper.top - 7, text_anchor="end", fill=COLOURS["soft"]),
    ]
    return tag("g", parts)


def _boxes(
    panel: Panel, start: float, stop: float, lines: dict[str, Array], errors: dict[str, Array]
) -> tuple[Box, Box]:
    left, right = panel.x + 64, panel.x + panel.width - 14
    top, split, gap = panel.y + 22, panel.y + 126, 14
    bottom = panel.y + panel.height - 32
    stop = stop if stop > start else start + 1.0
    upper = Box(
        left, right, top, split, start, stop, *_range([lines[k] for k in lines if k != "before"], lines["before"])
    )
    low, high = _range([errors["after"]], errors["before"], spare=15.0)
    size = max(abs(low), abs(high))
    return upper, Box(left, right, split + gap, bottom, start, stop, -size, size)


def _range(main: Sequence[Array], other: Array, spare: float = 0.5) -> tuple[float, float]:
    """The range of `main`, widened for `other` by at most `spare` of itself on each side: it may have run away."""
    values = np.concatenate(main)
    values = values[np.isfinite(values)]
    if values.size == 0:
        return -1.0, 1.0
    low, high = float(values.min()), float(values.max())
    size = (high - low) or abs(high) * 0.1 or 1.0
    other = other[np.isfinite(other)]
    if other.size:
        low, high = (
            max(min(low, float(other.min())), low - spare * size),
            min(max(high, float(other.max())), high + spare * size),
        )
    margin = 0.06 * ((high - low) or size)
    return low - margin, high + margin


def _either_side(size: float) -> list[float]:
    """-m, 0, m with the largest m of the form 1, 2 or 5 x 10^n that fits below `size`."""
    magnitude = 10.0 ** math.floor(math.log10(0.9 * size))
    mark = max(f * magnitude for f in (1.0, 2.0, 5.0) if f * magnitude <= 0.9 * size)
    return [-mark, 0.0, mark]


def _clipped(box: Box, key: str, curves: Sequence[Markup]) -> Markup:
    """The curves inside the box only: what ran away leaves it instead of lying flat along its edge."""
    frame = tag("rect", x=box.left, y=box.top, width=box.right - box.left, height=box.bottom - box.top)
    return join(tag("clipPath", frame, id=key), tag("g", curves, clip_path=f"url(#{key})"))


def _frame(box: Box, title: str, marks: Sequence[float], *, with_time: bool) -> list[Markup]:
    parts = [
        tag("line", x1=box.left, x2=box.right, y1=box.bottom, y2=box.bottom, stroke=COLOURS["command"]),
    ]
    for mark, text in zip(marks, mark_texts(marks), strict=True):
        y = float(box.y(np.array([mark]))[0])
        parts.append(tag("line", x1=box.left, x2=box.right, y1=y, y2=y, stroke=COLOURS["grid"]))
        parts.append(
            tag("text", text, x=box.left - 6, y=y + 4, text_anchor="end", fill=COLOURS["soft"], font_size="11.5")
        )
    if title:
        x, y = box.left - 46, (box.top + box.bottom) / 2
        turned = f"rotate(-90 {x:.1f} {y:.1f})"
        parts.append(tag("text", title, x=x, y=y, text_anchor="middle", transform=turned, fill=COLOURS["soft"]))
    if with_time:
        times = nice_marks(box.x0, box.x1, 7)
        for mark, text in zip(times, mark_texts(times), strict=True):
            x = float(box.x(np.array([mark]))[0])
            last = text + " s" if mark == times[-1] else text
            parts.append(tag("text", last, x=x, y=box.bottom + 16, text_anchor="middle", fill=COLOURS["soft"]))
    return parts


def _curve(time: Array, values: Array, box: Box, name: str) -> Markup:
    x, y = box.x(time), box.y(values)
    pieces, pen_down = [], False
    for px, py in zip(x, y, strict=True):
        if not math.isfinite(py):
            pen_down = False
            continue
        pieces.append(f"{'L' if pen_down else 'M'}{px:.1f} {py:.1f}")
        pen_down = True
    width, dash = (1.0, "4 3") if name == "command" else (1.6, None) if name == "measured" else (1.3, None)
    return tag(
        "path",
        d="".join(pieces) or "M0 0",
        fill="none",
        stroke=COLOURS[name],
        stroke_width=width,
        stroke_dasharray=dash,
        stroke_linejoin="round",
    )
