# SPDX-License-Identifier: Apache-2.0
"""Before and after as two dots on one axis: a row of a chart that is as wide as its table cell."""

from __future__ import annotations

import math
from collections.abc import Iterable

from trueup.report.marks import mark_texts, nice_marks, spans_decades
from trueup.report.markup import Markup, tag
from trueup.report.numbers import Scale, significant, with_unit
from trueup.report.summary import Score
from trueup.rounding import ROUNDED


class Axis:
    """The horizontal axis of the chart: from zero, or logarithmic where the errors span more than a factor of 100."""

    @classmethod
    def over(cls, scores: Iterable[Score], scale: Scale) -> Axis:
        """An axis on which all of `scores` can be shown."""
        ends = [v * scale.factor for s in scores for v in (s.before, s.after) if math.isfinite(v)]
        largest = max(ends, default=1.0)
        return cls(largest, min((v for v in ends if v > 0), default=largest))

    def __init__(self, largest: float, smallest: float) -> None:
        self.log = spans_decades(smallest, largest)
        self.low = 10.0 ** math.floor(math.log10(smallest)) if self.log else 0.0
        self.high = largest if largest > 0 else 1.0

    def percent(self, value: float) -> float:
        """Where `value` lies, in percent of the width; 2 to 98."""
        if self.log:
            part = math.log(max(value, self.low) / self.low) / math.log(self.high / self.low)
        else:
            part = value / self.high
        return 2 + 96 * min(max(part, 0.0), 1.0)

    def marks(self) -> list[float]:
        """Round values to write on the axis."""
        if self.log:
            first = round(math.log10(self.low))
            decades = [10.0**d for d in range(first, math.floor(math.log10(self.high) + ROUNDED) + 1)]
            return decades[:: max(1, math.ceil(len(decades) / 6))]
        return nice_marks(0.0, self.high, 6)

    def mark_texts(self) -> list[str]:
        """The marks as they are written."""
        return [significant(m, 1) for m in self.marks()] if self.log else mark_texts(self.marks())

    def ticks(self, unit: str) -> Markup:
        """The axis with its numbers, as an SVG that is as wide as its cell."""
        marks = self.marks()
        texts = [
            tag(
                "text",
                with_unit(text, unit) if m == marks[-1] else text,
                x=f"{self.percent(m):.2f}%",
                y="14",
                text_anchor="start" if self.percent(m) < 8 else "end" if self.percent(m) > 92 else "middle",
            )
            for m, text in zip(marks, self.mark_texts(), strict=True)
        ]
        return tag("svg", texts, width="100%", height="18", class_="ticks", aria_hidden="true")

    def dumbbell(self, score: Score, scale: Scale) -> Markup:
        """Before and after as two dots, joined; gridlines and the noise behind them."""
        middle = "13"
        parts: list[Markup] = [self._upright(m, "grid") for m in self.marks()]
        if math.isfinite(score.noise):
            parts.append(self._upright(score.noise * scale.factor, "noise"))
        ends = [
            f"{self.percent(v * scale.factor):.2f}%" if math.isfinite(v) else None for v in (score.before, score.after)
        ]
        if ends[0] and ends[1]:
            parts.append(tag("line", x1=ends[0], x2=ends[1], y1=middle, y2=middle, class_="bar"))
        parts += [
            tag("circle", cx=end, cy=middle, r=6, class_=kind)
            for end, kind in zip(ends, ("before", "after"), strict=True)
            if end
        ]
        label = f"before {scale.text(score.before)}, after {scale.text(score.after)} {scale.unit}"
        return tag("svg", parts, width="100%", height="26", role="img", aria_label=label)

    def _upright(self, value: float, kind: str) -> Markup:
        x = f"{self.percent(value):.2f}%"
        return tag("line", x1=x, x2=x, y1="0", y2="26", class_=kind)
