# SPDX-License-Identifier: Apache-2.0
"""A still picture of a planned trajectory: the tool's path from above and from the side, and each joint's profile."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueup.arrays import Array
from trueup.report.drawing import (
    COLOURS,
    EDGE,
    FOOT,
    HEAD,
    LINE,
    SAMPLES,
    WIDTH,
    Box,
    document,
    line,
    ruler,
    stroke,
    title,
    words,
)
from trueup.report.markup import Markup, tag

_ROW, _SIDE = 92, 300
"""Pixels of a joint's profile with its title, and of a view of the path."""
_LEFT, _PROFILE = 40, 400
"""Pixels from the left to the views and to the profiles."""


def trajectory_picture(
    name: str, joints: Sequence[str], time: Array, q: Array, qd: Array, speed: Array, path: Array,
    box: tuple[Array, Array] | None = None,
) -> str:  # fmt: skip
    """An SVG of time (S,) [s], q, qd (S, n), speed limits (n,), tool positions (S, 3) [m], and a region (lower, upper)."""
    keep = np.unique(np.linspace(0, len(time) - 1, min(SAMPLES, len(time))).astype(int))
    time, q, qd, path = time[keep], q[keep], qd[keep], path[keep]
    height = HEAD + max(_ROW * len(joints) + FOOT, 2 * (_SIDE + EDGE))
    parts = [title(name)]
    for k, (view, axes) in enumerate((("from above", (0, 1)), ("from the side", (0, 2)))):
        parts.append(_view(view, axes, path, box, HEAD + k * (_SIDE + EDGE)))
    for j, joint in enumerate(joints):
        last = j + 1 == len(joints)
        parts.append(_profile(joint, time, q[:, j], qd[:, j] / speed[j], HEAD + _ROW * j, last=last))
    return document(parts, height, name)


def _view(name: str, axes: tuple[int, int], path: Array, box: tuple[Array, Array] | None, top: float) -> Markup:
    """The path in two coordinates, to scale, with the base and the region."""
    a, b = axes
    points = np.concatenate([path[:, axes], np.zeros((1, 2)), *([] if box is None else [e[None, axes] for e in box])])
    low, size = points.min(axis=0), float(np.ptp(points, axis=0).max()) or 1.0
    scale, bottom = (_SIDE - HEAD - FOOT) / size, top + _SIDE - FOOT

    def place(at: Array) -> tuple[Array, Array]:
        return _LEFT + (at[..., a] - low[0]) * scale, bottom - (at[..., b] - low[1]) * scale

    base, start = (tuple(float(v) for v in place(p)) for p in (np.zeros(3), path[0]))
    parts = [
        stroke(*place(path), "after"),
        tag("rect", x=base[0] - 4, y=base[1] - 4, width=8, height=8, fill=COLOURS["measured"]),
        tag("circle", cx=start[0], cy=start[1], r=4, fill=COLOURS["before"]),
    ]
    if box is not None:
        (x0, x1), (y1, y0) = (tuple(float(v) for v in ends) for ends in zip(*map(place, box), strict=True))
        parts.append(tag("rect", x=x0, y=y0, width=x1 - x0, height=y1 - y0, fill="none", stroke=COLOURS["command"],
                         stroke_dasharray="4 3"))  # fmt: skip
    parts.append(words(f"tool {name} ({'xyz'[a]}, {'xyz'[b]})", _LEFT, top + 12, colour="soft"))
    return tag("g", *parts, ruler(_LEFT, bottom + 16, scale, size, 3))


def _profile(joint: str, time: Array, q: Array, share: Array, top: float, *, last: bool) -> Markup:
    """Position of a joint, and its speed as a share of the limit (-100 to 100 %)."""
    low, high = float(q.min()), float(q.max())
    margin = (high - low) / 12 or 1.0
    frame = (_PROFILE, WIDTH - EDGE, top + EDGE, top + _ROW - 22, float(time[0]), float(time[-1]))
    box, speeds = Box(*frame, low - margin, high + margin), Box(*frame, -1.0, 1.0)
    middle = (box.top + box.bottom) / 2
    reach = f"{low:.2f} ... {high:.2f} rad, up to {100 * float(np.abs(share).max()):.0f} % of its speed"
    key = words("blue: position, orange: share of the speed limit", box.left, box.bottom + 30, colour="soft")
    return tag(
        "g",
        line(box.left, box.bottom, box.right, box.bottom, "command"),
        line(box.left, middle, box.right, middle, "grid"),
        speeds.curve(time, np.clip(share, -1, 1), "before", width=LINE / 2),
        box.curve(time, q, "after"),
        words(joint, box.left, top + 10, bold=True),
        words(reach, box.right, top + 10, anchor="end", colour="soft"),
        *([*box.seconds(), key] if last else []),
    )
