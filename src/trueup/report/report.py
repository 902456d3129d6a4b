# SPDX-License-Identifier: Apache-2.0
"""The report: a calibration as one HTML file that opens anywhere, without a network."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from importlib import resources
from pathlib import Path
from string import Template

from trueup.calibration import Calibration
from trueup.report.figures import figure_data
from trueup.report.markup import Markup, escape, join, tag
from trueup.report.sections import Section, sections
from trueup.report.writing import write_aside

SCRIPTS = ("read.js", "style.js", "replay.js", "details.js", "tables.js", "start.js")
"""Own JavaScript, in the order in which it is joined into one scope."""


def write_report(
    calibration: Calibration,
    path: str | os.PathLike[str],
    *,
    title: str | None = None,
    context: Mapping[str, str] | None = None,
) -> Path:
    """Write `calibration` to the HTML file `path` and return it.

    The file holds everything it needs, Plotly included: it opens from disk, can be mailed, and asks nothing of the
    network. Missing folders are made. `title` defaults to the model's name; `context` is listed at the end as it is
    (versions, command line, date).

    Raises:
        OutputError: the file cannot be written; an older report at `path` is untouched.
    """
    path = Path(path)
    text = report_html(calibration, title=title, context=context)
    write_aside(text, path)
    return path


def report_html(calibration: Calibration, *, title: str | None = None, context: Mapping[str, str] | None = None) -> str:
    """The report as the text of an HTML document."""
    from plotly.offline import get_plotlyjs

    shown = title or f"Calibration of {calibration.model_name}"
    answered = sections(calibration, context or {})
    own = "\n".join(_template(name) for name in SCRIPTS)
    return Template(_template("report.html")).substitute(
        title=escape(shown),
        style=_template("report.css"),
        subtitle=_subtitle(calibration, shown),
        contents=join(tag("a", s.short, href=f"#{s.key}") for s in answered),
        sections=join(_section(s) for s in answered),
        data=data_text(figure_data(calibration)),
        plotly=get_plotlyjs(),
        script=own,
    )


def data_text(data: object) -> str:
    """`data` as JSON that may stand inside a script element, whatever names it holds."""
    text = json.dumps(data, allow_nan=False, ensure_ascii=True, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _section(section: Section) -> Markup:
    return tag("section", tag("h2", section.question), section.body, id=section.key)


def _subtitle(calibration: Calibration, title: str) -> Markup:
    parts: Iterator[str] = filter(
        None,
        (
            calibration.model_name if calibration.model_name not in title else "",
            _counted(len({r.recording for r in calibration.replays}), "recording"),
            _counted(len(calibration.estimates), "parameter"),
        ),
    )
    return escape(" · ".join(parts))


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def _template(name: str) -> str:
    return resources.files("trueup.report").joinpath("templates", name).read_text(encoding="utf-8")
