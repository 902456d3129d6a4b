# SPDX-License-Identifier: Apache-2.0
"""A calibrated file stays what it was: what was done for the fit alone (held base, servos, spared contacts) is not in it."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.calibration import Calibration, Estimate
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.loop.prepare import Preparation, prepare
from trueup.recording import Channel, Recording

Array = NDArray[np.float64]

_LEG = """
      <body name="{0}" pos="{1} 0"><!-- leg {0} -->
        <joint name="{0}_hip" axis="0 1 0" damping=".5" range="-1.5 1.5"/>
        <geom type="capsule" size=".02" fromto="0 0 0 .08 0 -.12" mass=".15"/>
        <body name="{0}_shank" pos=".08 0 -.12"><joint name="{0}_knee" axis="0 1 0" damping=".5" range="-2.5 2.5"/>
          <geom name="{0}_foot" type="capsule" size=".02" fromto="0 0 0 -.08 0 -.12" mass=".1"/></body></body>"""
_LEGS = "".join(
    _LEG.format(n, p) for n, p in (("fl", ".15 .1"), ("fr", ".15 -.1"), ("rl", "-.15 .1"), ("rr", "-.15 -.1"))
)
JOINTS = tuple(f"{leg}_{joint}" for leg in ("fl", "fr", "rl", "rr") for joint in ("hip", "knee"))
_SERVOS = "".join(f'<position name="{j}" joint="{j}" kp="{{kp}}" kv=".4" ctrlrange="-2 2"/>' for j in JOINTS)
_MOTORS = "".join(f'<motor name="{j}_motor" joint="{j}" ctrlrange="-20 20"/>' for j in JOINTS)
ROBOT = (
    """<mujoco model="dog"><!-- made by hand -->
  <compiler angle="radian" autolimits="true"/>
  <option timestep=".002" integrator="implicitfast" cone="elliptic" impratio="10"/>
  <statistic extent="1.3"/>
  <worldbody>
    <body name="trunk" pos="0 0 .3"><freejoint name="root"/><site name="imu"/>
      <geom type="box" size=".2 .08 .04" mass="4" {trunk}/>"""
    + _LEGS
    + """
    </body>
  </worldbody>
  <actuator>{drives}</actuator>
  <sensor><framequat name="turn" objtype="site" objname="imu"/><gyro name="gyro" site="imu"/>
    <jointpos name="first" joint="fl_hip"/></sensor>
  <keyframe><key name="home" qpos="0 0 .265 1 0 0 0 {pose}" ctrl="{ctrl}"/>
    <key name="low" qpos="0 0 .2 1 0 0 0 {low}"/></keyframe>
</mujoco>
"""
)
FLOOR = '<geom name="floor" type="plane" size="5 5 .1"/>'
PLAIN = 'contype="0" conaffinity="0"'
_POSE, _LOW = " ".join(["0 0"] * 4), " ".join([".6 -1"] * 4)
JOINT = {"dof_damping", "dof_dampingpoly", "dof_frictionloss", "dof_armature", "dof_solimp"}
DRIVE = {"actuator_gainprm", "actuator_biasprm", "actuator_delay", "actuator_history", "actuator_historyadr",
         "actuator_ctrlspec"}  # fmt: skip
"""The last one: a <position> has no place for a zero of its own, <general> has."""
FOLLOWS = {"dof_M0", "dof_invweight0", "body_invweight0", "tendon_invweight0", "actuator_acc0", "bvh_aabb", "numeric_data",
           "numeric_adr", "numeric_size", "names", "paths"}  # fmt: skip
"""What MuJoCo computes of the rest, or counts names by."""


def robot(
    folder: Path, *, drives: str = "servos", trunk: str = PLAIN, kp: float = 40.0, included: bool = False
) -> Path:
    """The dog in a file, its floor before it or including it."""
    servos = drives == "servos"
    said = {"servos": _SERVOS.format(kp=kp), "motors": _MOTORS, "none": ""}[drives]
    ctrl = _POSE if servos else ""
    text = ROBOT.format(trunk=trunk, drives=said, pose=_POSE, low=_LOW, ctrl=ctrl)
    if not servos:
        text = text.replace(' ctrl=""', "")
    folder.mkdir(parents=True, exist_ok=True)
    if included:
        (folder / "dog.xml").write_text(text)
        scene = '<mujoco model="scene"><!-- a scene -->\n  <include file="dog.xml"/>\n'
        (folder / "scene.xml").write_text(f"{scene}  <worldbody>{FLOOR}</worldbody>\n</mujoco>")
        return folder / "scene.xml"
    (folder / "dog.xml").write_text(text.replace("<worldbody>", f"<worldbody>{FLOOR}", 1))
    return folder / "dog.xml"


def in_the_air(kp: float = 55.0, damping: float = 0.9) -> Recording:
    """What the dog does on a stand: its truth is stiffer and more damped than its file, its base held."""
    text = ROBOT.format(trunk=PLAIN, drives=_SERVOS.format(kp=kp), pose=_POSE, low=_LOW, ctrl=_POSE)
    text = text.replace('damping=".5"', f'damping="{damping}"').replace('<freejoint name="root"/>', "")
    text = text[: text.index("<keyframe>")] + "</mujoco>"
    model = mujoco.MjModel.from_xml_string(text)
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    rows, time = [], np.arange(0.0, 2.0, 0.01)
    for t in time:
        data.ctrl[:] = np.tile([0.5, -0.7], 4) * np.sin((3.0 + np.arange(8) / 4) * t)
        rows.append([*data.ctrl, *(data.qpos + 3e-4 * rng.standard_normal(8))])
        mujoco.mj_step(model, data, 5)
    values = np.array(rows)
    parts = {"command": values[:, :8], "position": values[:, 8:]}
    return Recording("air", {n: Channel(n, JOINTS, "rad", time, v) for n, v in parts.items()})


def as_found(ready: Preparation, change: float = 1.3) -> Calibration:
    """A calibration that ends with every free parameter changed: what was found does not matter to what is kept. Structures
    that are tried later are not found.
    """
    rows = [
        Estimate(p.name, p.unit, p.nominal, v, v, v, p.lower, p.upper, not p.frozen, "identified", "")
        for p in ready.simulator.parameters.parameters
        for v in (float(np.clip(p.nominal * change + 1e-3, p.lower, p.upper)) if p.absent is None else p.absent,)
    ]
    return Calibration("dog", tuple(rows), (), (), np.eye(len(rows)))


def fields(model: mujoco.MjModel) -> dict[str, Array]:
    """All arrays of a model by name."""
    names = [n for n in dir(model) if not n.startswith("_")]
    return {n: np.asarray(v) for n in names if isinstance(v := getattr(model, n), np.ndarray)}


def check_kept(before: Path, after: Path, changed: Collection[str] = JOINT | DRIVE) -> None:
    """A written file is the given one but for what was calibrated: joints, keyframes, sensors, contacts, comments."""
    old, new = (mujoco.MjModel.from_xml_path(str(p)) for p in (before, after))
    one, two = fields(old), fields(new)
    assert set(one) == set(two)
    for name in set(one) - set(changed) - FOLLOWS - {n for n in one if n.startswith("name_")}:
        assert one[name].shape == two[name].shape, name
        np.testing.assert_array_equal(one[name], two[name], err_msg=name)
    np.testing.assert_array_equal(old.opt.gravity, new.opt.gravity)
    assert old.opt.cone == new.opt.cone
    assert old.stat.extent == new.stat.extent
    text = after.read_text()
    assert all(f"<!-- {c} -->" in text for c in ("made by hand", "leg fl", "leg rr"))


def stands(path: Path) -> bool:
    """Whether the robot of a file still stands on its floor a second after its first keyframe."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    height = float(data.qpos[2])
    while data.time < 1.0:
        mujoco.mj_step(model, data)
    return bool(np.isfinite(data.qpos).all() and abs(data.qpos[2] - height) < 0.03 and data.qpos[3] > 0.98)


