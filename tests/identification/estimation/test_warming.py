# SPDX-License-Identifier: Apache-2.0
"""Friction that changes from recording to recording is told with its share, and friction that stays is not said to change."""

from __future__ import annotations

import re
from types import SimpleNamespace

import numpy as np

from trueup.identification.estimation.identify import Options, identify
from trueup.recording import Recording

FAST = Options(consistent=False)


def logs(arms: SimpleNamespace, friction: tuple[float, ...]) -> list[Recording]:
    """Recordings whose friction is these times that of the arm: what an arm without motion of its own lacks is added."""
    made = []
    for k, times in enumerate(friction):
        run = arms.recording(arms.arm(), np.random.default_rng(40 + k), f"run{k}")
        speed = np.gradient(run.channel("position").values, run.time, axis=0)
        speed = np.column_stack([np.convolve(v, np.ones(9) / 9.0, "same") for v in speed.T])
        own = arms.coulomb * np.tanh(speed / 0.02) + arms.viscous * speed
        torque = run.channel("torque")
        made.append(run.with_channel(torque.replace(values=torque.values + (times - 1.0) * own)))
    return made


def changed(runs: list[Recording], arms: SimpleNamespace) -> list[str]:
    return [w for w in identify(arms.arm(), runs, options=FAST).warnings if "friction changed" in w]


def test_how_much_friction_falls_from_recording_to_recording_is_said(arms: SimpleNamespace) -> None:
    (said,) = changed(logs(arms, (1.0, 0.8, 0.7)), arms)
    told = re.findall(r"in '(\w+)' ([-+][\d.]+) \+- ([\d.]+) %", said)
    assert [name for name, _, _ in told] == ["run1", "run2"]
    for (_, share, half), true in zip(told, (-20.0, -30.0), strict=True):
        assert abs(float(share) - true) < 2.0 * float(half) < 20.0


def test_friction_that_stays_is_not_said_to_change(arms: SimpleNamespace) -> None:
    assert not changed(logs(arms, (1.0, 1.0, 1.0)), arms)
