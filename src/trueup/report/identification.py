# SPDX-License-Identifier: Apache-2.0
"""The report of an identification: how well torque is predicted, where, with which parameters, and what is missing."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from string import Template

from trueup.identification.estimation.result import Identification
from trueup.report.identification_sections import identification_sections
from trueup.report.markup import escape, join, tag
from trueup.report.writing import write_aside

_STYLE = """
.detail { color: var(--soft); font-weight: 400; font-size: 13px; margin-left: 12px; }
figure h4 { margin-top: 0; }
.chip.roughly { background: var(--warn-wash); color: var(--warn); }
.chip.not-seen, .chip.impossible { background: var(--bad-wash); color: var(--bad); }
#links td, #links th { white-space: nowrap; }
#links td.words { white-space: normal; }
table.compact th[scope="row"] { min-width: 92px; }
table.compact td, table.compact th { padding: 4px 9px; }
"""


def write_identification_report(
    found: Identification, path: str | Path, *, title: str | None = None, context: Mapping[str, str] | None = None
) -> Path:
    """Writes the report to the HTML file `path` and returns it; it holds all it needs. Raises OutputError."""
    where = Path(path)
    write_aside(identification_html(found, title=title, context=context), where)
    return where


def identification_html(
    found: Identification, *, title: str | None = None, context: Mapping[str, str] | None = None
) -> str:
    """The report as the text of an HTML document."""
    shown = title or f"Dynamic model of {found.model_name}"
    answered = identification_sections(found, context or {})
    recordings = len({p.recording for p in found.predictions})
    return Template(_template("campaign.html")).substitute(
        title=escape(shown),
        style=_template("report.css") + _STYLE,
        subtitle=escape(
            f"{len(found.joints)} joints · {recordings} recording{'s' * (recordings != 1)} · "
            f"{len(found.parameters)} parameters"
        ),
        contents=join(tag("a", s.short, href=f"#{s.key}") for s in answered),
        sections=join(tag("section", tag("h2", s.question), s.body, id=s.key) for s in answered),
    )


def _template(name: str) -> str:
    return resources.files("trueup.report").joinpath("templates", name).read_text(encoding="utf-8")
