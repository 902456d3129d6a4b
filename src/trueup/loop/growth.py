# SPDX-License-Identifier: Apache-2.0
"""A stage of the search: structures that wait enter one by one, where left-out data want them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from trueup.loop.descent import Descent, Fit, Watch
from trueup.loop.selection import compared, told
from trueup.loop.stages import Run
from trueup.loop.validate import by_stretch, left_out_errors
from trueup.parameters import Parameter, ParameterSpace
from trueup.search.robust import robust_losses


def growth(run: Run) -> None:
    """Structures that are searched `later` enter from the fit without them, one by one, where the evidence holds.

    Begun with, they may bend the whole fit and lead it astray (forward selection: M. A. Efroymson, 1960).
    """
    if not run.later or not run.looks or run.look.problem.duration < run.problem.duration:
        return
    later, run.later = run.later, {}
    if run.descent.search is None or len(run.descent.search.point) != len(run.descent.point):
        run.descent.descend(run.look)  # something was left out since
    blocks = by_stretch(run.look.problem)
    without = run.descent.finished(run.look)
    errors = left_out_errors(run.look.problem, without, blocks)
    for structure, declared in later.items():
        grown = _grown(run, without, declared)
        with_it = grown.finished(run.look)
        lower = left_out_errors(run.look.problem, with_it, blocks)
        shown = compared(errors, lower)
        run.notes.append(told(structure, shown))
        if shown.holds:
            grown.watch, run.descent, without, errors = run.descent.watch, grown, with_it, lower


def _grown(run: Run, without: Fit, declared: Mapping[str, Parameter]) -> Descent:
    """Where least squares lead with a structure, the lower of two: from none of it, and from the middle of its range, where
    the other parameters settle first. What it explains another parameter may have taken, and a ridge lie between.
    """
    space = _thawed(run.descent.space, declared)
    entering = np.array([n in declared for n in space.names])
    middle = np.where(entering, space.from_unit(np.full(int(space.free.sum()), 0.5)), without.values)
    settled = replace(run.descent, space=space.freeze(list(declared), dict(zip(declared, middle[entering], strict=True))),
                      watch=Watch(), search=None)  # fmt: skip
    settled.restart(without.unit)
    settled.descend(replace(run.look, tolerance=1.0, last=False), confirm=False)
    middle = np.where(entering, middle, settled.space.from_unit(settled.point))
    tried = []
    for values in (np.where(entering, space.nominal, without.values), middle):
        grown = replace(run.descent, space=space, watch=Watch(), search=None)
        grown.restart(np.clip(space.to_unit(values), 0.0, 1.0))
        grown.descend(run.look)
        tried.append(grown)
    return min(tried, key=lambda g: robust_losses(g.finished(run.look).residual[None], without.bend)[0])


def _thawed(space: ParameterSpace, declared: Mapping[str, Parameter]) -> ParameterSpace:
    return ParameterSpace(tuple(declared.get(p.name, p) for p in space.parameters))
