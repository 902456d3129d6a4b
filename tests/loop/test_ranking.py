# SPDX-License-Identifier: Apache-2.0
"""Rank correlations agree with scipy's, and their interval covers what it says it covers."""

from __future__ import annotations

import math
from itertools import permutations

import numpy as np
import pytest
from scipy.stats import kendalltau, spearmanr

from trueup.loop.ranking import agreement


@pytest.mark.parametrize("count", [3, 5, 9])
def test_both_correlations_agree_with_an_independent_implementation(count: int, rng: np.random.Generator) -> None:
    for _ in range(20):
        a, b = rng.standard_normal((2, count))
        found = agreement(a, b)
        assert found.tau == pytest.approx(kendalltau(a, b)[0])
        assert found.spearman == pytest.approx(spearmanr(a, b)[0])


def test_unknown_scores_are_left_out_and_one_alone_says_nothing() -> None:
    assert agreement([1, 2, math.nan, 3], [1, 2, 0, 3]) == agreement([1, 2, 3], [1, 2, 3])
    assert math.isnan(agreement([1.0, math.nan], [1.0, 2.0]).tau)


def test_three_in_the_right_order_are_no_proof() -> None:
    found = agreement([1, 2, 3], [4, 5, 6])
    assert found.tau == 1.0
    assert found.low < -0.4
    assert found.high == pytest.approx(1.0)


@pytest.mark.parametrize("theta", [-0.4, 0.0, 0.7, 1.5])
def test_the_interval_covers_the_expected_tau_in_nineteen_of_twenty_cases(theta: float) -> None:
    """Every order of five candidates, each with its chance under a Mallows model of known strength."""
    count = 5
    pairs = count * (count - 1) // 2
    orders = list(permutations(range(count)))
    discordant = np.array([sum(p[i] > p[j] for i in range(count) for j in range(i + 1, count)) for p in orders])
    chances = np.exp(-theta * discordant)
    chances /= chances.sum()
    truth = 1.0 - 2.0 * float(chances @ discordant) / pairs
    found = [agreement(range(count), p) for p in orders]
    covered = sum(c for c, f in zip(chances, found, strict=True) if f.low <= truth <= f.high)
    assert covered >= 0.95
