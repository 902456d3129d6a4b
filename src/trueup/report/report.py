# SPDX-License-Identifier: Apache-2.0
"""The report: a calibration as one HTML file that opens anywhere, without a network."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path

from trueup.calibration import Calibration
from trueup.errors import counted
from trueup.formats.aside import write_aside
from trueup.report.figures import figure_data
from trueup.report.parts import page, template_text
from trueup.report.sections import sections

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
    subtitle = (
        calibration.model_name if calibration.model_name not in shown else "",
        counted(len({r.recording for r in calibration.replays}), "recording"),
        counted(len(calibration.estimates), "parameter"),
    )
    return page(
        "report.html",
        shown,
        subtitle,
        sections(calibration, context or {}),
        data=data_text(figure_data(calibration)),
        plotly=get_plotlyjs(),
        script="\n".join(template_text(name) for name in SCRIPTS),
    )


def data_text(data: object) -> str:
    """`data` as JSON that may stand inside a script element, whatever names it holds."""
    text = json.dumps(data, allow_nan=False, ensure_ascii=True, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
