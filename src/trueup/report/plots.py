# SPDX-License-Identifier: Apache-2.0
"""Small still plots as SVG in the report's own colours: dots, lines and intervals over two plain axes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from trueup.arrays import Array
from trueup.report.drawing import EDGE, HEAD, LINE, MARGIN, TEXT, Box, path_of
from trueup.report.marks import mark_texts, nice_marks
from trueup.report.markup import Markup, tag

Point = tuple[float, float]

BEFORE, AFTER, INK, SOFT, FAINT, BAD = (f"var(--{name})" for name in ("before", "after", "ink", "soft", "faint", "bad"))
BAND = "rgba(var(--accent), 0.18)"


@dataclass
class Plot:
    """A plot being drawn: axes from the ranges given, elements added in order. Values in any unit, NaN skipped."""

    x: tuple[float, float]
    y: tuple[float, float]
    x_title: str = ""
    y_title: str = ""
    width: int = 720
    height: int = 300
    x_marks: Sequence[tuple[float, str]] | None = None
    """Where to write what below the axis; round numbers if None."""
    equal: bool = False
    """One unit is as long on both axes: for maps."""
    _left: int = 58
    """Room for what is written beside the vertical axis, in pixels."""
    _parts: list[Markup] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Widens empty ranges, and the longer axis of a map; makes room for long numbers."""
        self.x, self.y = _wide(self.x), _wide(self.y)
        least, drawn = self._left, (self.x, self.y)
        turns = 3 if self.equal else 1  # the longer axis of a map may have longer numbers, which leave it less room
        for _ in range(turns):
            longest = max((len(words) for words in mark_texts(nice_marks(*self.y, 5))), default=0)
            self._left = max(least, 34 + 7 * longest) if self.y_title else 14 + 7 * longest
            if self.equal:
                inner, high = self.width - EDGE - self._left, self.height - EDGE - HEAD
                scale = max((a[1] - a[0]) / size for a, size in zip(drawn, (inner, high), strict=True))
                self.x, self.y = _about(drawn[0], scale * inner), _about(drawn[1], scale * high)

    @property
    def _box(self) -> Box:
        return Box(self._left, self.width - EDGE, EDGE, self.height - HEAD, *self.x, *self.y)

    def at(self, point: Point) -> tuple[float, float]:
        """Where a point lies, in pixels."""
        x, y = (np.array([value], dtype=np.float64) for value in point)
        return float(self._box.x(x)[0]), float(self._box.y(y)[0])

    def line(self, points: Iterable[Point], colour: str, *, width: float = LINE, dashed: bool = False) -> None:
        """A line through points; a gap where one is NaN."""
        table = np.array(list(points), dtype=np.float64).reshape(-1, 2)
        self.curve(table[:, 0], table[:, 1], colour, width=width, dashed=dashed)

    def curve(self, x: Array, y: Array, colour: str, *, width: float = LINE, dashed: bool = False) -> None:
        """A line through (T,) values; a gap where one is NaN."""
        path = path_of(self._box.x(np.asarray(x)), self._box.y(np.asarray(y)))
        self._parts.append(tag("path", d=path, fill="none", style=f"stroke:{colour}", stroke_width=width,
                               stroke_dasharray="5 4" if dashed else None))  # fmt: skip

    def band(self, x: Array, low: Array, high: Array) -> None:
        """The area between two lines (T,)."""
        px, py = self._box.x(np.concatenate([x, x[::-1]])), self._box.y(np.concatenate([low, high[::-1]]))
        outline = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(px.tolist(), py.tolist(), strict=True))
        self._parts.append(tag("polygon", points=outline, style=f"fill:{BAND}"))

    def box(self, x: tuple[float, float], y: tuple[float, float], colour: str, title: str = "") -> None:
        """A filled rectangle; `title` is shown under the pointer."""
        (x0, y0), (x1, y1) = self.at((x[0], y[1])), self.at((x[1], y[0]))
        body = tag("title", title) if title else ""
        size = f'width="{max(x1 - x0, 0.5):.1f}" height="{max(y1 - y0, 0.5):.1f}"'
        self._parts.append(Markup(f'<rect x="{x0:.1f}" y="{y0:.1f}" {size} style="fill:{colour}">{body}</rect>'))

    def dot(self, point: Point, colour: str, *, hollow: bool = False, size: float = 4.5, title: str = "") -> None:
        """A dot, hollow for what is only expected; `title` is shown under the pointer."""
        if not all(map(math.isfinite, point)):
            return
        px, py = self.at(point)
        fill = f"fill:{'var(--ground)' if hollow else colour};stroke:{colour}"
        body = tag("title", title) if title else None
        self._parts.append(
            Markup(
                f'<circle cx="{px:.1f}" cy="{py:.1f}" r="{size}" style="{fill}" stroke-width="1.8">{body or ""}</circle>'
            )
        )

    def bar(self, x: float, low: float, high: float, colour: str) -> None:
        """A vertical interval."""
        if math.isfinite(low) and math.isfinite(high):
            (x1, y1), (x2, y2) = self.at((x, low)), self.at((x, high))
            self._parts.append(tag("line", x1=x1, y1=y1, x2=x2, y2=y2, style=f"stroke:{colour}", stroke_width=1.8))

    def text(self, point: Point, words: str, colour: str = SOFT, *, anchor: str = "start", above: float = 0.0) -> None:
        """Words at a point."""
        px, py = self.at(point)
        self._parts.append(
            tag("text", words, x=px, y=py - above, style=f"fill:{colour}", font_size="12", text_anchor=anchor)
        )

    def svg(self, label: str) -> Markup:
        """The finished plot; `label` says it to those who cannot see it."""
        return tag(
            "svg", [*self._axes(), *self._parts], viewBox=f"0 0 {self.width} {self.height}", role="img", aria_label=label,
            style=f"width:100%;max-width:{self.width + self.width // 5}px;height:auto", font_family="inherit",
        )  # fmt: skip

    def _axes(self) -> list[Markup]:
        rows = []
        marks = nice_marks(*self.y, 5)
        for mark, words in zip(marks, mark_texts(marks), strict=True):
            x1, y = self.at((self.x[0], mark))
            x2, _ = self.at((self.x[1], mark))
            rows.append(tag("line", x1=x1, y1=y, x2=x2, y2=y, style="stroke:var(--rule)"))
            rows.append(_word(x1 - 7, y + 4, words, "end"))
        written = self.x_marks
        if written is None:
            places = nice_marks(*self.x, 8)
            written = list(zip(places, mark_texts(places), strict=True))
        bottom, middle = self._box.bottom, (self._box.top + self._box.bottom) / 2
        rows += [_word(self.at((place, self.y[0]))[0], bottom + 17, words, "middle") for place, words in written]
        rows.append(_word((self._left + self.width - EDGE) / 2, self.height - 6, self.x_title, "middle"))
        rows.append(tag("text", self.y_title, x=EDGE, y=middle, text_anchor="middle", font_size=TEXT,
                        style="fill:var(--soft)", transform=f"rotate(-90 {EDGE} {middle:.0f})"))  # fmt: skip
        return rows


def span(values: Iterable[float], *, zero: bool = False, margin: float = MARGIN) -> tuple[float, float]:
    """The range of the finite values with a margin; with `zero` it holds zero too."""
    known = [v for v in values if math.isfinite(v)] + ([0.0] if zero else [])
    if not known:
        return 0.0, 1.0
    low, high = min(known), max(known)
    more = margin * ((high - low) or abs(high) or 1.0)
    return (low if zero and low == 0.0 else low - more), (high if zero and high == 0.0 else high + more)


def _wide(ends: tuple[float, float]) -> tuple[float, float]:
    return ends if ends[1] > ends[0] else (ends[0] - 0.5, ends[0] + 0.5)


def _about(ends: tuple[float, float], length: float) -> tuple[float, float]:
    middle = 0.5 * (ends[0] + ends[1])
    return middle - 0.5 * length, middle + 0.5 * length


def _word(x: float, y: float, words: str, anchor: str) -> Markup:
    return tag("text", words, x=x, y=y, text_anchor=anchor, font_size="12", style="fill:var(--soft)")
