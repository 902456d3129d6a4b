# SPDX-License-Identifier: Apache-2.0
"""Commands of motors under a name, and in a unit, that says positions: torques, as inverse dynamics knows them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueup.arrays import Array
from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.setup.motors import KnownTorque, known_torques, of_a_drive, pushes
from trueup.engines.mujoco.wiring import is_motor, joint_id
from trueup.evidence import HALVED
from trueup.inspection.unfollowed import astray
from trueup.recording import Recording
from trueup.rounding import TINY
from trueup.trial import command_of

_TORQUE_OF = {"rad": "N m", "m": "N"}


def with_efforts(model: Model, recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
    """Recordings with torques where their commands seemed to be positions, and a note.

    That is so of a model whose motors take torques, where going where commanded explains less than half of the motion, and
    the motors' torques, beside friction, damping and rotors of drives, leave less than half of them open as inverse dynamics
    has them. A column `elbow_cmd` names no unit, and small torques are as large as angles are.
    """
    told = [r for r in recordings if _seem_positions(model, r)]
    if not told or astray(told) < HALVED:
        return list(recordings), []
    meant = {id(r): _as_torques(r) for r in told}
    if not _open(model, known_torques(model, list(meant.values()))) < HALVED:
        return list(recordings), []
    names = ", ".join(r.name for r in told)
    return [meant.get(id(r), r) for r in recordings], [
        f"what is commanded in {names} is taken as torques in N m: the model's drives take torques, these would give about "
        "the motion that was measured, and no joint goes where they would send it as positions"
    ]


def _seem_positions(model: Model, recording: Recording) -> bool:
    """Whether positions are commanded, and of joints of motors alone."""
    command = command_of(recording)
    if command is None or set(map(command.unit_of, command.labels)) - set(_TORQUE_OF):
        return False
    drives, names = model.actuator_of_joint(), model.names("actuator")
    told = [i for joint, i in drives.items() if {joint, names[i]} & set(command.labels)]
    return len(told) == len(command.labels) and all(is_motor(model.compiled, i) for i in told)


def _as_torques(recording: Recording) -> Recording:
    command = command_of(recording)
    if command is None:
        return recording
    units = tuple(_TORQUE_OF[unit] for unit in command.units)
    torques = command.replace(name="command_torque", unit=_TORQUE_OF.get(command.unit, ""), units=units)
    return recording.without(command.name).with_channel(torques)


def _open(model: Model, parts: Sequence[KnownTorque]) -> float:
    """Share of the motors' torques that rigid robot, friction, damping and rotors leave open, the mean of all joints."""
    shares = []
    for joint in model.scalar_joints() if parts else ():
        dof = int(model.compiled.jnt_dofadr[joint_id(model.compiled, joint)])
        known = [p for p in parts if p.known[dof]]
        if known:
            shares.append(_left(known, dof))
    return float(np.mean(shares)) if shares else 1.0


def _left(parts: Sequence[KnownTorque], dof: int) -> float:
    columns, extra, window = pushes(parts, dof)
    seen = window > 0.0
    torque: Array = np.concatenate([p.torque[:, dof] for p in parts])[seen]
    if np.count_nonzero(seen) <= columns.shape[1]:
        return 1.0
    left = extra[seen] - columns[seen] @ of_a_drive(columns[seen], extra[seen])
    return min(1.0, float(np.sum(left**2) / max(np.sum((torque - torque.mean()) ** 2), TINY)))
