# SPDX-License-Identifier: Apache-2.0
"""Slopes over a stretch: where residuals have a crack every thousandth of the box, steps by them arrive all the same."""

from __future__ import annotations

import numpy as np

from trueup.arrays import Array
from trueup.loop.problem import Problem
from trueup.loop.weighing import Weighed, axes_of, curvature_of, design
from trueup.parameters import Parameter, ParameterSpace
from trueup.search.least_squares import LeastSquares

SPACE = ParameterSpace(tuple(Parameter(f"p{k}", "", 0.5, 0.0, 1.0) for k in range(6)))
TRUTH = np.array([0.45, 0.52, 0.5, 0.55, 0.48, 0.51])


class Cracked(Problem):
    """Residuals on slopes of which one combination shows little; every replay touches somewhere else."""

    def __init__(self) -> None:
        rng = np.random.default_rng(0)
        along, _ = np.linalg.qr(rng.normal(size=(6, 6)))
        self.slopes = rng.normal(size=(400, 6)) @ (along * [30.0, 30.0, 20.0, 10.0, 10.0, 2.0]) @ along.T
        self._touches, self._size = rng.normal(size=(400, 6)), 0.3 * rng.normal(size=400)

    def residuals(self, values: Array, only: object = None) -> Array:
        away = np.atleast_2d(values) - TRUTH
        touched = np.floor(300.0 * away @ self._touches.T) - np.floor(-300.0 * TRUTH @ self._touches.T)
        return away @ self.slopes.T + self._size * np.sin(touched)


def test_columns_of_a_design_are_orthogonal_and_of_mean_square_one() -> None:
    for count in (1, 5, 12):
        columns = design(count, np.random.default_rng(1))
        np.testing.assert_allclose(columns.T @ columns, (count + 1) * np.eye(count), atol=1e-9)
        np.testing.assert_allclose(columns.sum(axis=0), 0.0, atol=1e-9)


def test_steps_by_what_is_weighed_together_arrive_where_single_cracks_hold_differences() -> None:
    problem, start, rng = Cracked(), np.full(6, 0.5), np.random.default_rng(2)
    hair = LeastSquares(start, np.zeros(6), difference=1e-4)
    while not hair.done:
        asked = hair.ask()
        hair.tell(asked, problem.residuals(asked))
    unit, axes = start, axes_of(curvature_of(problem.slopes, np.ones(400)))
    for _ in range(6):
        weighed = Weighed.around(problem, SPACE, unit, axes, 3.5, rng)
        axes, unit = axes_of(weighed.curvature), weighed.step()
    off, held = (np.abs(where - TRUTH).max() for where in (unit, hair.best[0]))
    assert off < held / 3.0
