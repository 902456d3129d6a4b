# SPDX-License-Identifier: Apache-2.0
"""The rule of evidence: chance alone must rarely buy a structure, a clear gain must."""

from __future__ import annotations

import numpy as np

from trueup.evidence import evidence


def test_chance_alone_seldom_buys_a_structure() -> None:
    rng = np.random.default_rng(0)
    bought = [evidence(np.exp(rng.normal(0, 0.1, 12)), np.exp(rng.normal(0, 0.1, 12))).holds for _ in range(400)]
    assert np.mean(bought) < 0.07  # one-sided, two standard errors of a mean over twelve blocks: 3.5 % by Student's t


def test_a_gain_on_every_block_is_evidence_however_different_their_errors_are() -> None:
    without = np.array([1e-3, 1.0, 50.0, 7.0])
    assert evidence(without, without * [0.8, 0.85, 0.75, 0.8]).holds


def test_one_block_or_a_failed_replay_is_no_evidence() -> None:
    assert not evidence(np.array([2.0]), np.array([1.0])).holds
    assert not evidence(np.array([2.0, 2.0, 2.0]), np.array([1.0, np.inf, 1.0])).holds
