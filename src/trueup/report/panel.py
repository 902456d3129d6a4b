# SPDX-License-Identifier: Apache-2.0
"""One panel of a still picture: a joint's replay and beneath it the error, as SVG."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.calibration import Replay
from trueup.report.drawing import EDGE, FOOT, MARGIN, SAMPLES, WIDTH, Box, words
from trueup.report.encoding import kept_samples
from trueup.report.marks import nice_marks
from trueup.report.markup import Markup, tag
from trueup.report.numbers import Scale, shortened
from trueup.report.summary import amounts, column_score


@dataclass(frozen=True)
class Panel:
    """Where a panel lies, in pixels, and whether it is at the left and lower edge of the picture."""

    x: float
    y: float
    width: float
    height: float
    first: bool
    last: bool


_MOTION, _GAP, _NUMBERS = 126, 14, 64
"""Pixels: from the panel's top to the end of the motion, between it and the error, and left of both for numbers."""
_DASHES = {"command": "4 3"}
"""Of lines that are not drawn through."""


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
    parts = [
        *upper.rows(nice_marks(upper.y0, upper.y1, 4)),
        *lower.rows(_either_side(lower.y1)),
        *([_beside(upper, replay.unit), _beside(lower, f"error, {scale.unit}")] if panel.first else []),
        *(lower.seconds() if panel.last else []),
        upper.clipped(f"value-{column}", *(_curve(time[kept], v[kept], upper, name) for name, v in lines.items())),
        lower.clipped(f"error-{column}", *(_curve(time[kept], v[kept], lower, name) for name, v in errors.items())),
        words(
            shortened(replay.labels[column], 30 if panel.width < WIDTH else 60), upper.left, upper.top - 7, bold=True
        ),
        words(amounts(score, scale), upper.right, upper.top - 7, anchor="end", colour="soft"),
    ]
    return tag("g", parts)


def _boxes(
    panel: Panel, start: float, stop: float, lines: dict[str, Array], errors: dict[str, Array]
) -> tuple[Box, Box]:
    run_away = 15  # Times its own range that the error after calibration leaves to the error before it
    left, right = panel.x + _NUMBERS, panel.x + panel.width - EDGE
    top, split, bottom = panel.y + 22, panel.y + _MOTION, panel.y + panel.height - FOOT
    stop = stop if stop > start else start + 1.0
    upper = Box(
        left, right, top, split, start, stop, *_range([lines[k] for k in lines if k != "before"], lines["before"])
    )
    low, high = _range([errors["after"]], errors["before"], spare=run_away)
    size = max(abs(low), abs(high))
    return upper, Box(left, right, split + _GAP, bottom, start, stop, -size, size)


def _range(main: Sequence[Array], other: Array, spare: float = 0.5) -> tuple[float, float]:
    """The range of `main`, widened for `other` by at most `spare` of itself on each side: it may have run away."""
    values = np.concatenate(main)
    values = values[np.isfinite(values)]
    if values.size == 0:
        return -1.0, 1.0
    low, high = float(values.min()), float(values.max())
    size = (high - low) or abs(high) / 10 or 1.0
    other = other[np.isfinite(other)]
    if other.size:
        low, high = (
            max(min(low, float(other.min())), low - spare * size),
            min(max(high, float(other.max())), high + spare * size),
        )
    margin = MARGIN * ((high - low) or size)
    return low - margin, high + margin


def _either_side(size: float) -> list[float]:
    """-m, 0, m with the largest m of the form 1, 2 or 5 x 10^n that fits below `size`."""
    magnitude = 10.0 ** math.floor(math.log10(size))
    mark = max(f * magnitude for f in (1, 2, 5) if f * magnitude <= size)
    return [-mark, 0.0, mark]


def _beside(box: Box, title: str) -> Markup:
    """What an axis shows, written upward beside it."""
    return words(
        title, box.left - _NUMBERS + 18, (box.top + box.bottom) / 2, anchor="middle", colour="soft", turned=True
    )


def _curve(time: Array, values: Array, box: Box, name: str) -> Markup:
    return box.curve(time, values, name, dash=_DASHES.get(name))
