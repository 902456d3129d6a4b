# SPDX-License-Identifier: Apache-2.0
"""What `trueup excite` shows of a motion before the arm moves: how fast, how near, what it takes, what it will tell."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

import numpy as np
from rich.box import SIMPLE
from rich.console import Console
from rich.markup import escape
from rich.table import Column, Table

from trueup.arrays import Array
from trueup.commands.console import tell
from trueup.errors import listed
from trueup.samples import rms

if TYPE_CHECKING:
    from trueup.excitation.excite import Outcome
    from trueup.excitation.expectation import Expected
    from trueup.excitation.limits import JointLimits
    from trueup.excitation.problem import ExcitationProblem


def used_of_limits(problem: ExcitationProblem, outcome: Outcome) -> dict[str, Array]:
    """Field of the limits -> (n,) what the motion takes of it; no torque where the model has none."""
    t, torque = outcome.trajectory, problem.feasibility.torque(outcome.trajectory)
    used = {"lower": t.q.min(axis=0), "upper": t.q.max(axis=0)}
    used |= {"speed": np.abs(t.qd).max(axis=0), "acceleration": np.abs(t.qdd).max(axis=0)}
    if torque is not None:
        used |= {"torque": rms(torque), "peak": np.abs(torque).max(axis=0)}
    return used


def limits_table(problem: ExcitationProblem, outcome: Outcome) -> Table:
    """What this motion takes of what each joint may do, and where the limit comes from."""
    limits, used = problem.feasibility.limits, used_of_limits(problem, outcome)
    others = sorted({source for each in limits.sources.values() for source in each} - {"model"})
    letters = {source: chr(ord("a") + k) for k, source in enumerate(others)}
    said = "; ".join(f"{letter}: {source}" for source, letter in letters.items())
    heads = ("joint", "range", "speed", "acceler.", "rms torque", "peak torque")
    columns = [Column(head, overflow="fold") for head in heads]  # all is told on a narrow terminal, too
    title, caption = "taken / allowed, in rad, s, N m (m, N of slides)", f"{said}; others: model file" if said else None
    table = Table(*columns, box=SIMPLE, title=title, title_justify="left", caption=caption, caption_justify="left")
    for k, joint in enumerate(limits.joints):
        spans = (used["lower"], used["upper"]), (limits.lower, limits.upper)
        cells = ["/".join(f"{low[k]:.2g}..{high[k]:.2g}" for low, high in spans) + _mark(limits, "lower", k, letters)]
        for name in ("speed", "acceleration", "torque", "peak"):
            limit, value = float(limits.values()[name][k]), used[name][k] if name in used else float("nan")
            taken_of = _short(value) if np.isfinite(value) else "?"
            known = f"{taken_of}/{_short(limit)}{_mark(limits, name, k, letters)}"
            cells.append(known if np.isfinite(limit) else "not known")
        table.add_row(joint, *cells)
    return table


def _mark(limits: JointLimits, name: str, k: int, letters: dict[str, str]) -> str:
    sources = limits.sources.get(name) or limits.sources.get("torque")  # a peak that nobody gave is the nominal torque
    return "" if not sources or sources[k] == "model" else f" {letters[sources[k]]}"


def show(
    args: argparse.Namespace,
    problem: ExcitationProblem,
    outcome: Outcome,
    expected: tuple[Expected, ...],
    console: Console,
) -> None:
    """What a user wants to know before the arm moves: how fast, how near, what it will tell."""
    t, limits = outcome.trajectory, problem.feasibility.limits
    k = int(np.argmax(shares := 100.0 * np.abs(t.qd).max(axis=0) / limits.speed))
    near = f", clear of collision by {100 * outcome.clearance:.1f} cm ({outcome.nearest})" if outcome.nearest else ""
    lines = [
        f"{t.duration:.1f} s trajectory, reaches {shares[k]:.0f} % of speed limits ({t.joints[k]}){near}, "
        "starts and ends at rest",
    ]
    seen = [e for e in expected if e.percent <= args.percent]
    left = (
        f"as {args.after} left them" if args.after else "as fits of three real arms left them, 0.5 % of nominal torque"
    )
    lines.append(
        f"will identify {len(seen)} of {len(expected)} combinations better than {args.percent:g} % (errors of torque below "
        f"5 Hz {left})"
    )
    groups: dict[str, list[Expected]] = {}
    for e in expected:
        if e.percent > args.percent:
            groups.setdefault(e.advice, []).append(e)
    for advice, members in sorted(groups.items(), key=lambda item: -len(item[1])):
        shown = listed([f"{e.leading} {_percent(e.percent)}" for e in members])
        lines.append(f"not so well: {shown}" + (f"; {advice}" if advice else ""))
    if outcome.mix:
        lines.append(f"a mix of motions, which sees more than the best of one class: {outcome.mix}")
    slower = [f"1/{f:g}" for f in outcome.passes[1:] if f != 1.0]
    if len(outcome.passes) > 1:
        said = f" at {', '.join(slower)} of the speed" if slower else ""
        lines.append(f"{len(outcome.passes)} passes over the same path{said}, so that friction and inertia part")
    slides = np.asarray(problem.criterion.model.tree.prismatic).tolist()
    start = [f"{j} {v:.2f} {'m' if s else 'rad'}" for j, v, s in zip(t.joints, t.q[0], slides, strict=True)]
    lines.append(f"bring the arm to its start first: {', '.join(start)}")
    for line in lines:
        tell(console, f"  {escape(line)}")


def _percent(value: float) -> str:
    return "not at all" if value > 1000.0 else f"to {value:.0f} %"


def _short(value: float) -> str:
    return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.3g}"
