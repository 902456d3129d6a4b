# SPDX-License-Identifier: Apache-2.0
"""Spectra obey what is known of them: white noise is flat at its floor, a tone sits at its frequency."""

from __future__ import annotations

import numpy as np
import pytest

from trueup.report.spectra import amplitude_density, error_by_speed, white_density

TIME = np.arange(20000) / 200


def test_white_noise_lies_on_the_noise_floor() -> None:
    noise = 0.003 * np.random.default_rng(5).standard_normal(TIME.size)
    _, density = amplitude_density(TIME, noise)
    assert np.median(density) == pytest.approx(white_density(0.003, TIME), rel=0.05)


def test_a_tone_peaks_at_its_frequency() -> None:
    frequency, density = amplitude_density(TIME, np.sin(2 * np.pi * 7.0 * TIME))
    assert frequency[np.argmax(density)] == pytest.approx(7.0, abs=0.2)


def test_a_few_missing_samples_do_not_matter_and_many_are_refused() -> None:
    tone = np.sin(2 * np.pi * 7.0 * TIME)
    tone[3000:3100] = np.nan
    frequency, density = amplitude_density(TIME, tone)
    assert frequency[np.argmax(density)] == pytest.approx(7.0, abs=0.2)
    tone[:8000] = np.nan
    assert amplitude_density(TIME, tone)[0].size == 0


def test_friction_shows_as_a_step_over_speed() -> None:
    motion = np.sin(2 * np.pi * 0.4 * TIME)
    speed, error = error_by_speed(TIME, motion, 0.01 * np.sign(np.cos(2 * np.pi * 0.4 * TIME)))
    assert error[speed > 0.3] == pytest.approx(0.01, rel=0.05)
    assert error[speed < -0.3] == pytest.approx(-0.01, rel=0.05)
    assert error_by_speed(TIME, np.zeros(TIME.size), np.ones(TIME.size))[0].size == 0
