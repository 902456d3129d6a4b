# SPDX-License-Identifier: Apache-2.0
"""Places of sensors that are slower than the log's rows are taken when they came, by nothing but rows."""

from __future__ import annotations

import numpy as np

from trueup.recording import Channel
from trueup.tracking.place import fresh

RATE, SPEED = 10.0, 4.0  # rows a second; m/s


def test_a_fix_whose_first_row_is_missing_is_not_taken_to_be_of_the_next_row() -> None:
    rng = np.random.default_rng(0)
    time = np.arange(600) / RATE
    place = SPEED * 0.2 * np.floor(time / 0.2 + 1e-9)  # a receiver of 5 Hz
    kept = rng.random(len(time)) > 0.05
    logged = Channel("position", ("x", "y"), "m", time[kept], np.stack([place, 0.0 * place], axis=1)[kept])
    found = fresh(logged)
    assert 240 < len(found.time) < 300
    np.testing.assert_allclose(found.values[:, 0], SPEED * found.time, atol=1e-6)
