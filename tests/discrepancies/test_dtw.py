# SPDX-License-Identifier: Apache-2.0
"""The warping is that of the plain quadratic recursion, its path costs what it says, and memory stays small."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from trueup.discrepancies.dtw import dtw, dtw_path
from trueup.errors import RecordingError

Array = NDArray[np.float64]


def by_recursion(a: Array, b: Array, band: float, squared: bool) -> float:
    """Sakoe and Chiba's recursion, cell by cell."""
    n, m = len(a), len(b)
    total = np.full((n + 1, m + 1), np.inf)
    total[0, 0] = 0.0
    slope = (m - 1) / (n - 1) if n > 1 else 1.0
    width = max(band * (m - 1), (1 + slope) / 2 if n != m else 0.0) + 1e-9 * (1 + slope)
    for i in range(n):
        for j in range(m):
            if min(n, m) == 1 or band >= 1 or abs(j - i * slope) <= width:
                cost = float(((a[i] - b[j]) ** 2).sum())
                before = min(total[i, j], total[i, j + 1], total[i + 1, j])
                total[i + 1, j + 1] = before + (cost if squared else cost**0.5)
    return float(total[n, m])


def walks(seed: int, n: int, m: int, d: int) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(n, d)).cumsum(axis=0), rng.normal(size=(m, d)).cumsum(axis=0)


@settings(max_examples=150, deadline=None)
@given(
    seed=st.integers(0, 10**6), n=st.integers(1, 60), m=st.integers(1, 60), d=st.integers(1, 3),
    band=st.sampled_from([0.0, 0.05, 0.1, 0.4, 1.0]), squared=st.booleans(), equal=st.booleans(),
)  # fmt: skip
def test_it_is_the_quadratic_recursion(
    seed: int, n: int, m: int, d: int, band: float, squared: bool, equal: bool
) -> None:
    a, b = walks(seed, n, n if equal else m, d)
    expected = by_recursion(a, b, band, squared)
    assert dtw(a, b, band=band, squared=squared) == pytest.approx(expected, rel=1e-12)
    cost, pairs = dtw_path(a, b, band=band, squared=squared)
    assert cost == dtw(a, b, band=band, squared=squared)
    squares = ((a[pairs[:, 0]] - b[pairs[:, 1]]) ** 2).sum(axis=1)
    assert (squares if squared else np.sqrt(squares)).sum() == pytest.approx(expected, rel=1e-9)
    steps = {tuple(step) for step in np.diff(pairs, axis=0).tolist()}
    assert steps <= {(0, 1), (1, 0), (1, 1)}
    assert pairs[0].tolist() == [0, 0]
    assert pairs[-1].tolist() == [len(a) - 1, len(b) - 1]


def test_it_does_not_matter_which_path_comes_first() -> None:
    a, b = walks(1, 300, 170, 2)
    assert dtw(a, b) == pytest.approx(dtw(b, a), rel=1e-12)


def test_a_path_driven_at_another_speed_is_the_same_path() -> None:
    place = np.linspace(0.0, 1.0, 400)
    curve = lambda s: np.stack([np.cos(6 * s), np.sin(4 * s)], axis=1)  # noqa: E731
    assert dtw(curve(place), curve(place**1.3)) / 400 < 5e-3
    assert np.linalg.norm(curve(place) - curve(place**1.3), axis=1).mean() > 0.2


def test_a_long_path_is_traced_in_little_memory() -> None:
    a, b = walks(2, 8500, 8500, 2)
    dtw_path(a[:50], b[:50])
    tracemalloc.start()
    dtw_path(a, b)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 8e6  # the band alone has 14 million cells


@pytest.mark.parametrize(
    ("a", "b", "said"),
    [
        (np.zeros((0, 2)), np.zeros((3, 2)), "first path has shape"),
        (np.zeros((3, 2)), np.array([[0, 0], [np.nan, 1]]), "point 1 of the second path is"),
        (np.zeros((3, 2)), np.zeros(3), "2 and 1 dimensions"),
    ],
)
def test_what_cannot_be_compared_is_named(a: Array, b: Array, said: str) -> None:
    with pytest.raises(RecordingError, match=said):
        dtw(a, b)
