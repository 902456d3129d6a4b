# SPDX-License-Identifier: Apache-2.0
"""The rule of evidence: chance alone must rarely buy a structure, a clear gain must."""

from __future__ import annotations

import numpy as np
import pytest

from trueup.evidence import Evidence, evidence


def test_chance_alone_seldom_buys_a_structure() -> None:
    rng = np.random.default_rng(0)
    bought = [evidence(np.exp(rng.normal(0, 0.1, 12)), np.exp(rng.normal(0, 0.1, 12))).holds for _ in range(400)]
    assert np.mean(bought) < 0.07  # one-sided, two standard errors of a mean over twelve blocks: 3.5 % by Student's t


def test_a_gain_on_every_block_is_evidence_however_different_their_errors_are() -> None:
    without = np.array([1e-3, 1.0, 50.0, 7.0])
    assert evidence(without, without * [0.8, 0.85, 0.75, 0.8]).holds


def test_what_rounding_gains_on_every_block_is_no_evidence() -> None:
    errors = np.random.default_rng(0).uniform(0.1, 10.0, 6)
    shown = evidence(errors * (1.0 + 1e-10), errors)
    assert shown.gain > 2.0 * shown.standard_error > 0.0
    assert not shown.holds


def test_one_block_or_a_failed_replay_is_no_evidence() -> None:
    assert not evidence(np.array([2.0]), np.array([1.0])).holds
    assert not evidence(np.array([2.0, 2.0, 2.0]), np.array([1.0, np.inf, 1.0])).holds


@pytest.mark.parametrize(
    ("gain", "error", "said"),
    [
        (np.log(1.0 / 0.8), 0.0488, "lower by 20 % (standard error 5 %)"),
        (-np.log(1.25), 0.0488, "higher by 25 % (standard error 5 %)"),
        (np.log(13.0), np.log(3.0), "lower by a factor of 13 (standard error a factor of 3)"),
        (-np.log(6.0), np.log(1.5), "higher by a factor of 6 (standard error 50 %)"),
        (0.0, np.inf, "lower by 0 % (nothing tells how sure that is)"),
        (np.inf, np.inf, "without bound"),
        (-4e-16, 1e-15, "the same"),
    ],
)
def test_evidence_is_said_in_words_that_are_true_at_any_size(gain: float, error: float, said: str) -> None:
    assert Evidence(gain, error).in_words() == said