@pytest.mark.parametrize("included", [False, True], ids=["one file", "a scene that includes it"])
def test_a_quadruped_logged_in_the_air_stands_on_its_floor_afterwards(tmp_path: Path, included: bool) -> None:
    given = robot(tmp_path / "given", included=included)
    ready = prepare(given, [in_the_air()])
    assert isinstance(ready.simulator, MujocoSimulator)
    assert ready.simulator.model.compiled.nq == 8, "held while fitting"
    found = as_found(ready)
    out = tmp_path / "fit" / given.name
    notes = ready.write(found, out, tmp_path / "fit" / "parameters.toml")
    assert any("in the file it is free" in n for n in notes)
    check_kept(given, out)
    assert stands(given)
    assert stands(out)
    kp = [e.value for e in found.estimates if e.name.endswith(".kp")]
    assert mujoco.MjModel.from_xml_path(str(out)).actuator_gainprm[:, 0] == pytest.approx(kp, rel=1e-6)


def test_motors_that_were_servos_for_the_fit_are_motors_again(tmp_path: Path) -> None:
    given = robot(tmp_path / "given", drives="motors")
    ready = prepare(given, [in_the_air()])
    found = as_found(ready)
    out = tmp_path / "fit" / given.name
    notes = ready.write(found, out, tmp_path / "fit" / "parameters.toml")
    check_kept(given, out, JOINT)
    driven = mujoco.MjModel.from_xml_path(str(out.with_name("dog_driven.xml")))
    kp = [e.value for e in found.estimates if e.name.endswith(".kp")]
    assert driven.actuator_gainprm[:, 0] == pytest.approx(kp, rel=1e-6)
    assert any("keeps the drives that it came with" in n for n in notes)
    assert any("dog_driven.xml" in line for line in ready.usage(found, out))


def test_contacts_left_out_of_a_fit_are_in_the_file(tmp_path: Path) -> None:
    given = robot(tmp_path / "given", trunk="")  # hips lie within the trunk
    ready = prepare(given, [in_the_air()])
    out = tmp_path / "fit" / given.name
    ready.write(as_found(ready), out, tmp_path / "fit" / "parameters.toml")
    check_kept(given, out)


def test_the_lines_that_are_printed_simulate_the_written_file(tmp_path: Path) -> None:
    given = robot(tmp_path / "given")
    ready = prepare(given, [in_the_air()])
    found = as_found(ready)
    out = tmp_path / "fit" / given.name
    ready.write(found, out, tmp_path / "fit" / "parameters.toml")
    lines = ready.usage(found, out)
    log = in_the_air()
    names = {"mujoco": mujoco, "np": np, "times": log.time, "commands": log.channel("command").values}
    exec("\n".join(lines), names)  # the test's own lines, no user's file
    data = names["data"]
    assert isinstance(data, mujoco.MjData)
    assert data.time == pytest.approx(log.time[-1], abs=0.002)
