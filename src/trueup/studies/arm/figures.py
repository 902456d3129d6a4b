# SPDX-License-Identifier: Apache-2.0
"""The papers' figures with the stand-in's data, and the Markdown report as one HTML file that holds them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from importlib import resources
from string import Template

import numpy as np
from numpy.typing import NDArray

from trueup.report.markup import Markup, escape, join, tag
from trueup.report.plots import AFTER, BEFORE, INK, SOFT, Plot, span
from trueup.studies.arm.comparison import Errors
from trueup.studies.arm.robot import NOMINAL

Array = NDArray[np.float64]

_SHOWN = ("A", "A_local", "B fast", "B slow", "ours")
_COLOURS = {"A": BEFORE, "A_local": SOFT, "B fast": INK, "B slow": "var(--bad)", "ours": AFTER}


def torques(errors: Errors) -> Markup:
    """Evolved trajectories, figures 4-6: torque measured, predicted, and the predictions' band of one sigma."""
    shown, panels = errors.example, []
    if shown is None:
        return Markup("")
    keep = slice(None, None, max(1, len(shown.time) // 400))
    time = shown.time[keep]
    for axis in range(len(NOMINAL)):
        measured = shown.measured[keep, axis]
        plot = Plot(span(time), span([*measured]), "s", f"axis {axis + 1}, N m", width=460, height=230)
        plot.line(zip(time.tolist(), measured.tolist(), strict=True), INK, width=2.2)
        for algorithm in ("B fast", "ours"):
            predicted = shown.predicted[algorithm][:, axis]
            sigma = float(np.sqrt(np.mean((predicted - shown.measured[:, axis]) ** 2)))
            for shift, dashed in ((0.0, False), (-sigma, True), (sigma, True)):
                values = (predicted[keep] + shift).tolist()
                colour = AFTER if algorithm == "ours" else BEFORE
                plot.line(zip(time.tolist(), values, strict=True), colour, width=0.6 if dashed else 1.2, dashed=dashed)
        panels.append(plot.svg(f"torque of axis {axis + 1}"))
    legend = tag("p", tag("b", "measured"), " and predicted by ", tag("b", "B fast", style=f"color:{BEFORE}"), " and ",
                 tag("b", "ours", style=f"color:{AFTER}"), ", dashed: one standard deviation", class_="key")  # fmt: skip
    return join(legend, tag("div", *panels, class_="figures"))


def distributions(errors: Errors) -> Markup:
    """Evolved trajectories, figures 7 and 8: errors over trajectories and excitations, by axis, in % of nominal torque."""
    panels = []
    for case in dict.fromkeys(case for _, case in errors.absolute):
        percent = {a: 100.0 * errors.absolute[a, case].reshape(-1, len(NOMINAL)) / NOMINAL for a in _SHOWN}
        top = min(float(np.quantile(np.concatenate(list(percent.values())), 0.9)), 40.0)
        marks = [(float(k), f"axis {k + 1}") for k in range(len(NOMINAL))]
        plot = Plot((-0.5, 5.5), (0.0, top), case, "% of nominal", width=460, height=260, x_marks=marks)
        for place, algorithm in enumerate(_SHOWN):
            for axis in range(len(NOMINAL)):
                low, middle, high = np.quantile(percent[algorithm][:, axis], [0.05, 0.5, 0.95]).tolist()
                x, colour = axis + 0.16 * (place - 2), _COLOURS[algorithm]
                plot.bar(x, min(low, top), min(high, top), colour)
                if middle <= top:
                    plot.dot((x, middle), colour, size=3.0, title=f"{algorithm}: {middle:.2g} %")
        panels.append(plot.svg(f"errors on test case {case}"))
    named = [tag("b", name, " ", style=f"color:{_COLOURS[name]}") for name in _SHOWN]
    return join(tag("p", "median and 5 ... 95 %: ", *named, class_="key"), tag("div", *panels, class_="figures"))


def page(markdown: str, figures: Mapping[str, Markup]) -> str:
    """The report as HTML; each figure stands behind the heading that it is keyed by."""
    parts: list[Markup] = []
    contents = []
    for block in re.split(r"\n\n+", markdown):
        if heading := re.match(r"(#+) (.*)", block):
            level, words = len(heading[1]), heading[2]
            key = re.sub(r"\W+", "-", words.lower())
            if level > 1:
                contents.append(tag("a", words.split(":")[0], href=f"#{key}"))
                parts.append(tag("h2", words, id=key))
            parts.append(figures.get(words, Markup("")))
        elif block.startswith("|"):
            parts.append(_table(block))
        else:
            parts.append(tag("p", Markup(re.sub(r"\*\*(.+?)\*\*", r"<b>\1</b>", escape(block)))))
    templates = resources.files("trueup.report").joinpath("templates")
    return Template(templates.joinpath("campaign.html").read_text(encoding="utf-8")).substitute(
        title=escape("Local and global identification of an arm"), contents=join(contents), sections=join(parts),
        style=templates.joinpath("report.css").read_text(encoding="utf-8"), subtitle=escape("a stand-in NS16, truth known"),
    )  # fmt: skip


def _table(block: str) -> Markup:
    rows = [[cell.strip() for cell in line[2:-2].split(" | ")] for line in block.splitlines()]
    head, body = rows[0], rows[2:]
    written = [tag("tr", [tag("th" if k == 0 else "td", cell) for k, cell in enumerate(row)]) for row in body]
    return tag(
        "table", tag("thead", tag("tr", [tag("th", cell) for cell in head])), tag("tbody", written), class_="rounds"
    )
