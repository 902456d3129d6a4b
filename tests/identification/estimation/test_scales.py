# SPDX-License-Identifier: Apache-2.0
"""Torque sensors that were not calibrated alike are told from their logs, and what is none of that is not called so."""

from __future__ import annotations

import re
from types import SimpleNamespace

import numpy as np
import pytest

from trueup.identification.estimation.identify import Options, identify
from trueup.identification.estimation.result import Identification
from trueup.recording import Recording

SCALES = np.array([1.0, 1.0, 0.93, 1.08])


def logs(arms: SimpleNamespace, scales: np.ndarray) -> list[Recording]:
    made = [arms.recording(arms.arm(), np.random.default_rng(seed), f"run{seed}") for seed in range(3)]
    torque = [run.channel("torque") for run in made]
    return [
        run.replace(channels={**run.channels, "torque": c.replace(values=c.values * scales)})
        for run, c in zip(made, torque, strict=True)
    ]


def scaled(found: Identification) -> list[str]:
    return [w for w in found.warnings if "scaled differently" in w]


def test_joints_whose_torque_is_scaled_differently_are_named_with_their_scales(arms: SimpleNamespace) -> None:
    runs = logs(arms, SCALES)
    found = identify(arms.arm(), runs[:2], runs[2:])
    (said,) = scaled(found)
    most = found.model.tree.joints.index(re.findall(r"against (\w+)", said)[0])
    told = re.findall(r"(\w+) ([-+][\d.]+) \+- ([\d.]+) %", said)
    assert told
    for joint, value, half in told:
        true = 100.0 * (SCALES[found.model.tree.joints.index(joint)] / SCALES[most] - 1.0)
        assert abs(float(value) - true) < 2.0 * float(half) + 0.1  # as rounded
    assert not scaled(identify(arms.arm(), runs[:2], runs[2:], options=Options(gains=True)))


@pytest.mark.parametrize("common", [1.0, 1.3])
def test_torque_on_one_scale_is_left_alone(arms: SimpleNamespace, common: float) -> None:
    runs = logs(arms, np.full(4, common))
    assert not scaled(identify(arms.arm(), runs[:2], runs[2:]))
