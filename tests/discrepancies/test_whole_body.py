# SPDX-License-Identifier: Apache-2.0
"""The torso's orientation is compared as a rotation, which does not jump where angles do."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from trueup.discrepancies.whole_body import rotation_between


def test_the_rotation_between_orientations_is_that_of_scipy() -> None:
    rng = np.random.default_rng(0)
    first, second = rng.uniform(-3.0, 3.0, (2, 200, 3))
    ours = rotation_between(first, second)
    turned = [Rotation.from_euler("ZYX", angles[:, ::-1]) for angles in (first, second)]
    np.testing.assert_allclose(ours, (turned[0].inv() * turned[1]).as_rotvec(), atol=1e-9)


def test_going_head_over_changes_it_steadily_where_angles_jump() -> None:
    lean = np.linspace(0.0, 3.0, 301)
    over = Rotation.from_rotvec(lean[:, None] * [0.0, 1.0, 0.0]).as_euler("ZYX")[:, ::-1]
    assert np.abs(np.diff(over, axis=0)).max() > 3.0
    apart = rotation_between(np.zeros((301, 3)), over)
    np.testing.assert_allclose(apart, lean[:, None] * [0.0, 1.0, 0.0], atol=1e-9)
