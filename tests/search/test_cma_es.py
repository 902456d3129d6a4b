# SPDX-License-Identifier: Apache-2.0
"""CMA-ES finds minima of rough functions, and a resumed search is an uninterrupted one."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.errors import CalibrationError, UnknownNameError
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


def funnels(points: Array) -> Array:
    """A wide funnel about 0.25 whose floor is at 1, and a narrow one about 0.8 that leads to 0."""
    wide, narrow = (np.sqrt(((points - c) ** 2).mean(axis=1)) for c in (0.25, 0.8))
    return np.minimum(1.0 + 2.0 * wide, 5.0 * narrow)


@pytest.mark.parametrize("regime", ["ipop", "bipop"])
def test_restarts_find_the_narrow_funnel_that_one_long_run_misses(regime: str) -> None:
    def found(**options: Any) -> int:
        count = 0
        for seed in range(6):
            search = CmaEs(np.full(4, 0.3), seed=seed, sigma=0.1, max_evaluations=2500, **options)
            while not search.done:
                search.tell(c := search.ask(), funnels(c))
            count += search.best[1] < 0.1
        return count

    assert found(restarts=0) == 0
    assert found(restarts=20, generations=30, regime=regime) >= 4


def test_a_run_may_be_cut_after_some_generations_and_says_so() -> None:
    search = CmaEs(np.full(3, 0.9), seed=0, restarts=1, generations=5, population=8)
    sizes = []
    while not search.done:
        search.tell(c := search.ask(), rough(c))
        sizes.append(len(c))
    assert sizes == [8] * 5 + [16] * 5
    assert search.done.startswith("stopped after 5 generations")
    with pytest.raises(UnknownNameError, match=r"regime 'often'.*bipop, ipop"):
        CmaEs(np.full(3, 0.9), seed=0, regime="often")


@pytest.mark.parametrize("moment", [1, 7, 40])
def test_a_resumed_search_equals_an_uninterrupted_one(moment: int) -> None:
    options: dict[str, Any] = {"seed": 5, "max_evaluations": 1500, "restarts": 5, "generations": 15, "regime": "bipop"}
    whole, first = (CmaEs(np.full(4, 0.5), **options) for _ in range(2))
    for _ in range(moment):
        first.tell(c := first.ask(), rough(c))
    second = CmaEs(np.full(4, 0.5), **options)
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
