# SPDX-License-Identifier: Apache-2.0
"""Which unit a clock has whose name does not say it."""

from __future__ import annotations

import numpy as np
import pytest

from trueup.formats.clock import guess_unit


@pytest.mark.parametrize("since", [10.0, 1000.0, 1300.0, 1600.0, 5000.0])
@pytest.mark.parametrize(("unit", "size"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_a_clock_since_power_on_is_of_one_unit_however_long_it_has_run(unit: str, size: float, since: float) -> None:
    """After 17 minutes microseconds are as many as seconds since 1970 were in 2001."""
    time = since + 0.05 * np.arange(100)
    assert guess_unit("timestamp", np.asarray(np.round(time * size), dtype=np.float64)) == unit


def test_dates_are_told_in_each_unit() -> None:
    for unit, size in (("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)):
        time = np.asarray((1.7e9 + 0.05 * np.arange(100)) * size, dtype=np.float64)
        assert guess_unit("timestamp", time) == unit
