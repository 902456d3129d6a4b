# SPDX-License-Identifier: Apache-2.0
"""Whether a robot whose base no recording shows hung on a stand, or stood on its feet: by where its joints rested."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from trueup.arrays import Array
from trueup.articulated.attitude import BEGINNING
from trueup.ends import TILT
from trueup.engines.mujoco.attributes import is_motor
from trueup.engines.mujoco.model import Model
from trueup.evidence import HALVED
from trueup.instant import STILL
from trueup.recording import Recording
from trueup.trial import SETTLE, command_of


@dataclass(frozen=True)
class _Rest:
    """A beginning at rest: actuators (k,) of joints, what they were told and where the joints were, in rad or m."""

    actuators: tuple[int, ...]
    commanded: Array
    was: Array


def stood(free: Model, hanging: mujoco.MjModel, recordings: Sequence[Recording]) -> str:
    """What speaks for feet on the floor, in words: by the weight on them joints rest beside their commands as the free model
    does where it stands, and not as it does where it hangs. '' where nothing does, or recordings do not begin at rest.
    """
    worst, hung, standing = ("", 0.0, 0.0, 0.0), 0.0, 0.0
    for recording in recordings:
        rest = _rest(free, recording)
        if rest is None:
            continue
        down, up = _sag(hanging, rest), _sag(free.compiled, rest)
        if up is None or down is None:
            continue
        seen = rest.was - rest.commanded
        hung, standing = hung + float(np.sum((seen - down) ** 2)), standing + float(np.sum((seen - up) ** 2))
        k = int(np.argmax(np.abs(seen - down)))
        if abs(seen[k] - down[k]) > abs(worst[1] - worst[3]):
            worst = (free.names("actuator")[rest.actuators[k]], float(seen[k]), float(up[k]), float(down[k]))
    if not standing < HALVED**2 * hung:  # or doubtful gains would decide
        return ""
    name, seen, up, down = worst[0], *(f"{1e3 * x:+.3g}" for x in worst[1:])
    return (
        f"where recordings begin '{name}' is {seen} mrad or mm beside its command, as where the model stands on the floor "
        f"({up}) and not as where it hangs ({down})"
    )


def _rest(model: Model, recording: Recording) -> _Rest | None:
    """The beginning of a recording, if the robot rested in it; None where drives are no position servos, too."""
    drives, command = commanded_joints(model, recording), command_of(recording)
    if not drives or command is None or command.unit in ("N m", "N"):
        return None
    actuators = tuple(drives.values())
    early = [c.select(list(drives)) for c in (command, recording.channel("position"))]
    asked, was = (c.values[c.time <= recording.start + BEGINNING] for c in early)
    if not (len(asked) and len(was) and np.isfinite(asked[0]).all() and np.isfinite(was).all()):
        return None
    # Commands that set out at once have not moved the joints yet.
    return None if np.ptp(was, axis=0).max() > STILL else _Rest(actuators, asked[0], was.mean(axis=0))


def commanded_joints(model: Model, recording: Recording) -> dict[str, int]:
    """Joints that were commanded and measured, each with its actuator, where these are all that a model has, and take what
    they are told: position servos a position, motors a torque or force; none elsewhere.
    """
    command, drives = command_of(recording), model.drives()
    if command is None or not recording.has("position"):
        return {}
    position = recording.channel("position")
    found = {x: model.index("actuator", drives[x]) for x in command.labels if x in position.labels and drives.get(x)}
    everything = {i for i, name in enumerate(model.names("actuator")) if name}
    by_torque = command.unit in ("N m", "N")
    takes = (is_motor(model.compiled, i) if by_torque else model.is_position_servo(i) for i in found.values())
    return found if set(found.values()) == everything and all(takes) else {}


def _sag(compiled: mujoco.MjModel, rest: _Rest) -> Array | None:
    """(k,) how far from their commands joints come to rest; None where the robot falls."""
    data = mujoco.MjData(compiled)
    if compiled.nkey:
        mujoco.mj_resetDataKeyframe(compiled, data, 0)
    places = compiled.jnt_qposadr[compiled.actuator_trnid[list(rest.actuators), 0]]
    data.qpos[places] = rest.was
    data.ctrl[list(rest.actuators)] = rest.commanded
    mujoco.mj_forward(compiled, data)
    root = compiled.jnt_bodyid[0]
    upright = data.xmat[root].copy()
    mujoco.mj_step(compiled, data, int(np.ceil(SETTLE / compiled.opt.timestep)))
    leans = float(np.arccos(np.clip(data.xmat[root][6:] @ upright[6:], -1.0, 1.0)))
    fell = compiled.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE and leans > TILT
    return None if fell or not np.isfinite(data.qpos).all() else data.qpos[places] - rest.commanded
