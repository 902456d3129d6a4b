# SPDX-License-Identifier: Apache-2.0
"""One log among several that was written otherwise is named where it can be told, else that they contradict one another."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from trueup.errors import IdentificationError
from trueup.identification.estimation.identify import Options, identify
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
