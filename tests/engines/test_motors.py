# SPDX-License-Identifier: Apache-2.0
"""Arms commanded by torque: what inverse dynamics sees of their drives, and joints that friction holds still."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest

from trueup.arrays import Array
from trueup.engines.mujoco.model import load
from trueup.engines.mujoco.setup.motors import Drive, drives_seen
from trueup.loop.calibrate import Options
from trueup.loop.checks import check
from trueup.loop.prepare import prepare
from trueup.recording import Channel, Recording

ARM = """<mujoco><option timestep="2e-3" integrator="implicitfast"/><worldbody><body>
<joint name="shoulder" axis="0 0 1" {shoulder}/><geom type="capsule" size=".04" fromto="0 0 0 .4 0 0" mass="3"/>
<body pos=".4 0 0"><joint name="elbow" axis="0 1 0" {elbow}/>
<geom type="capsule" size=".03" fromto="0 0 0 .3 0 0" mass="1.5"/>
<body pos=".3 0 0"><joint name="wrist" axis="1 0 0" {wrist}/>
<geom type="box" size=".03 .05 .02" pos="0 .02 0" mass=".4"/></body></body></body></worldbody>
<actuator><motor name="m1" joint="shoulder"/><motor name="m2" joint="elbow"/>
<motor name="m3" joint="wrist"/></actuator></mujoco>"""
TRUTH = {"shoulder": (1.2, 0.8, 0.15), "elbow": (0.9, 0.4, 0.08), "wrist": (0.6, 0.1, 0.02)}
"""N m of friction, N m s/rad, kg m2 of the rotor; the wrist's friction is more than its motor ever gives."""
PLAIN = ARM.format(shoulder="", elbow="", wrist="")
JOINTS = tuple(TRUTH)


def _recording(seed: int) -> Recording:
    """Six seconds of a computed torque that knows nothing of the drives, at 100 Hz."""
    drives = {j: f'frictionloss="{f}" damping="{d}" armature="{a}"' for j, (f, d, a) in TRUTH.items()}
    model, plain = mujoco.MjModel.from_xml_string(ARM.format(**drives)), mujoco.MjModel.from_xml_string(PLAIN)
    data, own, rng, rows = mujoco.MjData(model), mujoco.MjData(plain), np.random.default_rng(seed), []
    pace, phase = rng.uniform(1.5, 3.0, (3, 2)), rng.uniform(0.0, 6.0, (3, 2))
    for k in range(3000):
        if k % 5 == 0:
            wanted = np.array([0.5, 0.5, 0.0]) * np.sin(pace * data.time + phase).mean(axis=1)
            own.qpos[:], own.qvel[:], own.qacc[:] = data.qpos, 0.0, 150.0 * (wanted - data.qpos) - 20.0 * data.qvel
            mujoco.mj_inverse(plain, own)
            data.ctrl[:] = own.qfrc_inverse * (1.0, 1.0, 0.3)
            rows.append([data.time, *(data.qpos + rng.normal(0.0, 1e-4, 3)), *data.ctrl])
        mujoco.mj_step(model, data)
    time, seen, told = np.split(np.array(rows), [1, 4], axis=1)
    return Recording(
        f"run{seed}",
        {"position": Channel("position", JOINTS, "rad", time[:, 0], seen),
         "command_torque": Channel("command_torque", ("m1", "m2", "m3"), "N m", time[:, 0], told)},
    )  # fmt: skip


@pytest.fixture(scope="module")
def recordings() -> list[Recording]:
    return [_recording(0), _recording(1)]


def test_inverse_dynamics_sees_drives_and_joints_held_still(tmp_path: Path, recordings: list[Recording]) -> None:
    (tmp_path / "arm.xml").write_text(PLAIN)
    seen = drives_seen(load(tmp_path / "arm.xml"), recordings)
    for joint in ("shoulder", "elbow"):
        drive = seen[joint]
        assert (drive.friction, drive.damping, drive.armature) == pytest.approx(TRUTH[joint], rel=0.35)
    assert seen["wrist"].damping is None
    told = recordings[0].channel("command_torque").column("m3")
    assert seen["wrist"].friction > 1.5 * np.abs(told).max()


