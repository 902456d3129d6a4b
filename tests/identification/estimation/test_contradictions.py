# SPDX-License-Identifier: Apache-2.0
"""One log among several that was written otherwise is named where it can be told, else that they contradict one another."""

from __future__ import annotations

import re
from types import SimpleNamespace

import numpy as np
import pytest

from trueup.errors import IdentificationError
from trueup.identification.estimation.identify import Options, identify
from trueup.identification.inertial import from_com
from trueup.identification.regressors import inverse_dynamics
from trueup.recording import Recording

FAST = Options(consistent=False, structure="common")


def runs(arms: SimpleNamespace, count: int) -> list[Recording]:
    return [arms.recording(arms.arm(), np.random.default_rng(20 + k), f"run{k}", seconds=12.0) for k in range(count)]


def negated(recording: Recording) -> Recording:
    torque = recording.channel("torque")
    return recording.with_channel(torque.replace(values=-torque.values))


@pytest.mark.parametrize("wrong", [(0,), (1,), (0, 1), (0, 1, 2)])
def test_logs_whose_torques_are_all_negated_are_named_among_good_ones(
    arms: SimpleNamespace, wrong: tuple[int, ...]
) -> None:
    logs = [negated(r) if k in wrong else r for k, r in enumerate(runs(arms, 3))]
    with pytest.raises(IdentificationError, match="seems to have the wrong sign") as error:
        identify(arms.arm(), logs, options=FAST)
    said = str(error.value)
    assert [k for k in range(3) if f"run{k}" in said] == list(wrong)
    assert "friction brakes" in said
    assert "would go from" not in said, "an error that stays what it is explains nothing"


def test_exchanged_columns_of_a_later_log_are_named(arms: SimpleNamespace) -> None:
    first, second = runs(arms, 2)
    torque = second.channel("torque")
    swapped = second.with_channel(torque.replace(values=torque.values[:, [1, 0, 2, 3]]))
    with pytest.raises(IdentificationError, match=r"'run1': .*joint1 and joint2 seem to be exchanged"):
        identify(arms.arm(), [first, swapped], options=FAST)


def test_logs_that_contradict_one_another_without_friction_to_tell_which_are_said_to(arms: SimpleNamespace) -> None:
    tree, logs = arms.arm(), []
    for k, recording in enumerate(runs(arms, 2)):
        time = recording.time
        q, v, a = arms.sines(np.random.default_rng(20 + k), time, tree.n)
        bare = inverse_dynamics(tree, np.asarray(tree.inertial), q, v, a)
        logs.append(recording.with_channel(recording.channel("position").replace(values=q)))
        logs[k] = logs[k].with_channel(recording.channel("torque").replace(values=bare))
    found = identify(tree, [logs[0], negated(logs[1])], options=FAST)
    assert any("contradict one another" in warning and "run0" in warning for warning in found.warnings)


def laden(arms: SimpleNamespace, k: int, mass: float) -> Recording:
    """The run of that number with the torque of so many kg 0.1 m from the last joint more."""
    tree, recording, load = arms.arm(), runs(arms, k + 1)[k], np.zeros((4, 10))
    load[-1] = from_com(mass, np.array([0.0, 0.0, 0.1]), np.zeros((3, 3)))
    seed = int(np.random.default_rng(20 + k).integers(2**32))
    motion = arms.sines(np.random.default_rng(seed), recording.time, tree.n)
    torque = recording.channel("torque")
    return recording.with_channel(torque.replace(values=torque.values + inverse_dynamics(tree, load, *motion)))


@pytest.mark.parametrize("mass", [1.0, 2.0])
def test_a_load_in_one_of_many_recordings_is_named_though_it_hardly_spoils_the_others(
    arms: SimpleNamespace, mass: float
) -> None:
    several, load = runs(arms, 5), laden(arms, 5, mass)
    found = identify(arms.arm(), [*several, load], options=FAST)
    (said,) = (w for w in found.warnings if "another load" in w)
    assert said.startswith("recording 'run5' carried")
    told = re.search(r"with (\S+) \+- (\S+) kg more", said)
    assert told
    assert abs(float(told[1]) - mass) < 2.0 * float(told[2]) < 0.1


@pytest.mark.parametrize("held_out", [False, True])
def test_a_recording_with_a_load_of_its_own_is_named_with_its_mass(arms: SimpleNamespace, held_out: bool) -> None:
    (first, second), load = runs(arms, 2), laden(arms, 2, 4.0)
    fitted, judged = ([first, second], [load]) if held_out else ([first, load, second], [])
    found = identify(arms.arm(), fitted, judged, options=FAST)
    (said,) = (w for w in found.warnings if "another load" in w)
    assert said.startswith("recording 'run2' carried")
    mass = re.search(r"with (\S+) \+- (\S+) kg more", said)
    assert mass
    assert abs(float(mass[1]) - 4.0) < float(mass[2])


def test_a_load_that_is_taken_up_and_put_down_within_recordings_is_named_with_when_and_how_much(
    arms: SimpleNamespace,
) -> None:
    logs, spans = list[Recording](), ((3.0, 9.0), (6.0, 12.0))
    for k, (begin, end) in enumerate(spans):
        free, load = runs(arms, k + 1)[k].channel("torque"), laden(arms, k, 4.0)
        held = (free.time >= begin) & (free.time < end)
        torque = load.channel("torque")
        logs.append(load.with_channel(torque.replace(values=np.where(held[:, None], torque.values, free.values))))
    found = identify(arms.arm(), logs, options=FAST)
    (said,) = (w for w in found.warnings if "another load in parts" in w)
    mass = re.search(r"with (\S+) \+- (\S+) kg more", said)
    assert mass
    assert abs(float(mass[1]) - 4.0) < 0.4
    for k, span in enumerate(spans):
        when = re.search(rf"'run{k}' (\S+) \.\.\. (\S+) s", said)
        assert when
        assert np.abs(np.array([float(when[1]), float(when[2])]) - span).max() < 1.0


def test_a_recording_in_which_a_hand_moved_the_arm_is_named_as_what_fits_badly_beside_the_others(
    arms: SimpleNamespace,
) -> None:
    logs = runs(arms, 3)
    torque = logs[0].channel("torque")
    still = np.random.default_rng(3).normal(size=torque.values.shape)
    logs[0] = logs[0].with_channel(torque.replace(values=still))  # motors that are off
    found = identify(arms.arm(), logs, options=FAST)
    (said,) = (w for w in found.warnings if "fits badly beside the others" in w)
    assert said.startswith("recording 'run0'")


def test_torque_that_something_else_made_is_asked_about(arms: SimpleNamespace) -> None:
    (run,) = runs(arms, 1)
    torque = run.channel("torque")
    pushes = (
        2.0
        * torque.values.std(axis=0)
        * np.sin(7.0 * torque.time)[:, None]
        * (np.sin(1.3 * torque.time) > 0.3)[:, None]
    )
    found = identify(arms.arm(), [run.with_channel(torque.replace(values=torque.values + pushes))], options=FAST)
    assert any("did the arm touch a table" in w for w in found.warnings)


def test_recordings_of_one_arm_are_said_to_belong_together(arms: SimpleNamespace) -> None:
    found = identify(arms.arm(), runs(arms, 3), options=FAST)
    assert not [w for w in found.warnings if "beside the others" in w or "contradict" in w or "another load" in w]
    alone = identify(arms.arm(), runs(arms, 1), options=FAST)
    assert not [w for w in alone.warnings if "another load" in w]
