# SPDX-License-Identifier: Apache-2.0
"""The genetic algorithm reaches known optima, never loses its fittest, and resumes as if never interrupted."""

from __future__ import annotations

import json

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.errors import CalibrationError
from trueup.search.genetic import Genetic
from trueup.testing import check_search

Array = NDArray[np.float64]


def rough(points: Array) -> Array:
    """Rastrigin's function about 0.35, scaled to the box."""
    z = 4.0 * (points - 0.35)
    return (z**2 - 0.3 * np.cos(4 * np.pi * z) + 0.3).sum(axis=1)


def test_it_keeps_the_contract_of_searches() -> None:
    check_search(lambda start: Genetic(start, seed=1))


def test_a_rough_function_is_minimised() -> None:
    search = Genetic(np.full(10, 0.9), seed=3)
    while not search.done:
        candidates = search.ask()
        search.tell(candidates, rough(candidates))
    assert np.allclose(search.best[0], 0.35, atol=0.02)


def test_the_fittest_is_never_lost_though_all_its_children_die() -> None:
    search = Genetic(np.full(4, 0.5), seed=4, population=20, generations=30)
    search.tell(c := search.ask(), rough(c))
    fittest, loss = search.best
    for _ in range(5):
        search.tell(c := search.ask(), np.full(len(c), np.nan))
    assert search.best[1] == loss
    assert np.array_equal(search.best[0], fittest)


@pytest.mark.parametrize("moment", [0, 1, 12])
def test_a_resumed_search_equals_an_uninterrupted_one(moment: int) -> None:
    whole, second = (Genetic(np.full(4, 0.5), seed=5, population=30) for _ in range(2))
    for _ in range(moment):
        whole.tell(c := whole.ask(), rough(c))
    second.resume(json.loads(json.dumps(whole.state())))
    for _ in range(10):
        a, b = whole.ask(), second.ask()
        assert np.array_equal(a, b)
        whole.tell(a, rough(a))
        second.tell(b, rough(b))
    assert whole.best[1] == second.best[1]


def test_another_problem_is_not_resumed() -> None:
    search = Genetic(np.full(4, 0.5), seed=5, population=10)
    search.tell(c := search.ask(), rough(c))
    with pytest.raises(CalibrationError, match="another seed or other parameters"):
        Genetic(np.full(3, 0.5), seed=5).resume(search.state())