def test_friction_is_seen_where_links_are_heavier_than_the_file_has_them(tmp_path: Path) -> None:
    arm = """<mujoco><option timestep="2e-3" integrator="implicitfast"/><worldbody><body>
    <joint name="j" axis="0 1 0" {drive}/><geom size=".05" mass="{mass}" pos="0 0 -.3"/></body></worldbody>
    <actuator><motor name="m" joint="j"/></actuator></mujoco>"""
    (tmp_path / "arm.xml").write_text(arm.format(drive="", mass=1.0))
    model = mujoco.MjModel.from_xml_string(arm.format(drive='frictionloss=".4" damping=".3" armature=".02"', mass=1.6))
    data, rng, time = mujoco.MjData(model), np.random.default_rng(0), 0.01 * np.arange(600, dtype=np.float64)
    told, seen = np.zeros((2, 600, 1))
    for k, t in enumerate(time):
        wanted = 0.9 * (1.0 - np.cos(1.3 * t)) + 0.2 * np.sin(3.0 * t)
        told[k] = 60.0 * (wanted - data.qpos) - 4.0 * data.qvel
        seen[k], data.ctrl[:] = data.qpos + rng.normal(0.0, 1e-4, 1), told[k]
        mujoco.mj_step(model, data, 5)
    channels = (Channel("position", ("j",), "rad", time, seen), Channel("command_torque", ("m",), "N m", time, told))
    drive = drives_seen(load(tmp_path / "arm.xml"), [Recording("run", {c.name: c for c in channels})])["j"]
    assert (drive.friction, drive.damping) == pytest.approx((0.4 / 1.6, 0.3 / 1.6), rel=0.35)  # beside a link of 1 kg


def test_drives_are_seen_beside_fingers_that_nobody_measured(tmp_path: Path, recordings: list[Recording]) -> None:
    finger = '<body><joint name="finger" type="slide"/><geom type="box" size=".01 .01 .01" mass=".01"/></body>'
    (tmp_path / "hand.xml").write_text(PLAIN.replace("</body></body></body>", f"{finger}</body></body></body>"))
    seen = drives_seen(load(tmp_path / "hand.xml"), recordings)
    assert set(seen) == set(JOINTS)
    assert seen["shoulder"].friction == pytest.approx(TRUTH["shoulder"][0], rel=0.35)


def test_an_arm_without_friction_in_its_file_is_calibrated_from_torques(
    tmp_path: Path, recordings: list[Recording]
) -> None:
    (tmp_path / "arm.xml").write_text(PLAIN)
    found = prepare(tmp_path / "arm.xml", recordings[:1], recordings[1:]).calibrate(
        Options(cross_validate=False, lacking=False)
    )
    values = {e.name: e.value for e in found.estimates}
    for joint in ("shoulder", "elbow"):
        assert values[f"{joint}.friction"] == pytest.approx(TRUTH[joint][0], rel=0.05)
        assert values[f"{joint}.damping"] == pytest.approx(TRUTH[joint][1], rel=0.1)
    (judged,) = [r for r in found.replays if r.held_out]
    error = np.sqrt(np.mean((judged.after - judged.measured) ** 2, axis=0))
    assert np.all(error < 3e-3), error  # the wrist too, which the model alone would let dangle


def test_torques_are_not_said_to_lead_joints(recordings: list[Recording]) -> None:
    bare = [r.with_channel(r.channel("command_torque").replace(labels=JOINTS, unit="")) for r in recordings]
    assert not [w for w in check(bare[:1], bare[1:]) if "its own command" in w or "follows the command" in w]


