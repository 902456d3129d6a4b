# SPDX-License-Identifier: Apache-2.0
"""Columns without names are told by what they do: positions, speeds and torques, in whatever order they stand."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.errors import IdentificationError
from trueup.identification.estimation.matching import matched
from trueup.recording import Channel, Recording

Array = NDArray[np.float64]


def bare(time: Array, values: Array) -> Recording:
    labels = tuple(str(k + 2) for k in range(values.shape[1]))
    return Recording("bare", {"column": Channel("column", labels, "", time, values)})


@pytest.mark.parametrize(
    ("order", "by_joint", "unit"),
    [("qvt", False, 1.0), ("tq", False, 1.0), ("qavct", False, 1.0), ("qt", True, 1.0), ("vqt", True, 180.0 / np.pi)],
)
def test_positions_speeds_and_torques_are_told_apart(
    arms: SimpleNamespace, order: str, by_joint: bool, unit: float
) -> None:
    tree, rng = arms.arm(), np.random.default_rng(3)
    log = arms.recording(tree, rng, seconds=12.0, size=2.0)
    time, q, torque = log.channel("torque").time, log.channel("position").values, log.channel("torque").values
    v = np.gradient(q, time, axis=0)
    signals = {
        "q": unit * q,
        "v": unit * v,
        "t": torque,
        "a": unit * np.gradient(v, time, axis=0),
        "c": unit * q + 1e-3,
    }
    block = np.stack([signals[k] for k in order], axis=2 if by_joint else 1).reshape(len(time), -1)
    _, (training, _), notes = matched(tree, ([bare(time, block)], []))
    assert np.allclose(training[0].channel("position").values, q, atol=2e-3)
    assert np.array_equal(training[0].channel("torque").values, torque)
    assert training[0].has("velocity") == ("v" in order)
    if "v" in order:
        assert np.allclose(training[0].channel("velocity").values, v)
    assert any("no names" in note for note in notes)


def test_columns_that_no_arm_explains_are_refused_with_what_to_do(arms: SimpleNamespace) -> None:
    tree, rng = arms.arm(), np.random.default_rng(3)
    time = np.arange(2000) / 200.0
    noise = np.cumsum(rng.normal(size=(len(time), 2 * tree.n)), axis=0) * 0.02
    with pytest.raises(IdentificationError, match="have no names"):
        matched(tree, ([bare(time, noise)], []))
