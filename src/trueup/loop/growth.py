# SPDX-License-Identifier: Apache-2.0
"""Stages of the search in which structures that wait enter, one by one, where left-out data want them."""

from __future__ import annotations

from trueup.loop.apart import apart
from trueup.loop.descent import SETTLED, Descent, Look
from trueup.loop.stages import Run
from trueup.loop.structures import Settle, grown, still_needed


def growth_apart(run: Run) -> None:
    """Structures that are searched `later` enter, one by one, while joints are replayed alone: a scan costs little there."""
    part = run.alone
    if not (run.later and run.begun) or part is None:
        return
    look = Look("growth", part, part, 2.0, 10)

    def settle(descent: Descent) -> None:  # what signals share stays: without contact it holds the scale of torque
        descent.point = apart(part, descent.space, [descent.point], descent.robust, SETTLED)
        descent.stay(look)

    run.descent.stay(look)
    _grow(run, look, settle, alone=True)


def growth(run: Run) -> None:
    """Structures that are searched `later` enter from the fit without them, one by one, where the evidence holds.

    Those that entered at a coarser step are asked about again at the real one: a limit may only have made up for what
    the step does to a drive that saturates.
    """
    look = run.look if run.looks else None
    if look is None or look.problem.duration < run.problem.duration:
        return
    if run.later:
        if run.descent.search is None or len(run.descent.search.point) != len(run.descent.point):
            run.descent.descend(look)  # something was left out since
        _grow(run, look, lambda descent: descent.descend(look) and None)
    elif run.descent.watch.entered and look.problem is run.problem:
        entered, run.descent.watch.entered = run.descent.watch.entered, {}
        for structure, names in entered.items():
            run.descent, note = still_needed(run.descent, look, structure, names)
            run.notes = [note if n.startswith(f"{structure} kept") else n for n in run.notes]


def _grow(run: Run, look: Look, settle: Settle, alone: bool = False) -> None:
    """Asks about all structures that wait."""
    later, run.later, run.descent.watch.waiting = run.later, {}, ()
    early = [run.values] if run.early is None else [run.early, run.values]
    watch, bare = run.descent.watch, run.descent.space.from_unit(run.descent.point)
    run.descent, notes = grown(run.descent, look, later, settle, early, alone)
    run.notes += notes
    if look.problem is not run.problem and not alone:
        free = {p.name for p in run.descent.space.parameters if not p.frozen}
        watch.entered = {structure: names for structure, d in later.items() if (names := sorted(free.intersection(d)))}
        watch.bare = bare.tolist()
