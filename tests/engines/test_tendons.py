# SPDX-License-Identifier: Apache-2.0
"""A differential wrist: two motors turn two joints together, and logs hold the motors' angles."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from trueup.cli import main
from trueup.engines.mujoco.model import load
from trueup.engines.mujoco.setup.tendons import with_joints_told
from trueup.loop.calibrate import Options
from trueup.loop.prepare import prepare
from trueup.recording import Channel, Recording

WRIST = """<mujoco><worldbody><body><joint name="elbow" axis="0 1 0"/><geom size=".05"/>
<body pos=".3 0 0"><joint name="pitch" axis="0 1 0"/><geom size=".03"/><body><joint name="roll" axis="1 0 0"/>
<geom size=".02" pos=".05 .02 0"/></body></body></body></worldbody>
<tendon><fixed name="l"><joint joint="pitch" coef=".5"/><joint joint="roll" coef=".4"/></fixed>
<fixed name="r"><joint joint="pitch" coef=".5"/><joint joint="roll" coef="-.4"/></fixed></tendon>
<actuator><position joint="elbow" kp="40"/><position name="left" tendon="l" kp="15" gear="2"/>
<position name="right" tendon="r" kp="15"/></actuator></mujoco>"""
TIME = np.arange(0.0, 2.0, 0.02)
ELBOW, PITCH, ROLL = np.sin(TIME), 0.5 * np.sin(2.0 * TIME), np.cos(TIME) - 1.0
LEFT, RIGHT = 2.0 * (0.5 * PITCH + 0.4 * ROLL), 0.5 * PITCH - 0.4 * ROLL


def _log(**columns: np.ndarray) -> Recording:
    told = np.stack([ELBOW, LEFT, RIGHT], axis=1)
    return Recording("log", {
        "command": Channel("command", ("elbow", "left", "right"), "rad", TIME, told),
        "position": Channel("position", tuple(columns), "rad", TIME, np.stack(list(columns.values()), axis=1)),
    })  # fmt: skip


@pytest.fixture
def file(tmp_path: Path) -> Path:
    (tmp_path / "wrist.xml").write_text(WRIST)
    return tmp_path / "wrist.xml"


def test_joints_are_told_from_the_motors_that_turn_several(file: Path) -> None:
    ready = prepare(file, [_log(elbow=ELBOW, Left=LEFT, Right=RIGHT)])
    position = ready.recordings[0].channel("position")
    np.testing.assert_allclose(
        position.select(["elbow", "pitch", "roll"]).values, np.stack([ELBOW, PITCH, ROLL], axis=1)
    )
    (found,) = [d for d in ready.diagnoses if d.name == "tendons"]
    assert "pitch from Left and Right" in str(found)


def test_one_motor_and_one_joint_tell_the_other(file: Path) -> None:
    (run,), _ = with_joints_told(load(file), [_log(pitch=PITCH, right=RIGHT)])
    np.testing.assert_allclose(run.channel("position").column("roll"), ROLL, atol=1e-12)


def test_motors_beside_all_of_their_joints_are_left_out_and_one_alone_stays(file: Path) -> None:
    (run, other), notes = with_joints_told(load(file), [_log(pitch=PITCH, roll=ROLL, left=LEFT), _log(left=LEFT)])
    assert run.channel("position").labels == ("pitch", "roll")
    assert other.channel("position").labels == ("left",)
    assert "left out" in notes[0]


def test_inspect_takes_such_motors_for_no_joints(
    file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    table = np.stack([TIME, ELBOW, LEFT, RIGHT, ELBOW, LEFT, RIGHT], axis=1)
    head = "t,cmd_elbow,cmd_left,cmd_right,pos_elbow,pos_left,pos_right"
    np.savetxt(file.with_name("log.csv"), table, delimiter=",", header=head, comments="")
    monkeypatch.chdir(file.parent)
    assert main(["inspect", "log.csv", "--model", "wrist.xml"]) == 0
    said = capsys.readouterr().out
    assert "by order" not in said
    assert "[elbow, pitch, roll]" in said


MIMIC = """<mujoco><worldbody><body><joint name="elbow" axis="0 1 0"/><geom size=".05"/>
<body><joint name="finger_left" type="slide" range="0 .04"/><geom size=".01"/></body>
<body><joint name="finger_right" type="slide" axis="0 0 -1" range="0 .04"/><geom size=".01"/></body></body></worldbody>
<equality><joint joint1="finger_right" joint2="finger_left"/></equality>
<actuator><position joint="elbow"/><position name="gripper" joint="finger_left"/></actuator></mujoco>"""


def test_the_opening_of_a_gripper_is_that_of_the_finger_which_the_gripper_drives(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Not of the other one, which follows it: the drive was not calibrated then."""
    (tmp_path / "arm.xml").write_text(MIMIC)
    opening = 20.0 + 15.0 * np.sin(TIME)
    table = np.stack([TIME, ELBOW, opening, ELBOW, opening], axis=1)
    head = "t,goal_elbow_rad,gripper_goal_mm,present_elbow_rad,gripper_width_mm"
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header=head, comments="")
    monkeypatch.chdir(tmp_path)
    assert main(["inspect", "log.csv", "--model", "arm.xml"]) == 0
    said = capsys.readouterr().out
    assert "by order" not in said
    assert "gripper_width -> finger_left" in said


