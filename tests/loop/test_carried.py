# SPDX-License-Identifier: Apache-2.0
"""Slopes of a fit are those of the next one, whose space is wider or narrower, for the price of what is new in it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from trueup.discrepancies.weighted import Weighted
from trueup.engines.simulator import Simulator
from trueup.loop.carried import carry
from trueup.loop.descent import Descent, Fit, Watch, last_look
from trueup.loop.problem import Problem
from trueup.parameters import Parameter, ParameterSpace
from trueup.recording import Channel, Recording

Array = NDArray[np.float64]
TIME = np.linspace(0.0, 4.0, 401)
NAMES = ("a", "b", "c", "d")
SPACE = ParameterSpace(tuple(Parameter(name, "rad", 0.5, 0.0, 1.0) for name in NAMES))


def waves(time: Array, values: Array, step: float) -> Array:
    return sum(v * np.sin((2.0 + k) * time) for k, v in enumerate(values)) + 0.1 * values[0] * values[1]


def settled(problem: Problem, space: ParameterSpace) -> tuple[Descent, Fit]:
    run, look = Descent(space, np.full(int(space.free.sum()), 0.45), Watch(), 3.0), last_look(problem, problem)
    run.descend(look)
    return run, run.finished(look)


def test_only_columns_of_new_parameters_are_simulated(
    formula: Callable[[Callable[[Array, Array, float], Array], ParameterSpace], Simulator],
) -> None:
    measured = waves(TIME, np.array([0.3, 0.6, 0.2, 0.7]), 0.01)[:, None]
    measured += 1e-3 * np.random.default_rng(0).standard_normal(measured.shape)
    recording = Recording("made", {"position": Channel("position", ("joint",), "rad", TIME, measured)})
    weights = Weighted.estimated([recording], ["position"])
    problem = Problem(formula(waves, SPACE), [recording], weights, ("position",))
    look, (whole, known) = last_look(problem, problem), settled(problem, SPACE)
    _, without = settled(problem, SPACE.freeze(["c"]))
    begun, narrow = problem.evaluations, Descent(SPACE.freeze(["c"]), known.unit[[0, 1, 3]], Watch(), 3.0)
    carry(narrow, look, known)
    assert problem.evaluations == begun
    assert narrow._slopes is not None
    np.testing.assert_array_equal(narrow._slopes, known.jacobian[:, [0, 1, 3]])
    wide = Descent(SPACE, np.insert(without.unit, 2, 0.5), Watch(), 3.0)
    carry(wide, look, without)
    assert problem.evaluations == begun + 2  # the point, and a step along the new axis
    assert wide._slopes is not None
    np.testing.assert_allclose(wide._slopes[:, 2], known.jacobian[:, 2], rtol=1e-6)
    np.testing.assert_allclose(wide.descend(look).point, whole.point, atol=1e-3)
