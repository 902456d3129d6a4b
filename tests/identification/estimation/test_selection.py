# SPDX-License-Identifier: Apache-2.0
"""What draws effects to zero serves motion that a log does not show, and gives way where the log tells them plainly."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from trueup.identification.estimation.identify import Options, identify
from trueup.identification.estimation.result import relative_error


@pytest.mark.parametrize("quadratic", [0.3, 1.0])
def test_strong_friction_that_a_log_tells_plainly_is_not_made_smaller(arms: SimpleNamespace, quadratic: float) -> None:
    tree, rng = arms.arm(), np.random.default_rng(0)
    runs = [
        arms.recording(tree, rng, name, seconds=30.0, noise=0.1, quadratic=quadratic, size=size)
        for name, size in (("run", 1.0), ("like it", 1.0), ("half as fast again", 1.5))
    ]
    found = identify(arms.without_file(tree), runs[:1], runs[1:], options=Options(cutoff=8.0, consistent=False))
    alike, faster = ([p] for p in found.held_out())
    assert relative_error(alike) < 0.004
    assert relative_error(faster) < 0.03
