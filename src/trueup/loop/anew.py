# SPDX-License-Identifier: Apache-2.0
"""Replays that are far off from some instant on: something acted on the robot, or they parted for good on their own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from trueup.inspection.released import LONG
from trueup.loop.descent import Look
from trueup.loop.disturbed import Deviation, LeftOut, deviations_of, disturbed
from trueup.loop.shoot import LONGER
from trueup.loop.stages import Run
from trueup.loop.windows import in_windows

ANEW = "begun anew"


def undisturbed(run: Run) -> None:
    """Whether something acted on the robot, as soon as all recordings were looked at."""
    if _all_looked_at(run):
        run.disturbed = disturbed(*_deviations(run))


def begun_anew(run: Run) -> None:
    """Where replays part for good although nothing acted on the robot: how long they may be without that.

    No slope leads from a pole that went over the top to one that did not, and a model that is a little off parts there with
    any values. Replays that begin anew every so often have not parted yet (H. G. Bock, Recent advances in parameter
    identification techniques for o.d.e., 1983): from where the search is it goes through these, first as often as one stretch
    of a recording is told from the next, then ever less, until some part. The search ends there, to be begun anew in windows
    of what went before.
    """
    if not _all_looked_at(run):
        return
    every, anew = _deviations(run)
    if not disturbed(every).gaps or disturbed(every, anew).gaps:
        return
    descent, length, longest = replace(run.descent), LONG, max(t.duration for t in run.coarse.trials)
    descent.restart(descent.point)
    while length < longest:
        part = in_windows(run.coarse, length)
        look = Look(ANEW, part, part, 5.0, 15)
        descent.descend(look)
        if disturbed(deviations_of(part, descent.space.from_unit(descent.point))).gaps:
            break
        run.descent, run.look, run.disturbed = replace(descent), look, LeftOut(lasting=length)
        length *= LONGER


def _all_looked_at(run: Run) -> bool:
    return bool(run.looks) and run.look.problem.duration >= run.problem.duration


def _deviations(run: Run) -> tuple[list[Deviation], Callable[[], list[Deviation]]]:
    """How far joints are off where the search is, and a look at that in replays that begin anew every so often."""
    problem, values = run.look.problem, run.descent.space.from_unit(run.descent.point)
    return deviations_of(problem, values), lambda: deviations_of(in_windows(problem, LONG), values)
