# SPDX-License-Identifier: Apache-2.0
"""CMA-ES finds minima of rough functions, and a resumed search is an uninterrupted one."""

from __future__ import annotations

import json

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.errors import CalibrationError
from trueup.search.cma_es import CmaEs
from trueup.testing import check_search

Array = NDArray[np.float64]


def rough(points: Array) -> Array:
    """Rastrigin's function about 0.35, scaled to the box."""
    z = 4.0 * (points - 0.35)
    return (z**2 - 0.3 * np.cos(4 * np.pi * z) + 0.3).sum(axis=1)


def test_it_keeps_the_contract_of_searches() -> None:
    check_search(lambda start: CmaEs(start, seed=1, max_evaluations=3000))


def test_a_rough_function_is_minimised() -> None:
    search = CmaEs(np.full(3, 0.9), seed=3, restarts=2, max_evaluations=8000)
    while not search.done:
        candidates = search.ask()
        search.tell(candidates, rough(candidates))
    assert np.allclose(search.best[0], 0.35, atol=0.02)


def test_a_single_parameter_is_searched_too() -> None:
    search = CmaEs(np.array([0.9]), seed=3, max_evaluations=600)
    while not search.done:
        candidates = search.ask()
        assert candidates.shape[1] == 1
        search.tell(candidates, rough(candidates))
    assert search.best[0] == pytest.approx(0.35, abs=0.02)


@pytest.mark.parametrize("moment", [1, 7, 40])
def test_a_resumed_search_equals_an_uninterrupted_one(moment: int) -> None:
    whole, first = (CmaEs(np.full(4, 0.5), seed=5, max_evaluations=1500) for _ in range(2))
    for _ in range(moment):
        first.tell(c := first.ask(), rough(c))
    second = CmaEs(np.full(4, 0.5), seed=5, max_evaluations=1500)
    second.resume(json.loads(json.dumps(first.state())))
    for _ in range(moment):
        whole.tell(c := whole.ask(), rough(c))
    for _ in range(20):
        a, b = whole.ask(), second.ask()
        assert np.array_equal(a, b)
        whole.tell(a, rough(a))
        second.tell(b, rough(b))
    assert whole.best[1] == second.best[1]


def test_another_problem_is_not_resumed() -> None:
    state = CmaEs(np.full(4, 0.5), seed=5).state()
    with pytest.raises(CalibrationError, match="another seed or other parameters"):
        CmaEs(np.full(3, 0.5), seed=5).resume(state)
