# SPDX-License-Identifier: Apache-2.0
"""Counts, pulses and shares that servos were told are known by how joints follow; soft and late servos are not called so."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest

import trueup
from trueup.arrays import Array
from trueup.engines.family import family_of
from trueup.errors import RecordingError
from trueup.loop.prepare import prepare
from trueup.recording import Channel, Recording

JOINTS = ("pan", "lift", "elbow")
MODEL = """
<mujoco><compiler angle="radian"/><option timestep="0.002"/><default><joint damping=".2" range="-1.8 1.8"/></default>
<worldbody><body pos="0 0 .3"><joint name="pan" axis="0 0 1"/><geom type="box" size=".02 .02 .02" mass=".1"/>
<body><joint name="lift" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 .12 0 0" size=".015" mass=".15"/>
<body pos=".12 0 0"><joint name="elbow" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 .12 0 0" size=".012" mass=".12"/>
</body></body></body></worldbody><actuator><position name="pan" joint="pan" kp="8" kv=".2"/>
<position name="lift" joint="lift" kp="8" kv=".2"/><position name="elbow" joint="elbow" kp="8" kv=".2"/>
</actuator></mujoco>"""
COUNTS = 4096.0 / (2.0 * np.pi)


@pytest.fixture(scope="module")
def soft() -> Recording:
    """An arm whose servos are softer than the model's, stick, and sag by up to 80 mrad."""
    truth = MODEL.replace('damping=".2"', 'damping=".3" frictionloss=".04"').replace('kp="8"', 'kp="3"')
    m, rng = mujoco.MjModel.from_xml_string(truth), np.random.default_rng(4)
    data, time = mujoco.MjData(m), np.arange(0.0, 16.0, 0.02)
    pace, phase = rng.uniform(0.5, 4.0, (2, 3)), rng.uniform(0.0, 6.0, (2, 3))
    told = np.array([0.1, -0.4, 0.5]) + 0.35 * np.sum(np.sin(pace * time[:, None, None] + phase), axis=1)
    data.qpos[:], measured = told[0], []
    for command in told:
        measured.append(data.qpos + rng.normal(0.0, 5e-4, 3))
        data.ctrl[:] = command
        for _ in range(10):
            mujoco.mj_step(m, data)
    channels = {
        "command": Channel("command", JOINTS, "", time, told),
        "position": Channel("position", JOINTS, "rad", time, np.array(measured)),
    }
    return Recording("log", channels)


@pytest.fixture
def model(tmp_path: Path) -> Path:
    path = tmp_path / "arm.xml"
    path.write_text(MODEL)
    return path


def told_in(recording: Recording, numbers: Callable[[Array], Array]) -> Recording:
    command = recording.channel("command")
    return recording.with_channel(command.replace(values=numbers(command.values)))


@pytest.mark.parametrize(
    ("numbers", "words"),
    [
        (lambda q: np.round(2048.0 + COUNTS * q), "4096 counts a turn"),
        (lambda q: np.round(2048.0 + COUNTS * q * [1.0, -1.0, 1.0]), "4096 counts a turn"),
        (lambda q: np.round(512.0 + 1023.0 / np.radians(300.0) * q), "1023 counts in 300 degrees"),
        (lambda q: np.round(1500.0 + 1000.0 / np.radians(90.0) * q), "pulses of 1000 us in 90 degrees"),
        (lambda q: 100.0 * q / 1.8, "percent of half the range"),
        (lambda q: 50.0 + 50.0 * q / 1.8, "percent of the range"),
        (lambda q: np.round(np.degrees(q), 2), "degrees"),
    ],
)
def test_numbers_of_soft_servos_become_the_rad_that_they_were(
    soft: Recording, model: Path, numbers: Callable[[Array], Array], words: str
) -> None:
    ready = trueup.prepare(model, [told_in(soft, numbers)])
    command, known = ready.recordings[0].channel("command"), soft.channel("command").values
    (found,) = (d for d in ready.diagnoses if d.name == "commands")
    assert f"taken as {words}" in str(found)
    assert command.unit == "rad"
    grid = np.max(np.abs(numbers(known + 1e-3) - numbers(known))) / 1e-3  # numbers for each rad
    turned = np.sign(np.mean((command.values - command.values.mean(0)) * (known - known.mean(0)), axis=0))
    assert np.abs(turned * command.values - known).max() < 2.0 / grid + 0.01
    refused = trueup.prepare(model, [told_in(soft, numbers)], refuse=["commands"])
    assert refused.recordings[0].channel("command").unit == ""


