# SPDX-License-Identifier: Apache-2.0
"""A still picture of a planned trajectory: the tool's path from above and from the side, and each joint's profile."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from trueup.report.marks import mark_texts, nice_marks
from trueup.report.markup import Markup, tag
from trueup.report.panel import COLOURS

Array = NDArray[np.float64]

_WIDTH, _ROW, _SIDE = 900, 92.0, 300.0
_MOST = 1200


def trajectory_picture(
    title: str, joints: Sequence[str], time: Array, q: Array, qd: Array, speed: Array, path: Array,
    box: tuple[Array, Array] | None = None,
) -> str:  # fmt: skip
    """An SVG of time (S,) [s], q, qd (S, n), speed limits (n,), tool positions (S, 3) [m], and a region (lower, upper)."""
    keep = np.unique(np.linspace(0, len(time) - 1, min(_MOST, len(time))).astype(int))
    time, q, qd, path = time[keep], q[keep], qd[keep], path[keep]
    height = max(44.0 + _ROW * len(joints) + 40.0, 44.0 + 2 * (_SIDE + 10.0))
    parts = [_text(title, 14, 24, weight="600", size=14)]
    for k, (name, axes) in enumerate((("from above", (0, 1)), ("from the side", (0, 2)))):
        parts.append(_view(name, axes, path, box, 44.0 + k * (_SIDE + 10.0)))
    for j, joint in enumerate(joints):
        last = j + 1 == len(joints)
        parts.append(_profile(joint, time, q[:, j], qd[:, j] / speed[j], 44.0 + _ROW * j, last=last))
    ground = tag("rect", width=_WIDTH, height=height, fill="#ffffff")
    opening = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {height:.0f}" width="{_WIDTH}" '
        f'height="{height:.0f}" font-family="system-ui, sans-serif" font-size="12" fill="{COLOURS["ink"]}" role="img">'
    )
    return "\n".join(
        ['<?xml version="1.0" encoding="UTF-8"?>', opening, tag("title", title), ground, *parts, "</svg>", ""]
    )


def _view(name: str, axes: tuple[int, int], path: Array, box: tuple[Array, Array] | None, top: float) -> Markup:
    """The path in two coordinates, to scale, with the base and the region."""
    a, b = axes
    points = np.concatenate([path[:, axes], np.zeros((1, 2)), *([] if box is None else [e[None, axes] for e in box])])
    low, high = points.min(axis=0), points.max(axis=0)
    scale = (_SIDE - 70.0) / max(float((high - low).max()), 1e-3)
    left, bottom = 40.0, top + _SIDE - 30.0
    x = left + (path[:, a] - low[0]) * scale
    y = bottom - (path[:, b] - low[1]) * scale
    base = (left - low[0] * scale, bottom + low[1] * scale)
    parts = [tag("path", d=_line(x, y), fill="none", stroke=COLOURS["after"], stroke_width=1.2)]
    parts.append(tag("rect", x=base[0] - 4, y=base[1] - 4, width=8, height=8, fill=COLOURS["measured"]))
    parts.append(tag("circle", cx=float(x[0]), cy=float(y[0]), r=4, fill=COLOURS["before"]))
    if box is not None:
        size = (box[1] - box[0])[list(axes)] * scale
        corner = (left + (box[0][a] - low[0]) * scale, bottom - (box[1][b] - low[1]) * scale)
        parts.append(tag("rect", x=corner[0], y=corner[1], width=float(size[0]), height=float(size[1]), fill="none",
                         stroke=COLOURS["command"], stroke_dasharray="4 3"))  # fmt: skip
    names = "xyz"
    parts.append(_text(f"tool {name} ({names[a]}, {names[b]})", left, top + 12, fill=COLOURS["soft"]))
    metre = nice_marks(0.0, float((high - low).max()), 3)
    length = metre[1] if len(metre) > 1 else metre[0]
    parts.append(tag("line", x1=left, x2=left + length * scale, y1=bottom + 16, y2=bottom + 16, stroke=COLOURS["ink"]))
    parts.append(_text(f"{length:g} m", left + length * scale + 6, bottom + 20, fill=COLOURS["soft"]))
    return tag("g", parts)


def _profile(joint: str, time: Array, q: Array, share: Array, top: float, *, last: bool) -> Markup:
    """Position of a joint, and its speed as a share of the limit (-100 to 100 %)."""
    left, right, bottom = 400.0, _WIDTH - 16.0, top + _ROW - 22.0
    x = left + (time - time[0]) / (time[-1] - time[0]) * (right - left)
    low, high = float(q.min()), float(q.max())
    room = 0.08 * max(high - low, 1e-3)
    y = bottom - (q - low + room) / (high - low + 2 * room) * (bottom - top - 14)
    middle = 0.5 * (bottom + top + 14)
    v = middle - np.clip(share, -1.05, 1.05) * 0.5 * (bottom - top - 14)
    parts = [
        tag("line", x1=left, x2=right, y1=bottom, y2=bottom, stroke=COLOURS["command"]),
        tag("line", x1=left, x2=right, y1=middle, y2=middle, stroke=COLOURS["grid"]),
        tag("path", d=_line(x, v), fill="none", stroke=COLOURS["before"], stroke_width=0.9),
        tag("path", d=_line(x, y), fill="none", stroke=COLOURS["after"], stroke_width=1.5),
        _text(joint, left, top + 10, weight="600"),
        _text(f"{low:.2f} ... {high:.2f} rad, up to {100 * float(np.abs(share).max()):.0f} % of its speed", right, top + 10,
              anchor="end", fill=COLOURS["soft"]),
    ]  # fmt: skip
    if last:
        marks = nice_marks(float(time[0]), float(time[-1]), 7)
        for mark, text in zip(marks, mark_texts(marks), strict=True):
            at = left + (mark - time[0]) / (time[-1] - time[0]) * (right - left)
            shown = f"{text} s" if mark == marks[-1] else text
            parts.append(_text(shown, float(at), bottom + 14, anchor="middle", fill=COLOURS["soft"]))
        parts.append(_text("blue: position, orange: share of the speed limit", left, bottom + 30, fill=COLOURS["soft"]))
    return tag("g", parts)


def _line(x: Array, y: Array) -> str:
    return "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(x, y, strict=True))


def _text(
    text: str, x: float, y: float, *, anchor: str | None = None, weight: str | None = None, size: float | None = None,
    fill: str | None = None,
) -> Markup:  # fmt: skip
    return tag("text", text, x=x, y=y, text_anchor=anchor, font_weight=weight, font_size=size, fill=fill)
