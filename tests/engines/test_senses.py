# SPDX-License-Identifier: Apache-2.0
"""A joint of an arm on servos that turns the other way in the log is named, by what it and its neighbours carry."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
import pytest

from trueup.engines.mujoco.model import Model, load
from trueup.engines.mujoco.setup.senses import turned_otherwise
from trueup.recording import Channel, Recording

JOINTS = ("slide", "shoulder", "elbow")
ARM = """<mujoco><compiler angle="radian"/><option integrator="implicitfast"/><worldbody>
 <body><joint name="slide" type="slide" axis="1 0 0" damping="20" frictionloss="4"/>
  <inertial pos="0 0 0" mass="4" diaginertia="0.02 0.02 0.02"/>
 <body><joint name="shoulder" axis="0 1 0" damping="0.8" frictionloss="0.4" armature="0.05"/>
  <inertial pos="0 0 -0.15" mass="{upper}" diaginertia="0.02 0.02 0.002"/>
 <body pos="0 0 -0.3"><joint name="elbow" axis="0 1 0" damping="0.5" frictionloss="0.3" armature="0.03"/>
  <inertial pos="0 0 -0.12" mass="{fore}" diaginertia="0.008 0.008 0.001"/></body></body></body></worldbody>
 <actuator><position joint="slide" kp="3000" kv="100"/><position joint="shoulder" kp="{kp}" kv="3"/>
  <position joint="elbow" kp="60" kv="2"/></actuator></mujoco>"""


@pytest.fixture(scope="module")
def log() -> Recording:
    """Ten seconds of an arm that is lighter and softer than its file, 12 ms late, with noise."""
    arm = mujoco.MjModel.from_xml_string(ARM.format(upper=1.8, fore=1.5, kp=110))
    state, time, rng = mujoco.MjData(arm), np.arange(0.0, 10.0, 0.01), np.random.default_rng(3)
    waves = np.sin(2.0 * np.pi * np.outer(time, [0.5, 0.37, 0.61])) + 0.4 * np.sin(np.outer(time, [7.0, 5.0, 9.0]))
    told = np.minimum(time, 1.0)[:, None] * waves * [0.15, 0.6, 0.7]
    angles = np.empty_like(told)
    for i in range(len(time)):
        angles[i], state.ctrl[:] = state.qpos, told[max(i - 1, 0)]
        mujoco.mj_step(arm, state, 5)
    angles += rng.normal(0.0, 3e-4, angles.shape)
    return Recording("log", {name: Channel(name, JOINTS, "rad", time, values, ("m", "rad", "rad"))
                             for name, values in (("command", told), ("position", angles))})  # fmt: skip


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Model:
    path = tmp_path_factory.mktemp("arm") / "arm.xml"
    path.write_text(ARM.format(upper=2.6, fore=1.2, kp=200))
    return load(path)


def flipped(log: Recording, joints: Sequence[str]) -> Recording:
    """The log of a robot whose drives count these joints the other way."""
    signs = np.where(np.isin(JOINTS, joints), -1.0, 1.0)
    for name in ("command", "position"):
        log = log.with_channel(log.channel(name).replace(values=signs * log.channel(name).values))
    return log


@pytest.mark.parametrize(
    ("joints", "said"),
    [(["shoulder"], "as if 'shoulder' tu"), (["elbow"], "as if 'elbow' tu"), (["shoulder", "elbow"], "as if 'slide' tu")],
)  # fmt: skip
def test_a_joint_that_turns_the_other_way_is_named(joints: list[str], said: str, log: Recording, model: Model) -> None:
    """Seen in a mirror, the arm of which two joints were turned round is one whose slide was."""
    (doubt,) = turned_otherwise(model, [flipped(log, joints)])
    assert said in doubt
    assert "set sign = -1 of it in the mapping" in doubt


def test_nothing_is_said_of_joints_that_turn_as_in_the_model_or_of_which_nothing_tells(
    log: Recording, model: Model
) -> None:
    """The masses in the file are wrong by a third, and a mirror image moves as the arm itself does."""
    assert not turned_otherwise(model, [log])
    assert not turned_otherwise(model, [flipped(log, JOINTS)])
    assert not turned_otherwise(model, [log.without("command")])
    assert not turned_otherwise(model, [])
