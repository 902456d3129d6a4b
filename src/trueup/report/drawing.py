# SPDX-License-Identifier: Apache-2.0
"""What still pictures are drawn with: colours, sizes, words, curves with gaps, axes, and the SVG document around them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.report.marks import mark_texts, nice_marks
from trueup.report.markup import Markup, escape, join, tag

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

WIDTH, EDGE, HEAD, FOOT, TEXT = 900, 14, 44, 32, 12
"""Pixels, or points on paper: the width of every still picture; what is left free along its edges, for its title and key, and
below an axis for marks and title; the size of words, of which a line needs half as much again."""
LINE = 1.3
"""Pixels: the width of a curve; what matters most is twice as wide, what is there for comparison half."""
SAMPLES = 1600
"""Samples of a line in a picture: about two for each pixel."""
MARGIN = 0.06
"""Share of a range that an axis leaves free on both sides."""

_FONT = "system-ui, 'Helvetica Neue', 'Liberation Sans', Arial, sans-serif"


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
        return self.left + (values - self.x0) / ((self.x1 - self.x0) or 1.0) * (self.right - self.left)

    def y(self, values: Array) -> Array:
        """Pixels from the top of `values` on the vertical axis."""
        overflow = 100  # Heights of a box that a curve may leave it by; far beyond, renderers draw nonsense
        part = np.clip((values - self.y0) / ((self.y1 - self.y0) or 1.0), -overflow, overflow)
        return self.bottom - part * (self.bottom - self.top)

    def curve(self, x: Array, y: Array, colour: str, *, width: float = LINE, dash: str | None = None) -> Markup:
        """A curve through points (T,), a gap where one is missing."""
        return stroke(self.x(x), self.y(y), colour, width=width, dash=dash)

    def clipped(self, key: str, *drawn: Markup) -> Markup:
        """What is drawn, inside the box only: what ran away leaves it instead of lying flat along its edge."""
        frame = tag("rect", x=self.left, y=self.top, width=self.right - self.left, height=self.bottom - self.top)
        return join(tag("clipPath", frame, id=key), tag("g", drawn, clip_path=f"url(#{key})"))

    def rows(self, marks: Sequence[float]) -> list[Markup]:
        """A line across for each mark, with its number."""
        parts = [line(self.left, self.bottom, self.right, self.bottom, "command")]
        for mark, text in zip(marks, mark_texts(marks), strict=True):
            y = float(self.y(np.array([mark]))[0])
            parts.append(line(self.left, y, self.right, y, "grid"))
            parts.append(words(text, self.left - 6, y + 4, anchor="end", colour="soft"))
        return parts

    def seconds(self) -> list[Markup]:
        """Round times below it."""
        marks = nice_marks(self.x0, self.x1, 7)
        at = self.x(np.array(marks)).tolist()
        texts = mark_texts(marks)
        return [
            words(text + " s" * (k == len(marks) - 1), x, self.bottom + 16, anchor="middle", colour="soft")
            for k, (x, text) in enumerate(zip(at, texts, strict=True))
        ]


def stroke(x: Array, y: Array, colour: str, *, width: float = LINE, dash: str | None = None) -> Markup:
    """A curve through pixels (T,), a gap where one is missing; `colour` is one of COLOURS."""
    return tag("path", d=path_of(x, y), fill="none", stroke=COLOURS[colour], stroke_width=width, stroke_dasharray=dash,
               stroke_linejoin="round")  # fmt: skip


def path_of(x: Array, y: Array) -> str:
    """The path through pixels (T,), a gap where one is missing."""
    pieces, down = [], False
    for px, py in zip(np.asarray(x).tolist(), np.asarray(y).tolist(), strict=True):
        known = math.isfinite(px) and math.isfinite(py)
        if known:
            pieces.append(f"{'L' if down else 'M'}{px:.1f} {py:.1f}")
        down = known
    return "".join(pieces) or "M0 0"


def line(
    x1: float, y1: float, x2: float, y2: float, colour: str, *, width: float = 1.0, dash: str | None = None
) -> Markup:
    """A straight line between pixels."""
    return tag("line", x1=x1, y1=y1, x2=x2, y2=y2, stroke=COLOURS[colour], stroke_width=width, stroke_dasharray=dash)


def words(
    text: str, x: float, y: float, *, anchor: str | None = None, bold: bool = False, size: float | None = None,
    colour: str | None = None, turned: bool = False,
) -> Markup:  # fmt: skip
    """Words at a place in pixels; `turned` writes them upward."""
    return tag("text", text, x=x, y=y, text_anchor=anchor, font_weight="600" if bold else None, font_size=size,
               fill=COLOURS[colour] if colour else None,
               transform=f"rotate(-90 {x:.1f} {y:.1f})" if turned else None)  # fmt: skip


def title(text: str) -> Markup:
    """The title of a picture."""
    return words(text, EDGE, 24, bold=True, size=TEXT + 2)


def ruler(left: float, y: float, per_metre: float, size: float, most: int) -> Markup:
    """A length to scale below a map of `size` metres."""
    marks = nice_marks(0.0, size, most)
    length = marks[1] if len(marks) > 1 else marks[0]
    end = left + length * per_metre
    return join(line(left, y, end, y, "ink", width=LINE), words(f"{length:g} m", end + 6, y + 4, colour="soft"))


def document(parts: Sequence[Markup], height: float, about: str) -> str:
    """The SVG of a picture; `about` says it to those who cannot see it."""
    opening = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height:.0f}" width="{WIDTH}" '
        f'height="{height:.0f}" font-family="{escape(_FONT)}" font-size="{TEXT}" fill="{COLOURS["ink"]}" role="img">'
    )
    ground = tag("rect", width=WIDTH, height=height, fill="#ffffff")
    return "\n".join(
        ['<?xml version="1.0" encoding="UTF-8"?>', opening, tag("title", about), ground, *parts, "</svg>", ""]
    )
