# SPDX-License-Identifier: Apache-2.0
"""The report of an identification: how well torque is predicted, where, with which parameters, and what is missing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from trueup.errors import counted
from trueup.formats.aside import write_aside
from trueup.identification.estimation.result import Deliverable, Identification
from trueup.report.identification_sections import identification_sections
from trueup.report.parts import page

_STYLE = """
.detail { color: var(--soft); font-weight: 400; font-size: 13px; margin-left: 12px; }
figure h4 { margin-top: 0; }
.chip.roughly { background: var(--warn-wash); color: var(--warn); }
.chip.not-seen, .chip.impossible { background: var(--bad-wash); color: var(--bad); }
#links td, #links th { white-space: nowrap; }
#links td.words { white-space: normal; }
table.compact th[scope="row"] { min-width: 92px; }
#files pre { white-space: pre-wrap; overflow-wrap: anywhere; font-size: 13px; }
table.compact td.words { min-width: 230px; }
#files details, #parameters details { margin-top: 12px; }
#numbers td:nth-child(2) { white-space: nowrap; }
#files summary, #parameters summary { cursor: pointer; }
table.compact td, table.compact th { padding: 4px 9px; }
"""


def write_identification_report(
    result: Identification, path: str | Path, *, delivered: Sequence[Deliverable] = (),
    context: Mapping[str, str] | None = None,
) -> Path:  # fmt: skip
    """Writes the report to the HTML file `path` and returns it; it holds all it needs. `delivered` are the files beside it,
    with their errors. Raises OutputError.
    """
    where = Path(path)
    write_aside(identification_html(result, delivered=delivered, context=context), where)
    return where


def identification_html(
    result: Identification, *, delivered: Sequence[Deliverable] = (),
    context: Mapping[str, str] | None = None,
) -> str:  # fmt: skip
    """The report as the text of an HTML document."""
    recordings = len({p.recording for p in result.predictions})
    counts = (
        (len(result.joints), "joint"),
        (recordings, "recording"),
        (len(result.parameters), "parameter"),
    )
    return page(
        "campaign.html",
        f"Dynamic model of {result.model_name}",
        [counted(count, noun) for count, noun in counts],
        identification_sections(result, delivered, context or {}),
        style=_STYLE,
    )
