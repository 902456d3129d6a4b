# SPDX-License-Identifier: Apache-2.0
"""The summary of an identification for a terminal: how well torque is predicted, on what, and what was not seen."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from trueup.commands.console import notes, table_of, tell
from trueup.identification.estimation.result import Deliverable, Identification, relative_error, relative_errors, rmse
from trueup.report.numbers import duration_of_a_call, duration_text, significant


def show_identification(
    result: Identification,
    delivered: Sequence[Deliverable],
    folder: Path,
    console: Console,
    *,
    quiet: bool = False,
) -> None:
    """Prints warnings, errors by joint, the error of each file in `folder`, and what could not be told."""
    for sentence in result.warnings:
        tell(console, f"[red]mind[/] {escape(sentence)}")
    notes(console, result.notes, quiet=quiet)
    for sentence in result.advice if not quiet else ():
        tell(console, f"[cyan]{escape(sentence)}[/]")
    console.print(_table(result))
    judged = result.judged()
    where = "held out" if result.held_out() else "TRAINING DATA, nothing was held out"
    tell(
        console, f"torque error ({where}): [bold]{100 * relative_error(judged):.2f} %[/] of the torque that it carries"
    )
    left_out = f"{significant(result.cross_validated())} {result.unit}"
    tell(console, f"fitted: {100 * relative_error(result.training()):.2f} %   cross-validated: {left_out}   "
                  f"cut-off {result.cutoff:g} Hz   {duration_text(result.seconds)}")  # fmt: skip
    counts = Counter(p.verdict for p in result.parameters)
    edges = [link.name for link in result.links if link.on_boundary]
    told = ", ".join(f"{counts[v]} {v}" for v in ("identified", "roughly", "small", "shared", "not seen") if counts[v])
    tell(console, f"parameters: {told}")
    if edges:
        said = escape(", ".join(edges))
        tell(console, f"[yellow]on the edge of what is possible:[/] {said}")
    console.print(_files(result, delivered))
    for d in delivered if not quiet else ():
        if d.note and d.name != "Python file":
            tell(console, f"{d.name}: {escape(d.note)}")
    tell(console, escape(f"{folder}: start with {folder / 'report.html'}"))


def _files(result: Identification, delivered: Sequence[Deliverable]) -> Table:
    """Each file with its error as it was read back, and what it is for."""
    table, held = (
        table_of("file", "fitted", "held out", "use it for", words=("file", "use it for")),
        bool(result.held_out()),
    )
    for d in delivered:
        known = [d.errors and (held or not k) for k in (False, True)]
        errors = [f"{100 * d.relative(held_out=bool(k)):.2f} %" if yes else "-" for k, yes in enumerate(known)]
        seconds = f" ({duration_of_a_call(d.seconds)} a call)" if np.isfinite(d.seconds) else ""
        table.add_row(escape("\n".join(d.files) or f"({d.name})"), *errors, escape(d.use + seconds))
    return table


def _table(result: Identification) -> Table:
    judged = result.judged()
    table = table_of("joint", "error", "% of its torque", "% of its limit", words=("joint",))
    for j, name in enumerate(result.joints):
        error, share = float(rmse(judged)[j]), float(relative_errors(judged)[j])
        limit = result.effort[j]
        table.add_row(
            escape(name), f"{significant(error)} {result.units[j]}", f"{100 * share:.1f}",
            f"{100 * error / limit:.2f}" if np.isfinite(limit) else "-",
        )  # fmt: skip
    return table
