# SPDX-License-Identifier: Apache-2.0
"""The summary of an identification for a terminal: how well torque is predicted, on what, and what was not seen."""

from __future__ import annotations

from collections import Counter

import numpy as np
from rich.box import SIMPLE
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from trueup.identification.estimation.result import Identification, relative_error, relative_errors, rmse
from trueup.report.numbers import duration_text, significant


def show_identification(found: Identification, console: Console, *, quiet: bool = False) -> None:
    """Prints warnings, errors by joint, what was kept and what could not be told."""
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
    if found.links:
        line += f", {100 * relative_error(judged, 'consistent'):.2f} % with bodies that can exist"
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


def _table(found: Identification) -> Table:
    judged = found.judged()
    table = Table(box=SIMPLE)
    for title in ("joint", "error", "% of its torque", "% of its limit", "friction"):
        table.add_column(title, justify="left" if title in ("joint", "friction") else "right")
    for j, name in enumerate(found.joints):
        error, share = float(rmse(judged)[j]), float(relative_errors(judged)[j])
        limit = found.effort[j]
        friction = f"{significant(found.simple_friction[j, 0])} + {significant(found.simple_friction[j, 1])} v"
        table.add_row(
            escape(name), f"{significant(error)} {found.units[j]}", f"{100 * share:.1f}",
            f"{100 * error / limit:.2f}" if np.isfinite(limit) else "-", friction,
        )  # fmt: skip
    return table