def test_inspect_names_a_command_as_the_drive_of_several_joints_that_is_alike(
    file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It said that nothing was found for `flexor`, and that `flexor_motor` was left."""
    text = file.read_text().replace('name="left"', 'name="flexor_motor"').replace('name="right"', 'name="turn_motor"')
    file.write_text(text)
    table = np.stack([TIME, ELBOW, LEFT, RIGHT, ELBOW, PITCH, ROLL], axis=1)
    head = "t,elbow_set_rad,flexor_set_rad,turn_set_rad,elbow_rad,pitch_rad,roll_rad"
    np.savetxt(file.with_name("log.csv"), table, delimiter=",", header=head, comments="")
    monkeypatch.chdir(file.parent)
    assert main(["inspect", "log.csv", "--model", "wrist.xml"]) == 0
    said = capsys.readouterr().out
    assert "no joint of the model was found" not in said
    assert "flexor -> flexor_motor, turn -> turn_motor" in said
    assert 'flexor = "flexor_motor"' in file.with_name("mapping.toml").read_text()


GRIPPER = """<mujoco><worldbody><body><joint name="elbow" axis="0 1 0"/><geom size=".05"/>
<body><joint name="left" type="slide" axis="0 1 0" range="0 .04"/><geom size=".01"/></body>
<body><joint name="right" type="slide" axis="0 -1 0" range="0 .04"/><geom size=".01"/></body></body></worldbody>
<tendon><fixed name="both"><joint joint="left" coef="1"/><joint joint="right" coef="1"/></fixed></tendon>
<equality><joint joint1="right" joint2="left"/></equality>
<actuator><position joint="elbow" kp="40"/><position name="gripper" tendon="both" kp="300"/></actuator></mujoco>"""


@pytest.mark.parametrize("whole", [100.0, 1.0, 80.0, 0.08], ids=["percent", "share", "mm", "m"])
def test_fingers_that_follow_one_another_are_told_from_the_drive_of_both(tmp_path: Path, whole: float) -> None:
    """One opening tells two fingers that the model ties, whatever unit it was logged in, and so does its command."""
    (tmp_path / "arm.xml").write_text(GRIPPER)
    share = 0.5 - 0.48 * np.cos(3.0 * TIME)
    values = np.stack([ELBOW, whole * share], axis=1)
    unit = "" if whole > 2.0 else "rad"
    log = Recording("log", {n: Channel(n, ("elbow", "gripper"), unit, TIME, values) for n in ("command", "position")})
    (run,) = prepare(tmp_path / "arm.xml", [log], propose=False).recordings
    position, command = run.channel("position"), run.channel("command")
    np.testing.assert_allclose(
        position.select(["left", "right"]).values, np.stack([0.04 * share] * 2, axis=1), atol=1e-9
    )
    np.testing.assert_allclose(command.column("gripper"), 0.08 * share, atol=1e-9)
    assert {position.unit_of("left"), command.unit_of("gripper")} == {"m"}


FINGER = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody><body>
<joint name="near" axis="0 1 0" stiffness=".08" damping="{damping}" frictionloss="{friction}"/>
<inertial pos=".02 0 0" mass=".02" diaginertia="1e-6 4e-6 4e-6"/><body pos=".04 0 0">
<joint name="far" axis="0 1 0" stiffness=".05" damping="{damping}" frictionloss="{friction}"/>
<inertial pos=".015 0 0" mass=".01" diaginertia="5e-7 1e-6 1e-6"/></body></body></worldbody>
<tendon><fixed name="cable"><joint joint="near" coef=".01"/><joint joint="far" coef=".008"/></fixed></tendon>
<actuator><position name="motor" tendon="cable" kp="3000" kv="{kv}"/></actuator></mujoco>"""


def test_the_damping_of_a_cables_motor_passes_for_no_delay_and_a_finger_for_no_heavy_rotor(tmp_path: Path) -> None:
    model = mujoco.MjModel.from_xml_string(FINGER.format(damping=0.003, friction=0.0, kv=60))
    data, rng, rows = mujoco.MjData(model), np.random.default_rng(3), []
    for k in range(3000):
        t = 0.002 * k
        data.ctrl[0] = 0.008 * (1.0 - np.cos(2.0 * t)) + 0.002 * np.sin(17.0 * t) * min(t, 1.0)
        if k % 3 == 0:
            rows.append((t, data.ctrl[0], *(data.qpos + 2e-4 * rng.standard_normal(2))))
        mujoco.mj_step(model, data)
    time, command, *angles = np.array(rows).T
    channels = [
        Channel("command", ("motor",), "m", time, command[:, None]),
        Channel("position", ("near", "far"), "rad", time, np.stack(angles, axis=1)),
    ]
    (tmp_path / "finger.xml").write_text(FINGER.format(damping=0.001, friction=0.0, kv=15))
    ready = prepare(tmp_path / "finger.xml", [Recording("log", {c.name: c for c in channels})])
    wanted = ready.only(["motor.kp", "motor.kv", "*.damping", "*.armature", "delay"])
    found = {e.name: e for e in wanted.calibrate(options=Options(cross_validate=False)).estimates}
    assert found["motor.kv"].low <= 60.0 <= found["motor.kv"].high
    assert found["delay"].value < 1e-3
    assert found["far.armature"].value < 1e-5  # kg m2, where the finger itself has 3e-6