def test_soft_servos_that_were_told_rad_have_no_other_unit(soft: Recording, model: Path) -> None:
    for numbers in (lambda q: q, lambda q: 0.5 * q, lambda q: 0.1 * q):  # of small moves, too
        same = told_in(soft, numbers)
        position = same.channel("position")
        same = same.with_channel(position.replace(values=numbers(position.values)))
        ready = trueup.prepare(model, [same])
        assert not [d for d in ready.diagnoses if d.name == "commands"]
        assert np.array_equal(ready.recordings[0].channel("command").values, same.channel("command").values)


def test_a_calibrated_file_whose_servos_have_zeros_takes_counts_as_well(soft: Recording, tmp_path: Path) -> None:
    zeroed = '<general name="lift" joint="lift" biastype="affine" gainprm="6" biasprm="0.02 -6 -.2"/>'
    (file := tmp_path / "fit.xml").write_text(
        MODEL.replace('<position name="lift" joint="lift" kp="8" kv=".2"/>', zeroed)
    )
    counted = told_in(soft, lambda q: np.round(2048.0 + COUNTS * q))
    told = trueup.prepare(file, [counted], propose=False).recordings[0].channel("command")
    assert np.allclose(told.values, soft.channel("command").values, atol=1e-3)


def test_a_joint_that_stays_counts_as_the_others(soft: Recording, model: Path) -> None:
    still = told_in(soft, lambda q: np.round(2048.0 + COUNTS * q * [1.0, 1.0, 0.0]))
    position = still.channel("position")
    still = still.with_channel(position.replace(values=position.values * [1.0, 1.0, 0.0] + [0.0, 0.0, 0.01]))
    command = trueup.prepare(model, [still]).recordings[0].channel("command")
    assert np.allclose(command.column("elbow"), 0.0)


def test_numbers_that_nothing_tells_are_asked_about(soft: Recording, model: Path) -> None:
    rng = np.random.default_rng(0)
    of_a_tool = told_in(soft, lambda q: 300.0 * rng.normal(size=q.shape))
    with pytest.raises(
        RecordingError, match=r"'pan' have no unit, and from -\d+.* to \d+.* no rad.*does not tell.*scale"
    ):
        trueup.prepare(model, [of_a_tool])
    trueup.prepare(model, [of_a_tool], refuse=["commands"])


@pytest.mark.realdata
def test_a_real_arm_is_known_by_any_of_its_motions(real_data: Path) -> None:
    names = {"Rotation": "shoulder_pan", "Pitch": "shoulder_lift", "Elbow": "elbow_flex", "Wrist_Pitch": "wrist_flex",
             "Wrist_Roll": "wrist_roll", "Jaw": "gripper"}  # fmt: skip
    arm, known = real_data / "so101" / "model" / "so101_new_calib.xml", 0
    runs = [r.rename(names) for r in trueup.read([real_data / "so101" / "recordings"])]
    for run in runs:
        command = run.channel("command")
        counted = command.replace(unit="", values=np.round(2048.0 + COUNTS * command.values))
        plain = trueup.prepare(arm, [run.with_channel(command.replace(unit=""))], propose=False)
        assert not [d for d in plain.diagnoses if d.name == "commands"]
        try:
            found = trueup.prepare(arm, [run.with_channel(counted)], propose=False).recordings[0].channel("command")
        except RecordingError:  # small moves: it is asked
            continue
        known += float(np.abs(found.values - command.values).max()) < 0.25
    assert known >= 10


def test_steps_of_a_slide_are_asked_about_and_are_no_metres(tmp_path: Path) -> None:
    """200000 steps of a stepper were taken for 200 km, without a word."""
    (tmp_path / "axis.xml").write_text(
        '<mujoco><worldbody><body><joint name="x" type="slide" range="0 0.6"/><geom size=".1"/></body></worldbody>'
        '<actuator><position name="x" joint="x" kp="1000" kv="50"/></actuator></mujoco>'
    )
    time = np.arange(0.0, 4.0, 0.01)
    way = 0.3 - 0.2 * np.cos(time)[:, None]
    channels = Channel("position", ("x",), "m", time, way), Channel("command", ("x",), "", time, 4e5 * way)
    steps = Recording("moves", {c.name: c for c in channels})
    with pytest.raises(RecordingError, match=r"they are no m\. The joint follows them, 4e\+05 for each rad \(or m\)"):
        prepare(tmp_path / "axis.xml", [steps])
    counts = steps.with_channel(channels[0].replace(unit="", values=2e4 * way))
    family = family_of(tmp_path / "axis.xml")
    model = family.load(tmp_path / "axis.xml")
    (seen,) = family.in_units(model, [counts])
    assert (seen.channel("position").unit, seen.channel("command").unit) == ("", "")
    (said,) = family.doubts(model, [seen])
    assert "'x', which reaches 1e+04, is far beyond its range" in said
