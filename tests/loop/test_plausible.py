# SPDX-License-Identifier: Apache-2.0
"""Samples that contradict what the robot did in closed loop are left out; the others stay in their order."""

from __future__ import annotations

import numpy as np

from trueup.engines.vehicle import BicycleSimulator, Vehicle, vehicle_space
from trueup.loop.plausible import plausible
from trueup.paths.courses import hairpin
from trueup.tasks.follow_path import FollowPath
from trueup.tasks.task import simulated_scores

VEHICLE = Vehicle("v", 0.55, 0.698)
TASK = FollowPath([hairpin((0.8,))])
SIMULATOR = BicycleSimulator(VEHICLE, vehicle_space(VEHICLE, ("steering_delay",)))
GAINS = np.array([[1.0, 1.0, 1.0], [2.0, 2.0, 2.0]])
MODELS = np.array([[0.20], [0.95], [0.25], [0.15], [0.9], [0.22]])


def test_only_what_explains_the_runs_is_kept() -> None:
    measured = simulated_scores(TASK, SIMULATOR, np.array([0.2]), GAINS)[0]
    kept = plausible(TASK, SIMULATOR, MODELS, GAINS, measured, 4)
    np.testing.assert_array_equal(kept[:, 0], [0.20, 0.25, 0.15, 0.22])


def test_too_few_are_filled_up_with_the_next_best() -> None:
    measured = simulated_scores(TASK, SIMULATOR, np.array([0.2]), GAINS)[0]
    kept = plausible(TASK, SIMULATOR, MODELS, GAINS, measured, 5)
    assert len(kept) == 5
    assert kept[4, 0] in (0.9, 0.95)


def test_without_a_score_nothing_is_ruled_out() -> None:
    np.testing.assert_array_equal(plausible(TASK, SIMULATOR, MODELS, GAINS, np.full(2, np.nan), 3), MODELS[:3])
