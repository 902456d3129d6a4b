# SPDX-License-Identifier: Apache-2.0
"""The torso's orientation is compared as a rotation, which does not jump where angles do."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from trueup.articulated.pose import quaternion_of, rotation_between
from trueup.discrepancies.whole_body import in_nearest_angles


def test_the_rotation_between_orientations_is_that_of_scipy() -> None:
    rng = np.random.default_rng(0)
    first, second = rng.uniform(-3.0, 3.0, (2, 200, 3))
    ours = rotation_between(quaternion_of(first), quaternion_of(second))
    turned = [Rotation.from_euler("ZYX", angles[:, ::-1]) for angles in (first, second)]
    np.testing.assert_allclose(ours, (turned[0].inv() * turned[1]).as_rotvec(), atol=1e-9)


def test_going_head_over_changes_it_steadily_where_angles_jump() -> None:
    lean = np.linspace(0.0, 3.0, 301)
    over = Rotation.from_rotvec(lean[:, None] * [0.0, 1.0, 0.0]).as_euler("ZYX")[:, ::-1]
    assert np.abs(np.diff(over, axis=0)).max() > 3.0
    apart = rotation_between(np.array([1.0, 0.0, 0.0, 0.0]), quaternion_of(over))
    np.testing.assert_allclose(apart, lean[:, None] * [0.0, 1.0, 0.0], atol=1e-9)


def test_a_torso_that_pitches_over_a_little_later_is_shown_a_little_off_and_not_by_half_a_turn() -> None:
    pitch = np.linspace(1.2, 1.9, 30)  # rad: over the vertical on the way
    measured, simulated = (
        Rotation.from_euler("xyz", np.stack([0.01 + 0.0 * p, p, -0.02 + 0.0 * p], axis=1)).as_euler("xyz")
        for p in (pitch, pitch - 0.1)
    )
    shown = in_nearest_angles("base_orientation", ("roll", "pitch", "yaw"), measured, simulated)
    apart = rotation_between(quaternion_of(simulated), quaternion_of(shown))
    np.testing.assert_allclose(apart, 0.0, atol=1e-9)  # the same orientations
    assert np.abs(simulated - measured).max() > 3.0
    np.testing.assert_allclose(np.linalg.norm(shown - measured, axis=1), 0.1, rtol=1e-6)
    np.testing.assert_array_equal(in_nearest_angles("position", ("a", "b", "c"), measured, simulated), simulated)
