# SPDX-License-Identifier: Apache-2.0
"""Of several torques in a log names decide which is fitted; where they do not, whoever asked is asked, whatever fits best."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from trueup.errors import IdentificationError
from trueup.identification.estimation.matching import matched
from trueup.identification.kinematic_tree import KinematicTree
from trueup.identification.regressors import inverse_dynamics
from trueup.recording import Channel, Recording


@pytest.fixture(scope="module")
def tree(arms: SimpleNamespace) -> KinematicTree:
    return arms.arm()


@pytest.fixture(scope="module")
def log(tree: KinematicTree, arms: SimpleNamespace) -> tuple[Recording, Channel]:
    """A log with measured torque, and what a controller computed for the same motion from a model without friction."""
    run = arms.recording(tree, np.random.default_rng(3), seconds=12.0, size=2.0)
    q = run.channel("position")
    v = np.gradient(q.values, q.time, axis=0)
    exact = inverse_dynamics(tree, np.asarray(tree.inertial), q.values, v, np.gradient(v, q.time, axis=0))
    return run, run.channel("torque").replace(values=exact)


def test_measured_torque_is_taken_by_its_name_though_a_computed_one_is_explained_better(
    tree: KinematicTree, log: tuple[Recording, Channel]
) -> None:
    run, computed = log
    both = dict(run.channels) | {"command_torque": computed.replace(name="command_torque")}
    measured = run.channel("torque")
    joined = measured.replace(
        labels=(*tree.joints, *(f"computed_{k}" for k in range(4))),
        values=np.hstack([measured.values, computed.values]),
    )
    for recording in (run.replace(channels=both), run.with_channel(joined)):
        _, ((made,), _), notes = matched(tree, ([recording], []))
        assert np.array_equal(made.channel("torque").values, measured.values)
        assert any("--torque" in note for note in notes)
        _, ((made,), _), _ = matched(tree, ([recording], []), "comm" if recording.has("command_torque") else "computed")
        assert np.array_equal(made.channel("torque").values, computed.values)


def test_parts_that_a_controller_makes_its_torque_of_are_none_that_was_measured(
    tree: KinematicTree, log: tuple[Recording, Channel]
) -> None:
    run, computed = log
    measured = run.channel("torque")
    parts = ("control", "fric")
    labels = (*tree.joints, *(f"{part}{k}" for part in parts for k in range(4)))
    joined = measured.replace(
        labels=labels, values=np.hstack([measured.values, computed.values, 0.1 * computed.values])
    )
    _, ((made,), _), _ = matched(tree, ([run.with_channel(joined)], []))
    assert np.array_equal(made.channel("torque").values, measured.values)


def test_torques_that_are_filtered_beside_plain_ones_are_not_asked_about(
    tree: KinematicTree, log: tuple[Recording, Channel]
) -> None:
    run, other = log
    both = run.with_channel(other.replace(name="torque_filtered"))
    _, ((made,), _), notes = matched(tree, ([both], []))
    assert np.array_equal(made.channel("torque").values, run.channel("torque").values)
    assert any("'torque_filtered'" in note for note in notes)


def test_two_torques_whose_names_say_nothing_are_listed_with_evidence_and_asked_for(
    tree: KinematicTree, log: tuple[Recording, Channel]
) -> None:
    run, computed = log
    labels = tuple(f"{word}_{k}" for word in ("a", "b") for k in range(1, 5))
    values = np.hstack([run.channel("torque").values, computed.values])
    open_ = run.with_channel(run.channel("torque").replace(labels=labels, values=values))
    with pytest.raises(IdentificationError, match=r"--torque 'torque a'.*(\n.*)*--torque 'torque b'.*noise"):
        matched(tree, ([open_], []))
    _, ((made,), _), _ = matched(tree, ([open_], []), "torque a")
    assert np.array_equal(made.channel("torque").values, run.channel("torque").values)


def test_columns_without_names_are_never_chosen_by_which_torque_is_explained_best(
    tree: KinematicTree, log: tuple[Recording, Channel]
) -> None:
    run, computed = log
    q = run.channel("position")
    block = np.hstack([q.values, np.gradient(q.values, q.time, axis=0), run.channel("torque").values, computed.values])
    bare = Recording("bare", {"column": Channel("column", tuple(map(str, range(1, 17))), "", q.time, block)})
    with pytest.raises(IdentificationError, match=r"--torque 'columns 9-12'.*(\n.*)*--torque 'columns 13-16'"):
        matched(tree, ([bare], []))
    _, ((made,), _), _ = matched(tree, ([bare], []), "9-12")
    assert np.array_equal(made.channel("torque").values, run.channel("torque").values)
    assert made.has("velocity")
