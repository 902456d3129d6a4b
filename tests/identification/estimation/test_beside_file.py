# SPDX-License-Identifier: Apache-2.0
"""Mistakes that a fit of its own masses takes up, told by what the model file says of its links."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.identification.estimation.identify import Options, identify
from trueup.identification.kinematic_tree import KinematicTree
from trueup.identification.regressors import inverse_dynamics
from trueup.recording import Recording

FAST = Options(consistent=False, structure="common")
SAID = "times the weight|times what the model file"


def rough(tree: KinematicTree, seed: int) -> KinematicTree:
    """The arm as a file has it: each body's mass up to a third more or less than it is."""
    share = np.random.default_rng(seed).uniform(0.7, 1.3, (tree.n, 1))
    return tree.replace(inertial=np.asarray(tree.inertial) * share)


def run(arms: SimpleNamespace, seed: int, change: NDArray[np.float64] | float = 1.0) -> Recording:
    made = arms.recording(arms.arm(), np.random.default_rng(seed), f"run{seed}", seconds=16.0)
    torque = made.channel("torque")
    return made.with_channel(torque.replace(values=torque.values * change))


def minded(tree: KinematicTree, recording: Recording) -> str:
    said = identify(tree, [recording], options=FAST).warnings
    return "; ".join(s for s in said if any(words in s for words in SAID.split("|")))


@pytest.mark.parametrize("seed", range(4))
def test_files_that_are_a_third_wrong_are_nothing_to_mind(arms: SimpleNamespace, seed: int) -> None:
    assert not minded(rough(arms.arm(), seed), run(arms, seed))


def test_a_torque_constant_that_is_a_tenth_of_what_it_should_be_is_named_with_its_joint(arms: SimpleNamespace) -> None:
    said = minded(rough(arms.arm(), 1), run(arms, 1, np.array([0.1, 1.0, 1.0, 1.0])))
    assert said.startswith("the torque that links ask of joint1 is 0.1")
    assert "torque constant" in said


def test_torque_from_which_a_controller_took_the_weight_it_believes_in_is_named(arms: SimpleNamespace) -> None:
    file, made = rough(arms.arm(), 2), run(arms, 2)
    q = made.channel("position").values
    weight = inverse_dynamics(file, np.asarray(file.inertial), q, np.zeros_like(q), np.zeros_like(q))
    torque = made.channel("torque")
    said = minded(file, made.with_channel(torque.replace(values=torque.values - weight)))
    assert "a controller may take weight out" in said
    assert "--gravity 0 0 0" in said


def test_an_arm_on_a_ceiling_whose_file_stands_on_the_floor_is_named(arms: SimpleNamespace) -> None:
    tree = rough(arms.arm(), 3)
    hanging = tree.replace(gravity=-np.asarray(tree.gravity))
    assert "upside down: identify with --gravity 0 0 -9.8" in minded(hanging, run(arms, 3))


def test_a_file_without_masses_says_nothing(arms: SimpleNamespace) -> None:
    assert not minded(arms.without_file(arms.arm()), run(arms, 1, np.array([0.1, 1.0, 1.0, 1.0])))
