# SPDX-License-Identifier: Apache-2.0
"""Faults of single samples are told from what arms really do, and spoil nothing."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from trueup.identification.estimation.identify import Options, identify
from trueup.identification.estimation.result import relative_error
from trueup.inspection.spikes import without_spikes


def test_steps_pulses_and_noise_are_no_spikes_and_faults_are(rng: np.random.Generator) -> None:
    time = np.arange(0.0, 20.0, 4e-3)
    wave = 5.0 * np.sin(2.0 * time)
    step = wave + 3.0 * np.sign(np.cos(2.0 * time))
    pulse = wave + 8.0 * np.exp(-(((time - 9.0) / 0.02) ** 2))
    counts = np.round(20.0 * wave) / 20.0
    noisy = wave + rng.normal(size=len(time))
    held = wave[(np.arange(len(time)) // 3) * 3]
    assert without_spikes(np.stack([wave, step, pulse, counts, noisy, held], axis=1))[1].sum() == 0.0
    faulty, at = np.stack([wave, step], axis=1), rng.choice(np.arange(5, len(time) - 5, 9), 20, replace=False)
    faulty[at] += 30.0
    faulty[:9] = np.nan
    kept, found = without_spikes(faulty)
    assert found.tolist() == [20.0, 20.0] or found.tolist() == [19.0, 19.0]  # one may lie in what is missing
    assert np.isnan(kept[at]).all()


@pytest.mark.parametrize("channel", ["torque", "position"])
def test_a_log_with_faulty_samples_is_as_good_as_one_without(arms: SimpleNamespace, channel: str) -> None:
    tree = arms.arm()
    clean = arms.recording(tree, np.random.default_rng(2), seconds=20.0)
    bad, rng = np.array(clean.channel(channel).values), np.random.default_rng(3)
    hit = rng.random(bad.shape) < 0.002
    bad[hit] += rng.choice([-1.0, 1.0], hit.sum()) * (200.0 if channel == "torque" else 1.5)
    spoilt = clean.with_channel(clean.channel(channel).replace(values=bad))
    options = Options(hold_out=0.3, consistent=False)
    plain, found = (identify(tree, [r], options=options) for r in (clean, spoilt))
    assert relative_error(found.held_out()) < 1.1 * relative_error(plain.held_out())
    assert any(f"single samples of {channel}" in w for w in found.warnings)
    assert not any("single samples" in w for w in plain.warnings)
