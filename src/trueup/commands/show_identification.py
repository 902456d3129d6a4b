# SPDX-License-Identifier: Apache-2.0
"""The summary of an identification for a terminal: how well torque is predicted, on what, and what was not seen."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.box import SIMPLE
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from trueup.identification.estimation.result import Deliverable, Identification, relative_error, relative_errors, rmse
from trueup.report.numbers import duration_of_a_call, duration_text, significant


def show_identification(
    found: Identification, delivered: Sequence[Deliverable], folder: Path, console: Console, *, quiet: bool = False
) -> None:
    """Prints warnings, errors by joint, the error of each file in `folder`, and what could not be told."""
    for sentence in found.warnings:
        console.print(f"[red]mind[/] {escape(sentence)}", soft_wrap=True, highlight=False)
    if not quiet:
        for sentence in found.notes:
            console.print(f"[yellow]note[/] {escape(sentence)}", soft_wrap=True, highlight=False)
    for sentence in found.advice if not quiet else ():
        console.print(f"[cyan]{escape(sentence)}[/]", soft_wrap=True, highlight=False)
    console.print(_table(found))
    judged = found.judged()
    where = "held out" if found.held_out() else "TRAINING DATA, nothing was held out"
    line = f"torque error ({where}): [bold]{100 * relative_error(judged):.2f} %[/] of the torque that it carries"
    console.print(line, soft_wrap=True, highlight=False)
    console.print(
        f"fitted: {100 * relative_error(found.training()):.2f} %   cross-validated: "
        f"{significant(found.cross_validated())} {found.unit}   cut-off {found.cutoff:g} Hz   {duration_text(found.seconds)}",
        soft_wrap=True, highlight=False,
    )  # fmt: skip
    counts = Counter(p.verdict for p in found.parameters)
    edges = [link.name for link in found.links if link.on_boundary]
    told = ", ".join(f"{counts[v]} {v}" for v in ("identified", "roughly", "small", "shared", "not seen") if counts[v])
    console.print(f"parameters: {told}", highlight=False, soft_wrap=True)
    if edges:
        said = escape(", ".join(edges))
        console.print(f"[yellow]on the edge of what is possible:[/] {said}", highlight=False, soft_wrap=True)
    console.print(_files(found, delivered))
    for d in delivered if not quiet else ():
        if d.note and d.name != "Python file":
            console.print(f"{d.name}: {escape(d.note)}", highlight=False, soft_wrap=True)
    console.print(escape(f"{folder}: start with {folder / 'report.html'}"), soft_wrap=True, highlight=False)


def _files(found: Identification, delivered: Sequence[Deliverable]) -> Table:
    """Each file with its error as it was read back, and what it is for."""
    table, held = Table(box=SIMPLE), bool(found.held_out())
    for title in ("file", "fitted", "held out", "use it for"):
        table.add_column(title, justify="right" if title in ("fitted", "held out") else "left")
    for d in delivered:
        known = [d.errors and (held or not k) for k in (False, True)]
        errors = [f"{100 * d.relative(held_out=bool(k)):.2f} %" if yes else "-" for k, yes in enumerate(known)]
        seconds = f" ({duration_of_a_call(d.seconds)} a call)" if np.isfinite(d.seconds) else ""
        table.add_row(escape("\n".join(d.files) or f"({d.name})"), *errors, escape(d.use + seconds))
    return table


def _table(found: Identification) -> Table:
    judged = found.judged()
    table = Table(box=SIMPLE)
    for title in ("joint", "error", "% of its torque", "% of its limit"):
        table.add_column(title, justify="left" if title == "joint" else "right")
    for j, name in enumerate(found.joints):
        error, share = float(rmse(judged)[j]), float(relative_errors(judged)[j])
        limit = found.effort[j]
        table.add_row(
            escape(name), f"{significant(error)} {found.units[j]}", f"{100 * share:.1f}",
            f"{100 * error / limit:.2f}" if np.isfinite(limit) else "-",
        )  # fmt: skip
    return table
