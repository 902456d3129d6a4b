# SPDX-License-Identifier: Apache-2.0
"""Intervals of limits, by the loss along them: slopes say nothing of a limit that is hardly met, and too much at one that is.

A limit that a drive runs into has an end on both sides; of one that it does not, or hardly, the recordings tell how low it
would have to be to be seen, and nothing above (profile likelihood: S. A. Murphy, A. W. van der Vaart, JASA 95, 2000).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.calibration import NORMAL_95
from trueup.loop.descent import Fit
from trueup.loop.problem import Problem
from trueup.loop.validate import settled_loss
from trueup.parameters import Parameter

_APART = 0.01 * 2.0 ** np.arange(8)  # shares of the box: how far along a limit losses are looked at, to either side


@dataclass(frozen=True)
class Seen:
    """Between which values a limit may be, in its unit, and how that is put in words."""

    low: float
    high: float
    word: str
    note: str


def is_limit(p: Parameter) -> bool:
    """Whether more of it than some size is as if there were none."""
    return p.absent is not None and p.absent >= p.upper


def limits_seen(problem: Problem, fit: Fit) -> Mapping[str, Seen]:
    """What is seen of each free limit, by name, all other parameters settled around each place as slopes foretell it."""
    problem = (
        fit.near or problem.at_level(fit.values, fit.residual) or problem
    )  # the engine takes minutes where others do
    free = [p for p in fit.space.parameters if not p.frozen]
    worth = NORMAL_95**2 * problem.chance(fit.residual)
    found = {}
    for k, p in enumerate(free):
        if is_limit(p):
            steps = np.concatenate([-_APART[::-1], [0.0], _APART])
            places = np.unique(np.clip(fit.unit[k] + steps, 0.0, 1.0))
            rows = np.repeat(fit.unit[None], len(places), axis=0)
            rows[:, k] = places
            others = np.arange(len(free)) != k
            residuals = problem.residuals(fit.space.from_unit(rows))
            losses = np.array([settled_loss(fit, np.arange(len(r)), np.flatnonzero(others), r) for r in residuals])
            rise = losses - losses[int(np.searchsorted(places, fit.unit[k]))]
            ends = [_end(places, rise, fit.unit[k], worth, side) for side in (-1, 1)]
            rows = np.repeat(fit.unit[None], 2, axis=0)
            rows[:, k] = ends[0] or 0.0, 1.0 if ends[1] is None else ends[1]
            low, high = fit.space.from_unit(rows)[:, fit.space.index(p.name)].tolist()
            found[p.name] = _in_words(p, max(low, p.lower), min(high, p.upper), ends)
    return found


def _in_words(p: Parameter, low: float, high: float, ends: list[float | None]) -> Seen:
    advice = f"; {p.shown_by} would show it" if p.shown_by else ""
    if ends == [None, None]:
        return Seen(low, high, "no effect", f"never met in these recordings{advice}")
    if ends[1] is None:
        return Seen(low, high, "weak", f"hardly met in these recordings: {low:.3g} {p.unit} or more{advice}")
    if ends[0] is None:
        return Seen(low, high, "weak", f"no more than {high:.3g} {p.unit}; how much less is not seen")
    return Seen(low, high, "identified", "")


def _end(places: Array, rise: Array, at: float, worth: float, side: int) -> float | None:
    """Where the loss has risen by `worth`, going to one side, between the places (P,) looked at; None where it never does."""
    beyond = places * side >= at * side
    along, up = places[beyond][::side], rise[beyond][::side]
    over = np.flatnonzero(~(up <= worth))
    if not len(over):
        return None
    first = int(over[0])
    if first == 0 or not np.isfinite(up[first]):
        return float(along[first])
    before = max(up[first - 1], 0.0)
    share = (worth - before) / (up[first] - before)
    # Beside the optimum the loss is a parabola, further on nearly a line between the places.
    return float(along[first - 1] + (np.sqrt(share) if first == 1 else share) * (along[first] - along[first - 1]))
