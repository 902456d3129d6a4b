# SPDX-License-Identifier: Apache-2.0
"""The stage of a search in which start states and all else are searched in turns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from trueup.arrays import Array
from trueup.loop.descent import last_look
from trueup.loop.elsewhere import along_axes
from trueup.loop.problem import Problem
from trueup.loop.shoot import LONGER, SHORTEST, Ahead, Starts
from trueup.loop.stages import Run
from trueup.loop.uncertainty import start_scatter, unit_covariance
from trueup.loop.windows import carried
from trueup.search.robust import robust_losses


def multiple_shooting(run: Run) -> None:
    """Start states become parameters with their measured noise, in turns with all else, where they matter.

    Where noise at the starts moves the estimates by less than all else leaves them unsure, it is added to that. What goes on
    from slopes over a stretch goes on by these (`weighing.py`).
    """
    if run.weighed is not None:
        return
    values, starts = run.descent.space.from_unit(run.descent.point), run.starts
    if starts is not None:
        return _in_turns(run, starts, values, None)
    starts = Starts.as_measured(run.smooth, values)
    ahead = starts.ahead(run.smooth, values)
    begun = starts.eliminated_from(run.smooth, values, bent=False, ahead=ahead)
    if not _matter(run, begun):
        return
    before, problem, coarse, descent = run.fit, run.problem, run.coarse, replace(run.descent)
    scatter = start_scatter(problem.with_starts(begun.trials, begun.eliminated), before)
    _in_turns(run, starts, values, ahead)
    # With starts free the loss is no higher where slopes foretell it; where contacts make replays rugged, they do not.
    if not run.fit.loss <= before.loss:
        run.problem, run.coarse, run.descent, run.ended = problem, coarse, descent, replace(before, scatter=scatter)


def _in_turns(run: Run, starts: Starts, values: Array, ahead: Ahead | None) -> None:
    """Corrections of starts and the search of all else, until these move by no more than chance."""
    rounds = 4  # of corrections of the starts, each of which halves what slopes do not foretell
    for left in reversed(range(rounds)):
        begun, ahead = starts.eliminated_from(run.smooth, values, ahead=ahead), None
        coarse, shot = (p.with_starts(begun.trials, begun.eliminated) for p in (run.coarse, run.problem))
        run.problem, run.coarse, run.ended = shot, shot if run.coarse is run.problem else coarse, None
        look = last_look(run.problem, run.coarse)
        run.go(replace(look, tolerance=1.0))  # no further than chance leads: corrections of starts will move it on
        values = run.descent.space.from_unit(run.descent.point)
        starts, surprise = starts.corrected(run.smooth, values)
        if surprise < run.problem.chance(run.fit.residual) * len(run.descent.point):
            break
        # Elimination takes replays to be smooth in their starts, and they are not; windows are short for that reason.
        if left == rounds - 1 and not run.problem.windowed:
            starts, values = _lower_by_horizon(run, starts, values)
    run.ended = None
    run.go(last_look(run.problem, run.coarse))
    # Starts moved further than their noise: it is not all that is wrong there (R. T. Birge, Phys. Rev. 40, 1932).
    ratio = max(1.0, float(np.mean(starts.amounts**2)))
    scatter = (ratio - 1.0) * unit_covariance(run.problem, run.fit)
    run.ended = replace(run.fit, scatter=scatter, starts=starts, shot=run.problem)


def _lower_by_horizon(run: Run, starts: Starts, values: Array) -> tuple[Starts, Array]:
    """What `_by_horizon` leads to, if that is lower: the valley of a first part may end high up in the whole."""
    point, before = run.descent.point, run.fit.loss
    led, there = _by_horizon(run, starts)
    residual = led.eliminated_from(run.smooth, there).residuals(there[None])
    if float(np.nan_to_num(robust_losses(residual, run.fit.bend), nan=np.inf)[0]) < before:
        return led, there
    run.descent.move(point)
    return starts, values


def _by_horizon(run: Run, starts: Starts) -> tuple[Starts, Array]:
    """Starts and values (n,) searched on the first part of the replays, which little but the starts decides, then on longer
    parts, to the end: what one part has told is near to where the next is smooth, where contacts make all at once rugged.
    """
    descent, longest, length = run.descent, max(t.duration for t in run.problem.trials), SHORTEST
    starts = replace(starts, amounts=np.zeros_like(starts.amounts))
    while True:
        part, own = starts.first(run.smooth, length)
        for wide in (True, False):  # slopes over what measurements leave open of starts, then over what replays do
            own = own.as_wide() if wide else own
            begun = own.eliminated_from(part, descent.space.from_unit(descent.point), bent=False)
            descent.move(descent.point)
            found = descent.descend(replace(last_look(begun, begun), tolerance=5.0, most=15, last=False))
            # The first instants of a contact tell so little of friction that a step may leave it where a foot sticks, from
            # where no slope leads back when a longer part shows that it slides.
            lower = along_axes(begun, descent.space, found, begun) if wide and carried(run.problem) else None
            if lower is not None:
                descent.move(lower)
            values = descent.space.from_unit(descent.point)
            own, _ = own.corrected(begun, values)
        starts = replace(own, measured=starts.measured)
        if length >= longest:
            return starts, values
        length *= LONGER


def _matter(run: Run, begun: Problem) -> bool:
    """Whether starts, of which first corrections are eliminated, leave estimates as unsure as all else does; a scatter of the
    fit where they do not.
    """
    if not begun.eliminated:
        return False
    fit = run.fit
    scatter = start_scatter(run.problem.with_starts(begun.trials, begun.eliminated), fit)
    matter = not np.all(np.diag(scatter) < np.diag(unit_covariance(run.problem, fit)))
    if not matter:
        run.ended = replace(fit, scatter=scatter)
    return matter
