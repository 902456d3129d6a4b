# SPDX-License-Identifier: Apache-2.0
"""Delays looked along before anything else is searched, where feet touch and let go.

Gains, damping and rotors of servos make up for a delay, and replays of contacts have cracks: slopes over a hair say nothing
of it there, and a search stays at about the delay that it began with, however wrong. A profile (D. J. Venzon and
S. H. Moolgavkar, Applied Statistics 37(1), 1988) has all else settle, kind by kind, at each delay, and is followed without
slopes (R. P. Brent, Algorithms for Minimization without Derivatives, 1973, 5).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize_scalar

from trueup.arrays import Array, Integers
from trueup.errors import RecordingError
from trueup.inspection.alignment import lag
from trueup.loop.alike import alike
from trueup.loop.elsewhere import losses_at
from trueup.loop.problem import Problem
from trueup.loop.stages import Run
from trueup.loop.windows import carried
from trueup.parameters import ParameterSpace
from trueup.recording import Recording
from trueup.trial import command_of, shared_joints


def behind(recordings: Sequence[Recording]) -> float:
    """By how many s positions lag behind what they are commanded, in the lower median of the recordings: a delay is a part
    of it, and the drives are the rest. 0 where no positions are commanded, or none follow.
    """
    lags = []
    for recording in recordings:
        command = command_of(recording)
        if command is None or not recording.has("position"):
            continue
        position = recording.channel("position")
        joints = shared_joints(command, position)
        try:
            lags.append(lag(command.select(joints), position.select(joints), hold=True) if joints else 0.0)
        except RecordingError:  # too short, or it does not move
            continue
    late = sorted(seconds for seconds in lags if seconds > 0.0)
    return late[(len(late) - 1) // 2] if late else 0.0


def along_delays(problem: Problem, space: ParameterSpace, point: Array, robust: float = 3.0) -> Array:
    """(n_free,) in the unit box, from `point`: where delays and all else lead along the profile of each delay, if that is
    lower by more than chance.
    """
    kinds, longest = space.kinds, behind(problem.recordings)
    free = [p for p in space.parameters if not p.frozen]
    for kind in dict.fromkeys(kinds.tolist()):
        own = np.flatnonzero(kinds == kind)
        first = free[int(own[0])]
        if first.unit == "s" and first.vanishes and first.scale != "log" and first.lower < longest:
            point = _Profile(problem, space, own, point, robust).followed(first.lower, min(longest, first.upper))
    return point


class _Profile:
    """What replays cost with a delay held here and there, and all else settled."""

    def __init__(self, problem: Problem, space: ParameterSpace, own: Integers, point: Array, robust: float) -> None:
        self._problem, self._space, self._own, self._robust = problem, space, own, robust
        """`own` (k,): which of the free parameters are held as one."""
        self._free = [p for p in space.parameters if not p.frozen]
        self._seen = [(float(np.mean(self._seconds(point))), float(losses_at(problem, space, point[None])[0]), point)]
        """Delay in s, loss and place in the unit box (n_free,)."""

    def followed(self, lower: float, upper: float) -> Array:
        """(n_free,) where its lowest place leads, to a step of the simulation; where it began if that is no lower."""
        (_, begun, start), step = self._seen[0], self._problem.simulator.step
        minimize_scalar(self._at, bounds=(lower, upper), method="bounded", options={"xatol": step})
        _, loss, best = min(self._seen, key=lambda seen: seen[1])
        residual = self._problem.residuals(self._space.from_unit(start[None]))[0]
        if not loss < begun - self._problem.chance(residual):
            return start
        return alike(self._problem, self._space, best, self._robust)

    def _seconds(self, point: Array) -> Array:
        return self._space.from_unit(point)[self._space.free][self._own]

    def _at(self, seconds: float) -> float:
        """The loss with the delay held, from the nearest of the places where all else has settled already."""
        _, _, near = min(self._seen, key=lambda seen: abs(seen[0] - seconds))
        delays = {self._free[k].name: seconds for k in self._own}
        values = self._space.from_unit(near)
        values[np.flatnonzero(self._space.free)[self._own]] = seconds
        space, point = self._space.freeze(delays, delays), self._space.to_unit(values)
        others = np.setdiff1d(np.arange(len(point)), self._own)
        if len(others):
            point[others] = alike(self._problem, space, point[others], self._robust)
        loss = float(losses_at(self._problem, self._space, point[None])[0])
        self._seen.append((seconds, loss, point))
        return loss


def delays(run: Run) -> None:
    """Delays of what stands on a floor by itself, after all was searched kind by kind."""
    descent, look = run.descent, run.first
    if run.begun or run.looks or run.resumed or run.saved is not None or not carried(run.problem):
        return
    point = along_delays(look, descent.space, descent.point, descent.robust)
    if point is not descent.point:
        residual = look.residuals(descent.space.from_unit(point[None]))[0]
        descent.watch.saw("along delays", look, float(0.5 * residual @ residual), look.rmse(residual))
        descent.restart(point)
