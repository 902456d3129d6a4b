# SPDX-License-Identifier: Apache-2.0
"""A task may price what is commanded: all engines show it, as it arrives at the drives, and name what they do not have."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trueup.arrays import Array
from trueup.controllers.controller import Observation
from trueup.engines.simulator import Rollout
from trueup.errors import ModelError, UnknownNameError
from trueup.loop.prepare import prepare
from trueup.trial import Observed, Trial

_ARM = """<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="j" axis="0 1 0" damping="1"/>
<geom size=".05" mass="1" pos="0 0 -.2"/><body pos="0 0 -.3"><joint name="k" axis="0 1 0" damping="1"/>
<geom size=".05" mass="1" pos="0 0 -.2"/></body></body></worldbody>
<actuator><motor name="lower" joint="k"/><motor name="upper" joint="j"/></actuator></mujoco>"""
TIME = np.arange(0.0, 1.0, 0.01)


class Steps:
    """Commands 1 and 2 times its setting, and from 0.5 s on the opposite."""

    period = 0.01

    def __init__(self, values: Array) -> None:
        self._size = values[:, -1:]

    def reset(self, observation: Observation) -> None:
        """Nothing to remember."""

    def command(self, observation: Observation) -> Array:
        return self._size * [1.0, 2.0] * (1.0 if observation.time < 0.495 else -1.0)


def _run(folder: Path, engine: str, labels: tuple[str, ...], channel: str = "command") -> Rollout:
    path = folder / "arm.xml"
    path.write_text(_ARM)
    simulator = prepare(path, [], propose=False, engine=engine).simulator
    trial = Trial("steps", 0.0, 0.99, None, {channel: Observed(labels, "N m", TIME)})
    (rollout,) = simulator.rollout([trial], np.array([[0.1], [0.3]]), Steps)
    return rollout


@pytest.mark.parametrize("engine", ["", "dart"])
@pytest.mark.parametrize("labels", [("upper", "lower"), ("j", "k")])
def test_what_a_controller_commands_is_observed(tmp_path: Path, engine: str, labels: tuple[str, ...]) -> None:
    if engine:
        pytest.importorskip("dartpy")
    seen = _run(tmp_path, engine, labels).channels["command"]
    sign = np.where(TIME < 0.495, 1.0, -1.0)[:, None]
    np.testing.assert_allclose(seen, np.array([0.1, 0.3])[:, None, None] * sign * [2.0, 1.0])


def test_what_cannot_be_observed_is_named_with_what_can(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match=r"actuator 'midle' is not in .* lower, upper"):
        _run(tmp_path, "", ("midle",))
    with pytest.raises(
        ModelError, match=r"'current' of 'steps' is no signal of .*; it has: command, position, torque, velocity"
    ):
        _run(tmp_path, "", ("j",), "current")


@pytest.mark.parametrize("engine", ["", "dart"])
def test_a_joint_that_the_model_has_not_is_named_whatever_simulates_it(tmp_path: Path, engine: str) -> None:
    if engine:
        pytest.importorskip("dartpy")
    with pytest.raises(UnknownNameError, match=r"joint 'elbow' is not in .* j, k"):
        _run(tmp_path, engine, ("elbow",), "position")
