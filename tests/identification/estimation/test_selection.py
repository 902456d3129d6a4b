# SPDX-License-Identifier: Apache-2.0
"""What draws effects to zero serves motion that a log does not show, and gives way where the log tells them plainly."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from trueup.arrays import Array
from trueup.identification.estimation.drives import Drives
from trueup.identification.estimation.identify import Options, identify
from trueup.identification.estimation.moments import RIDGE, Moments, moments_of
from trueup.identification.estimation.motion import log_of, pieces_of
from trueup.identification.estimation.pool import kinds_of, pool_for
from trueup.identification.estimation.result import relative_error
from trueup.identification.estimation.selection import Choice, select_pull


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


def test_kinds_of_motion_hold_each_fitted_sample_of_each_joint_once(arms: SimpleNamespace) -> None:
    tree = arms.arm()
    drives = Drives.direct(tree.joints)
    run = arms.recording(tree, np.random.default_rng(0), "run", seconds=10.0, noise=0.1)
    motion = log_of(run, tree, drives).motion(8.0, measured_speed=False)
    pool = pool_for(tree, drives.coupling, [motion])
    pieces = pieces_of(motion, pool.model, 8.0, 0.3)
    kinds, whole = moments_of(kinds_of(pool, pieces)), moments_of([pieces[0].rows])
    assert len(kinds.count) == 16
    np.testing.assert_allclose(kinds.square.sum(axis=0), whole.square[0])
    parts, all_of_it = (m.gram.sum(axis=0) * m.scale[:, None] * m.scale for m in (kinds, whole))
    np.testing.assert_allclose(parts, all_of_it, atol=1e-9 * np.abs(all_of_it).max())


def test_what_is_known_of_bodies_gives_way_only_where_kinds_of_motion_say_so_too() -> None:
    def told(values: list[float], prior: float) -> tuple[Moments, Array]:
        x, one = np.array(values)[:, None], np.ones(1)
        moments = Moments(np.ones((len(x), 1, 1, 1)), x[:, :, None], x**2, np.ones(len(x)), one, 0.0 * one)
        return moments, np.full((len(x), 1), prior)

    free = Choice(np.array([True]), RIDGE, np.ones(1))
    blocks = told([1.1, 0.9, 1.1, 0.9], 0.0)
    assert select_pull(lambda k: blocks, free).strength == RIDGE
    assert select_pull(lambda k: (blocks, told([4.0, -2.0, 3.0, -1.0], 1.0))[k], free).strength == 1.0