def test_recordings_of_one_sample_or_of_gaps_tell_nothing(tmp_path: Path, recordings: list[Recording]) -> None:
    (tmp_path / "arm.xml").write_text(PLAIN)
    model, whole = load(tmp_path / "arm.xml"), recordings[0]
    late = whole.channel("position").time.copy()
    late[-1] += 1e9
    for time in (late[:1], late):
        parts = [c.replace(time=time, values=c.values[: len(time)]) for c in whole.channels.values()]
        assert drives_seen(model, [whole.replace(channels={c.name: c for c in parts})]) == {}


def _seen_of_one(folder: Path, true: str, command: Callable[[Array], Array], known: str = "", motor: str = "") -> Drive:
    """What is seen of a single joint without gravity, which truly has other attributes, in three seconds at 100 Hz."""
    arm = """<mujoco><option timestep="2e-3" integrator="implicitfast"/><worldbody><body><joint name="j" {}/>
    <inertial pos="0 0 0" mass="1" diaginertia=".01 .01 .01"/></body></worldbody>
    <actuator><motor name="m" joint="j" {}/></actuator></mujoco>"""
    (folder / "arm.xml").write_text(arm.format(known, motor))
    model = mujoco.MjModel.from_xml_string(arm.format(f"{known} {true}", motor))
    data, rng, time = mujoco.MjData(model), np.random.default_rng(0), 0.01 * np.arange(300, dtype=np.float64)
    told, seen = command(time)[:, None], np.zeros((300, 1))
    for k in range(300):
        seen[k], data.ctrl[:] = data.qpos + rng.normal(0.0, 1e-5, 1), told[k] / model.actuator_gear[0, 0]
        mujoco.mj_step(model, data, 5)
    channels = (("position", "j", "rad", seen), ("command_torque", "m", "N m", told))
    log = Recording("log", {c: Channel(c, (label,), unit, time, values) for c, label, unit, values in channels})
    return drives_seen(load(folder / "arm.xml"), [log])["j"]


def test_a_joint_that_creeps_is_held_by_friction_not_damped(tmp_path: Path) -> None:
    drive = _seen_of_one(tmp_path, 'frictionloss="1"', lambda t: 0.8 * np.sin(7.0 * t))
    assert drive.damping is None
    assert drive.friction > 1.0


def test_a_joint_that_slides_is_damped_however_soon_its_speed_is_gone(tmp_path: Path) -> None:
    drive = _seen_of_one(tmp_path, 'frictionloss=".6" damping="2"', lambda t: 3.0 * np.sin(7.0 * t))
    assert (drive.friction, drive.damping) == pytest.approx((0.6, 2.0), rel=0.1)


def test_torques_at_the_joint_know_of_gears(tmp_path: Path) -> None:
    plain, geared = (
        _seen_of_one(tmp_path, 'frictionloss=".2" damping=".1"', lambda t: np.sin(7.0 * t), motor=f'gear="{gear}"')
        for gear in (1, 20)
    )
    assert geared.friction == pytest.approx(plain.friction, rel=1e-3)


def test_a_joint_that_moved_one_way_has_friction_of_its_torques_size(tmp_path: Path) -> None:
    drive = _seen_of_one(tmp_path, 'frictionloss=".2" damping=".1"', lambda t: 0.5 + 0.2 * np.sin(7.0 * t))
    assert drive.friction < 0.3
    assert drive.damping == pytest.approx(0.1, rel=0.2)


@pytest.mark.parametrize(
    ("joint", "motor"),
    [("", 'forcerange="-.4 .4"'), ('actuatorfrcrange="-.4 .4"', ""), ("", 'ctrlrange="-.2 .2" gear="2"')],
)
def test_torque_beyond_a_limit_was_not_given(tmp_path: Path, joint: str, motor: str) -> None:
    drive = _seen_of_one(tmp_path, 'frictionloss=".1" damping=".05"', lambda t: 2.0 * np.sin(7.0 * t), joint, motor)
    assert drive.friction == pytest.approx(0.1, rel=0.4)
    assert drive.damping == pytest.approx(0.05, rel=0.25)
