# SPDX-License-Identifier: Apache-2.0
"""A model in a plan is taken as `trueup calibrate` takes it: names, units, a base that is free."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trueup.campaign.events import Calibrated
from trueup.campaign.kinds import bicycle, in_windows, mujoco
from trueup.campaign.outcomes import belief_of
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.errors import JournalError, PlanError
from trueup.recording import Channel, Recording

HOPPER = """
<mujoco><compiler angle="radian"/><worldbody><geom type="plane" size="2 2 .1"/>
  <body name="trunk" pos="0 0 .5"><freejoint/><geom type="box" size=".1 .1 .05" mass="2"/>
    <body pos="0 0 -.05"><joint name="hip" axis="0 1 0" range="-1 1"/><geom size=".02" fromto="0 0 0 0 0 -.2" type="capsule"/>
      <body pos="0 0 -.2"><joint name="knee" axis="0 1 0" range="-2 .5"/>
        <geom size=".02" fromto="0 0 0 0 0 -.2" type="capsule"/>
  </body></body></body></worldbody>
  <actuator><position name="hip" joint="hip" kp="40"/><position name="knee" joint="knee" kp="40"/></actuator></mujoco>
"""
PARAMETERS = '[[parameter]]\nquantity = "kp"\nof = "*"\n'
TIME = np.arange(0.0, 3.0, 0.02)


@pytest.fixture
def model(tmp_path: Path) -> Path:
    (tmp_path / "parameters.toml").write_text(PARAMETERS)
    (tmp_path / "hopper.xml").write_text(HOPPER)
    return tmp_path / "hopper.xml"


def log(labels: tuple[str, ...], posed: bool) -> Recording:
    swing = np.stack([0.3 * np.sin(3 * TIME), 0.4 * np.sin(2 * TIME) - 0.5], axis=1)
    hip, knee = swing.T
    place = np.stack([0.0 * TIME, 0.0 * TIME, 0.07 + 0.2 * np.cos(hip) + 0.2 * np.cos(hip + knee)], axis=1)
    base = {
        "base_position": Channel("base_position", ("x", "y", "z"), "m", TIME, place),
        "base_orientation": Channel("base_orientation", ("roll", "pitch", "yaw"), "rad", TIME, np.zeros((len(TIME), 3))),
    }  # fmt: skip
    return Recording("run", {
        "command": Channel("command", labels, "rad", TIME, swing),
        "position": Channel("position", labels, "rad", TIME, swing),
        **(base if posed else {}),
    })  # fmt: skip


def test_a_base_is_free_unless_recordings_were_made_without_its_pose(model: Path) -> None:
    said: list[str] = []
    simulator = mujoco(model, said.append, (), model.with_name("parameters.toml")).simulator
    assert isinstance(simulator, MujocoSimulator)
    assert simulator.model.compiled.nq == 9
    assert said == []
    log_on_stand = log(("hip", "knee"), posed=False)
    hanging = mujoco(model, said.append, (log_on_stand,), model.with_name("parameters.toml")).simulator
    assert isinstance(hanging, MujocoSimulator)
    assert hanging.model.compiled.nq == 2
    assert "held in the air" in "\n".join(said)


def test_what_the_robot_did_is_named_as_the_model_needs_it(model: Path) -> None:
    ready = mujoco(model, print, (), model.with_name("parameters.toml"))
    pieces = ready.suited([log(("joint_1", "joint_2"), posed=True)])
    assert len(pieces) == 1
    assert all(p.channel("position").labels == ("hip", "knee") for p in pieces)
    assert ready.suited([]) == ()


def test_a_model_that_is_not_there_is_said_first(tmp_path: Path) -> None:
    with pytest.raises(PlanError, match="there is no file"):
        mujoco(tmp_path / "robot.xml", print)


def test_a_drive_is_judged_in_windows_as_it_was_fitted_and_one_that_stood_still_not_at_all() -> None:
    time = np.arange(0.0, 30.0, 0.05)
    still = np.zeros((len(time), 2))
    gone = np.stack([0.5 * time, np.zeros_like(time)], axis=1)
    drives = [
        Recording(name, {
            "command": Channel("command", ("speed", "steering"), "", time, still + np.array([0.5, 0.0])),
            "position": Channel("position", ("x", "y"), "m", time, places),
            "heading": Channel("heading", ("heading",), "rad", time, still[:, :1]),
        })
        for name, places in (("gone", gone), ("still", still))
    ]  # fmt: skip
    pieces = in_windows(6.0)(drives)
    assert len(pieces) == 5
    assert all(p.name.startswith("gone") for p in pieces)


def test_a_calibration_of_an_earlier_simulator_is_believed_with_the_rest_as_declared() -> None:
    names, nan = ("steering_lag", "steering_scale"), float("nan")
    event = Calibrated(
        1, names, ("s", ""), (0.2, 0.9), (True, False), (0.1, nan), (0.3, nan), ("identified", "frozen"), ((0.0025,),), 1.0,
        0.1, "m", ("drive",),
    )  # fmt: skip
    space = bicycle(
        0.5, parameters=("relaxation", "steering_lag", "steering_scale"), values={"position_noise": 0.01}
    ).parameters
    belief = belief_of(event, space)
    known = dict(zip(space.names, belief.values, strict=True))
    assert (known["steering_lag"], known["steering_scale"], known["relaxation"]) == (0.2, 0.9, 0.0)
    assert [space.names[k] for k in belief.unsure] == ["steering_lag"]


def test_a_calibration_of_what_a_simulator_no_longer_has_is_refused_with_its_names() -> None:
    nan = float("nan")
    event = Calibrated(
        1, ("pose_ahead", "steering_lag"), ("m", "s"), (0.1, 0.2), (False, True), (nan, 0.1), (nan, 0.3),
        ("frozen", "identified"), ((0.0025,),), 1.0, 0.1, "m", ("drive",),
    )  # fmt: skip
    with pytest.raises(JournalError, match="pose_ahead, which its simulator no longer has"):
        belief_of(event, bicycle(0.5, parameters=("steering_lag",), values={}).parameters)
