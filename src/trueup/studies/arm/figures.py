# SPDX-License-Identifier: Apache-2.0
"""The papers' figures with the stand-in's data, and the Markdown report as one HTML file that holds them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from importlib import resources
from string import Template

import numpy as np

from trueup.report.markup import Markup, escape, join, tag
from trueup.report.plots import AFTER, BEFORE, INK, SOFT, Plot, span
from trueup.studies.arm.comparison import Errors
from trueup.studies.arm.robot import NOMINAL

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


def page(markdown: str, figures: Mapping[str, Sequence[Markup]], folded: Sequence[str] = ()) -> str:
    """The report as HTML; figures stand behind the heading that they are keyed by, `folded` headings open on a click."""
    sections: list[Markup] = []
    contents: list[Markup] = []
    for part in re.split(r"\n\n(?=## )", markdown):
        blocks = re.split(r"\n\n+", part.strip())
        heading = blocks[0].lstrip("# ") if blocks[0].startswith("#") else ""
        body = [*(_block(block) for block in blocks[1 if heading else 0 :]), *figures.get(heading, ())]
        if blocks[0].startswith("## "):
            key = re.sub(r"\W+", "-", heading.lower())
            contents.append(tag("a", heading, href=f"#{key}"))
            if heading.startswith(tuple(folded)):
                sections.append(tag("section", tag("details", tag("summary", heading), *body), id=key))
                continue
            body.insert(0, tag("h2", heading, id=key))
        sections.append(tag("section", *body))
    templates = resources.files("trueup.report").joinpath("templates")
    return Template(templates.joinpath("campaign.html").read_text(encoding="utf-8")).substitute(
        title=escape("Local and global identification of an arm"), contents=join(*contents), sections=join(*sections),
        style=templates.joinpath("report.css").read_text(encoding="utf-8") + _STYLE,
        subtitle=escape("a stand-in NS16, truth known"),
    )  # fmt: skip


_STYLE = """
body { max-width: 1220px; }
summary { cursor: pointer; font-size: 18px; font-weight: 600; }
section { overflow-x: auto; padding: 22px 0 20px; }
table.cells { font-size: 11.5px; margin: 0 0 18px; width: auto; }
table.cells td, table.cells th { padding: 3px 7px 3px 0; text-align: right; white-space: nowrap; }
table.cells thead th { white-space: normal; min-width: 74px; max-width: 150px; }
table.cells td.word, table.cells thead th.word { text-align: left; min-width: 0; }
table.cells td.long, table.cells thead th.long { white-space: normal; min-width: 124px; }
"""


def _block(block: str) -> Markup:
    if block.startswith("|"):
        return _table(block)
    return tag("p", Markup(re.sub(r"\*\*?(.+?)\*\*?", r"<b>\1</b>", escape(block))))


def _table(block: str) -> Markup:
    """Columns of figures to the right, of words to the left; the rows of ours stand out."""
    rows = [[cell.strip() for cell in line[2:-2].split(" | ")] for line in block.splitlines()]
    head, body = rows[0], rows[2:]
    words = [not any(re.match(r"[-x+]? ?[\d.]", row[k]) for row in body) for k in range(len(head))]
    longest = [max((len(row[k]) for row in body), default=0) for k in range(len(head))]
    kinds = ["word long" if words[k] and longest[k] > 12 else "word" if words[k] else None for k in range(len(head))]
    kinds[0] = kinds[0] or "word"

    def row(cells: Sequence[str], kind: str) -> Markup:
        made = [tag(kind, c, class_=kinds[k]) for k, c in enumerate(cells)]
        return tag("tr", made, class_="best" if cells[0].startswith("ours") else None)

    return tag("table", tag("thead", row(head, "th")), tag("tbody", [row(r, "td") for r in body]), class_="cells")
