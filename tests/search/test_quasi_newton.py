# SPDX-License-Identifier: Apache-2.0
"""The bounded quasi-Newton search follows bent valleys, holds at bounds, and resumes where it was."""

from __future__ import annotations

import json

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.errors import CalibrationError
from trueup.search.quasi_newton import QuasiNewton
from trueup.testing import check_search

Array = NDArray[np.float64]


def valley(points: Array) -> Array:
    """Rosenbrock's function in pairs of coordinates; its minimum is at 0.75 in each."""
    z = 4.0 * points - 2.0
    return (100.0 * (z[:, 1:] - z[:, :-1] ** 2) ** 2 + (1.0 - z[:, :-1]) ** 2).sum(axis=1)


def test_it_keeps_the_contract_of_searches() -> None:
    check_search(lambda start: QuasiNewton(start))


def test_a_bent_valley_is_followed_to_its_end() -> None:
    search, asked = QuasiNewton(np.full(8, 0.45)), 0
    while not search.done:
        candidates = search.ask()
        asked += len(candidates)
        search.tell(candidates, valley(candidates))
    assert np.allclose(search.best[0], 0.75, atol=1e-2)
    assert asked < 5000


def test_with_a_bound_in_the_way_it_finds_the_best_point_on_the_bound() -> None:
    target = np.array([1.4, 0.3, -0.2])
    mix = np.array([[1.0, 0.4, 0.0], [0.4, 2.0, 0.3], [0.0, 0.3, 1.0]])
    search = QuasiNewton(np.full(3, 0.5))
    while not search.done:
        candidates = search.ask()
        off = candidates - target
        search.tell(candidates, np.einsum("bi,ij,bj->b", off, mix, off))
    # with x0 = 1 and x2 = 0 held, the middle one solves 2 (x1 - 0.3) + 0.4 (1 - 1.4) + 0.3 (0 + 0.2) = 0
    assert np.allclose(search.best[0], [1.0, 0.35, 0.0], atol=1e-3)


@pytest.mark.parametrize("moment", [1, 2, 9])
def test_a_resumed_search_equals_an_uninterrupted_one(moment: int) -> None:
    whole = QuasiNewton(np.full(4, 0.4))
    for _ in range(moment):
        whole.tell(c := whole.ask(), valley(c))
    second = QuasiNewton(np.full(4, 0.4))
    second.resume(json.loads(json.dumps(whole.state())))
    for _ in range(6):
        a, b = whole.ask(), second.ask()
        assert np.array_equal(a, b)
        whole.tell(a, valley(a))
        second.tell(b, valley(b))
    with pytest.raises(CalibrationError, match="4 parameters, this one 3"):
        QuasiNewton(np.full(3, 0.4)).resume(whole.state())
