# SPDX-License-Identifier: Apache-2.0
"""The section of an identification's report on its files: what each is for, how good it is as read back, the formulas."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from trueup.identification.estimation.result import Deliverable, Identification
from trueup.report.markup import Markup, breakable, join, tag
from trueup.report.numbers import duration_of_a_call
from trueup.report.parts import caption, cells, head, row, sentences, table

_TITLES = {"fit": "the fit itself", "model file as given": "model file as it was given"}
_USE = """\
import trueup
model = trueup.load("FOLDER")            # this report's folder
torque = model.torque(q, qd, qdd)        # (samples, joints): rad, rad/s, rad/s² to {units}"""


def files_section(result: Identification, delivered: Sequence[Deliverable]) -> Markup:
    """Which file is for what, its errors in all, by joint and by log, and the model as formulas."""
    notes = [f"{_name(d)}: {d.note}." for d in delivered if d.note]
    return join(
        tag(
            "p",
            "Every number here is that of the file, read back from disk: share of the measured torque that it leaves.",
        ),
        _overview(result, delivered),
        sentences(notes) if notes else None,
        tag("pre", usage(result)),
        _opened("Errors by joint", _by_joint(result, delivered)),
        _opened("Errors by log", _by_log(delivered)),
        _opened("The model as formulas", tag("pre", "\n".join(result.model.formulas()))),
    )


def usage(result: Identification) -> str:
    """The lines of Python that predict, with the units that come out."""
    return _USE.format(units=" or ".join(dict.fromkeys(result.units)))


def _opened(title: str, body: Markup) -> Markup:
    return tag("details", tag("summary", title), body)


def _name(d: Deliverable) -> str:
    return ", ".join(d.files) or _TITLES.get(d.name, d.name)


def _short(d: Deliverable) -> str:
    """For the head of a column."""
    return {"fit": "fit", "model file": "model file", "model file as given": "as given"}.get(d.name, _name(d))


def _percent(value: float) -> str:
    return f"{100 * value:.2f} %" if math.isfinite(value) else "–"


def _overview(result: Identification, delivered: Sequence[Deliverable]) -> Markup:
    rows, unit = [], result.unit
    for d in delivered:
        time = duration_of_a_call(d.seconds) if math.isfinite(d.seconds) else "–"
        apart = f"{d.difference:.0e} {unit}" if d.files and math.isfinite(d.difference) else "–"
        numbers = cells(_percent(d.relative(held_out=False)), _percent(d.relative(held_out=True)), apart, time)
        rows.append(row(breakable(_name(d)), numbers, cells(d.use, kind="words")))
    titles = ("File", "Fitted", "Held out", "Furthest from the fit", "A call", "Use it for")
    return table(head(*titles, numbers=range(1, 5)), rows, "compact", id="deliverables")


def _by_joint(result: Identification, delivered: Sequence[Deliverable]) -> Markup:
    held = bool(result.held_out())
    shown = [d for d in delivered if d.errors]
    errors = np.array([d.relative_by_joint(held_out=held) for d in shown])
    rows = [row(breakable(joint), cells(*(_percent(x) for x in errors[:, j]))) for j, joint in enumerate(result.joints)]
    what = "Motion that was held out." if held else "Motion that was fitted: nothing was held out."
    return join(
        caption(what), table(head("Joint", *map(_short, shown), numbers=range(1, 1 + len(shown))), rows, "compact")
    )


def _by_log(delivered: Sequence[Deliverable]) -> Markup:
    shown, rows = [d for d in delivered if d.errors], []
    for logs in zip(*(d.errors for d in shown), strict=True):
        shares = [math.sqrt(e.squares.sum() / e.power.sum()) if e.power.sum() else math.nan for e in logs]
        kind = "held out" if logs[0].held_out else "fitted"
        rows.append(row(breakable(logs[0].recording), cells(kind, kind=""), cells(*map(_percent, shares))))
    return table(head("Log", "", *map(_short, shown), numbers=range(2, 2 + len(shown))), rows, "compact")
