# SPDX-License-Identifier: Apache-2.0
"""What few runs of many candidates say of each is right on average, and nearer than its own count."""

from __future__ import annotations

import numpy as np
import pytest

from trueup.studies.walk.odds import expected_shares


def drawn(rng: np.random.Generator, slope: float, own: float, count: int, runs: int) -> tuple[np.ndarray, ...]:
    signal = rng.uniform(-2.0, 2.0, count)
    true = 1.0 / (1.0 + np.exp(1.5 - slope * signal - own * rng.standard_normal(count)))
    return signal, true, rng.binomial(runs, true).astype(float)


def test_expected_shares_are_those_in_which_candidates_fail() -> None:
    rng = np.random.default_rng(0)
    gaps, alone = [], []
    for _ in range(40):
        signal, true, failed = drawn(rng, 1.5, 0.5, 20, 4)
        gaps.append(expected_shares(signal, failed, np.full(20, 4.0)) - true)
        alone.append((failed + 0.5) / 5.0 - true)
    assert abs(np.mean(gaps)) < 0.01
    assert np.mean(np.square(gaps)) < 0.4 * np.mean(np.square(alone))  # than by the candidate's own runs


def test_where_the_signal_says_nothing_a_candidates_own_runs_count() -> None:
    rng = np.random.default_rng(1)
    signal, true, failed = drawn(rng, 0.0, 2.5, 30, 20)
    assert np.abs(expected_shares(signal, failed, np.full(30, 20.0)) - true).mean() < 0.08


def test_odds_need_runs_and_signals() -> None:
    assert expected_shares(np.zeros(1), np.zeros(1), np.full(1, 8.0))[0] < 0.05
    for signal, runs in ((np.zeros(0), np.zeros(0)), (np.zeros(1), np.zeros(1)), (np.full(1, np.nan), np.ones(1))):
        with pytest.raises(ValueError, match="finite signal"):
            expected_shares(signal, np.zeros(len(signal)), runs)
