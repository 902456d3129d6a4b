# SPDX-License-Identifier: Apache-2.0
"""Whole states in place of joints: logs whose positions are MuJoCo's qpos of a robot with a free base, its pose first."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueup.articulated.pose import AXES, ORIENTATION, POSITION, QUATERNION
from trueup.engines.mujoco.base import free_joint
from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.wiring import joint_id
from trueup.recording import Channel, Recording
from trueup.samples import is_unit


def with_states_parted(model: Model, recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
    """Recordings with joints by the model's names and the pose of its base, where their positions are as many numbers as its
    qpos, and those where it has the base's quaternion are of length 1; of speeds that are as many as its qvel the joints'.
    """
    m, joint = model.compiled, free_joint(model.compiled)
    if joint < 0:
        return list(recordings), []
    names = model.scalar_joints()
    at, rate = ([int(a[joint_id(m, n)]) for n in names] for a in (m.jnt_qposadr, m.jnt_dofadr))
    base, result, parted = int(m.jnt_qposadr[joint]), list[Recording](), False
    for recording in recordings:
        position, velocity = recording.channels.get("position"), recording.channels.get("velocity")
        if (
            position is None
            or len(position.labels) != m.nq
            or set(position.labels) & set(names)
            or recording.has(POSITION)
            or recording.has(ORIENTATION)
            or not is_unit(position.values[np.isfinite(position.values).all(axis=1)][:, base + 3 : base + 7])
        ):
            result.append(recording)
            continue
        values, time, parted = position.values, position.time, True
        own = [
            position.replace(labels=names, units=(), values=values[:, at]),
            Channel(POSITION, AXES, "m", time, values[:, base : base + 3]),
            Channel(ORIENTATION, QUATERNION, "", time, values[:, base + 3 : base + 7]),
        ]
        if velocity is not None and len(velocity.labels) == m.nv:
            own.append(velocity.replace(labels=names, units=(), values=velocity.values[:, rate]))
        result.append(recording.replace(channels={**recording.channels, **{c.name: c for c in own}}))
    note = f"positions are {m.nq} numbers, as the model's qpos: the pose of its base, then {', '.join(names)}"
    return result, [note] if parted else []
