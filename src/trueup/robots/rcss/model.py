# SPDX-License-Identifier: Apache-2.0
"""A server's own robot as a model to simulate: its MJCF with servos of the gains that the agent sends, and a floor."""

from __future__ import annotations

from pathlib import Path

import mujoco

from trueup.errors import ModelError
from trueup.files import text
from trueup.robots.rcss.body import body_named

_STEP = 5e-3
"""s, of rcssservermj."""


def servo_model(robot: str, server_file: str | Path, output: str | Path) -> Path:
    """Writes rcssservermj's `robot.xml` of 'T1' or 'K1' as an MJCF that stands by itself, and returns its path.

    One position servo a joint, named as the joint, with the agent's gains; the torso's gyroscope and accelerometer as 'gyro'
    and 'accelerometer'; no meshes. Raises ModelError for a file of another robot.
    """
    body, path = body_named(robot), Path(server_file)
    try:
        spec = mujoco.MjSpec.from_string(text(path, ModelError))
    except ValueError as error:
        raise ModelError(f"'{path}' does not load: {' '.join(str(error).split())}") from None
    known = [j.name for j in spec.joints]
    missing = [j.name for j in body.joints if j.name not in known]
    if missing:
        raise ModelError(
            f"'{path}' is no '{robot}': it has no joint '{missing[0]}'; its joints are: {', '.join(known)}"
        )
    for several in (spec.actuators, [g for g in spec.geoms if g.type == mujoco.mjtGeom.mjGEOM_MESH], spec.meshes):
        for one in list(several):
            spec.delete(one)
    for joint in body.joints:
        servo = spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.set_to_position(kp=joint.kp, kv=joint.kd)
    for sensor in spec.sensors:
        sensor.name = {"torso_gyro": "gyro", "torso_acc": "accelerometer"}.get(sensor.name, sensor.name)
    spec.worldbody.add_geom(name="pitch", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[10, 10, 1])
    spec.option.timestep = _STEP
    spec.compile()
    Path(output).write_text(spec.to_xml(), encoding="utf-8")
    return Path(output)
