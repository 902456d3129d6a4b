# SPDX-License-Identifier: Apache-2.0
"""Where slopes do not lead from a first guess: laws of many structures searched anywhere within their bounds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from trueup.actuators.fit import WINDOWS, Found, Problem, widening
from trueup.arrays import Array
from trueup.parameters import Parameter, ParameterSpace
from trueup.search.evolution import Evolution

_EACH = 125  # evaluations for each parameter: they find the valley, least squares then its ground
_COARSE = 2.0  # times the step of the fit: near enough to tell valleys apart, in half the time


def anywhere(problem: Problem, parameters: Sequence[Parameter], fixed: Mapping[str, float]) -> Found:
    """A fit that begins where CMA-ES leads, by the mean absolute error of whole replays.

    A servo's structures explain one another's errors: a gain five times too high, with damping to match, follows slow
    commands as the right one does, and each structure by itself makes that worse; several at once, with other gains, do not.
    """
    space = ParameterSpace(tuple(parameters))
    coarse = Problem(problem.runs, _COARSE * problem.step, file=problem.file)
    # limits begin where nothing meets them
    start = [p.upper if p.name in _LIMITS else p.nominal for p in parameters]
    search = Evolution(space.to_unit(start), seed=0, most=_EACH * len(start))
    while not search.done:
        points = search.ask()
        search.tell(points, _errors(coarse, space, points, fixed))
    return widening(problem, parameters, {**fixed, **space.named(search.best[0][None])[0]}, WINDOWS[1:])


_LIMITS = ("full_error", "force_limit", "speed_limit", "acceleration_limit")


def _errors(problem: Problem, space: ParameterSpace, points: Array, fixed: Mapping[str, float]) -> Array:
    """(b,) mean absolute errors in rad, each run counting alike; inf where a replay fails."""
    errors = np.empty(len(points))
    for k, row in enumerate(space.named(points)):
        errors[k] = np.mean([np.mean(np.abs(problem.misses({**fixed, **row}, run))) for run in problem.runs])
    return np.where(np.isfinite(errors), errors, np.inf)
