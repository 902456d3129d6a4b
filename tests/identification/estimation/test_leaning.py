# SPDX-License-Identifier: Apache-2.0
"""A base that leans is found in the torque, and what is none is not taken for one."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from trueup.identification.estimation.identify import Options, identify
from trueup.identification.estimation.result import Identification, relative_error
from trueup.identification.kinematic_tree import KinematicTree, exponential
from trueup.recording import Recording
from trueup.units import GRAVITY

DOWN = np.array([0.0, 0.0, -GRAVITY])


def leant(degrees: float, *, towards: float = 0.0) -> np.ndarray:
    """Gravity in the frame of a base that leans, down towards an angle of its frame in rad."""
    across = np.array([np.sin(towards), -np.cos(towards), 0.0])
    return exponential(np.radians(degrees) * across) @ DOWN


def logs(arms: SimpleNamespace, truth: KinematicTree) -> list[Recording]:
    return [arms.recording(truth, np.random.default_rng(seed), f"run{seed}") for seed in range(3)]


def leans(found: Identification) -> list[str]:
    return [w for w in found.warnings if "base leans" in w]


@pytest.mark.parametrize("degrees", [2.0, 7.5])
def test_a_base_that_leans_is_found_and_said_and_taken(arms: SimpleNamespace, degrees: float) -> None:
    tree, gravity = arms.arm(), leant(degrees, towards=0.6)
    runs = logs(arms, tree.replace(gravity=gravity))
    found, kept = (identify(tree, runs[:2], runs[2:], options=Options(refuse=r)) for r in ((), ("lean",)))
    (said,) = leans(found)
    low, high = (float(x) for x in said.split("[")[1].split("]")[0].split(","))
    assert low < degrees < high < low + 3.0
    assert found.model.tree.gravity @ gravity / GRAVITY**2 > np.cos(np.radians(0.7))
    np.testing.assert_array_equal(kept.model.tree.gravity, tree.gravity)
    assert leans(kept)[0].startswith("refused, and so not done: ")
    known = identify(tree.replace(gravity=gravity), runs[:2], runs[2:])
    assert not leans(known)
    assert relative_error(found.held_out()) < 1.05 * relative_error(known.held_out())
    assert degrees < 5.0 or relative_error(kept.held_out()) > 1.3 * relative_error(known.held_out())


@pytest.mark.parametrize(
    "what",
    ["nothing", "zeros", "offsets", "a spring", "ripple", "a load"],
)
def test_what_is_no_lean_is_not_called_one(arms: SimpleNamespace, what: str) -> None:
    tree = arms.arm()
    runs = logs(arms, tree)
    changed = []
    for run in runs:
        q, torque = (run.channel(name) for name in ("position", "torque"))
        place, more = np.array(q.values), np.zeros(q.values.shape)
        if what == "zeros":
            place = place + np.radians([0.0, 3.0, -2.0, 2.0])
        elif what == "offsets":
            more = more + np.array([5.0, -8.0, 4.0, 1.0])
        elif what == "a spring":
            more = place * np.array([12.0, -8.0, 3.0, 0.0])
        elif what == "ripple":
            more = np.sin(place + 0.7) * np.array([10.0, 8.0, 4.0, 1.0])
        changed.append(
            run.replace(
                channels={"position": q.replace(values=place), "torque": torque.replace(values=torque.values + more)}
            )
        )
    given = tree
    if what == "a load":  # in the arm's hand, of which the file knows nothing
        given = tree.replace(inertial=np.vstack([tree.inertial[:3], 0.3 * tree.inertial[3]]))
    found = identify(given, changed[:2], changed[2:])
    assert not leans(found)
    np.testing.assert_array_equal(found.model.tree.gravity, tree.gravity)


def test_a_lean_that_may_be_another_zero_is_said_with_it(arms: SimpleNamespace) -> None:
    # On a slope, another way of it is another zero of the first joint, and torque is the same.
    truth = leant(12.0, towards=-0.1)
    tree = arms.arm().replace(gravity=leant(12.0, towards=0.1))
    runs = logs(arms, tree.replace(gravity=truth))
    found = identify(tree, runs[:2], runs[2:])
    (said,) = leans(found)
    assert said.startswith("either the base leans 2.")
    assert "or joint1 has another zero" in said
    assert found.model.tree.gravity @ truth / GRAVITY**2 > np.cos(np.radians(0.7))
