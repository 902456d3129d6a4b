# SPDX-License-Identifier: Apache-2.0
"""Stages of the search in which joints are searched one by one, where they are replayed alone."""

from __future__ import annotations

import numpy as np

from trueup.loop.apart import apart, confirmed, lowest_places
from trueup.loop.stages import Run

_DRAWS = 6  # places in the box from which each joint is searched, beside where the search begins and the middle
_KEPT = 3  # places, of those that the first seconds lead to, from which all seconds are searched


def each_apart(run: Run) -> None:
    """Each joint by itself where joints are replayed alone, from where the search begins, the middle of the box and places
    drawn from it: the first seconds from all, and all seconds from the best that these have led to. A drive that saturates,
    sticks and is damped has several valleys, and the last bits of one start decide which of them it finds.
    """
    part = run.alone
    if part is None or run.saved is not None:
        return
    descent, longest = run.descent, max(t.duration for t in run.first.trials)
    drawn = np.random.default_rng(run.seed).uniform(size=(_DRAWS, len(run.start)))
    starts = [run.start, np.full(len(run.start), 0.5), *drawn]
    best = lowest_places(part.shortened(longest), descent.space, starts, descent.robust, _KEPT)
    run.early = descent.space.from_unit(best[0])
    point = apart(part, descent.space, best, descent.robust)
    residual = part.residuals(descent.space.from_unit(point[None]))[0]
    descent.watch.saw("joint by joint", part, float(0.5 * residual @ residual), part.rmse(residual))
    descent.point, run.begun = point, True


def glance(run: Run) -> None:
    """Leaves approximations alone in this search where a glance by the simulator itself does not confirm them."""
    exact, descent = run.coarse.exactly(), run.descent
    if run.begun and not confirmed(exact, descent.space, run.start, descent.point, descent.robust):
        run.coarse, run.first = exact, exact.shortened(max(t.duration for t in run.first.trials))
        run.begun = False
        descent.restart(run.start)
