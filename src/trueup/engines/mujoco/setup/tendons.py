# SPDX-License-Identifier: Apache-2.0
"""Motors that turn several joints (a differential wrist): joints told from the motors' measured angles."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from trueup.arrays import Array
from trueup.engines.mujoco.model import Model
from trueup.inspection.joint_names import plain_name
from trueup.recording import Channel, Recording

_CHANNELS = ("position", "velocity")


def with_joints_told(model: Model, recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
    """Recordings with positions and speeds of joints in place of those of drives that pull at fixed tendons, and a note.

    Such a drive moves by a weighed sum of its joints: as many drives as joints tell these, or fewer where the model ties
    joints to one another, as the fingers of a gripper. Columns are a drive's by its name; left out beside joints that were
    measured themselves, and stay where they do not tell their joints.
    """
    pulled, ties = pulls(model), _ties(model)
    changed, told = [], {}
    for recording in recordings:
        for name in _CHANNELS if pulled else ():
            if recording.has(name) and (found := _solved(recording.channel(name), pulled, ties)) is not None:
                recording = recording.with_channel(found[0])
                told |= found[1]
        changed.append(recording)
    if not told:
        return changed, []
    said = ", ".join(f"{joint} from {' and '.join(drives)}" for joint, drives in told.items() if joint)
    return changed, [
        f"measured were drives that turn several joints, by tendons of the model: {said}" if said else
        f"left out, since the joints that they turn were measured too: {', '.join(told[''])}"
    ]  # fmt: skip


def of_several_joints(model: Model) -> tuple[str, ...]:
    """Names of the actuators that drive no single joint."""
    single = set(model.actuator_of_joint().values())
    return tuple(name for i, name in enumerate(model.names("actuator")) if name and i not in single)


def pulls(model: Model) -> dict[str, dict[str, float]]:
    """Drives of fixed tendons, each to its joints and by how much a unit of each moves it."""
    m, joints = model.compiled, model.names("joint")
    found = {}
    for name in of_several_joints(model):
        actuator = model.index("actuator", name)
        if int(m.actuator_trntype[actuator]) != int(mujoco.mjtTrn.mjTRN_TENDON):
            continue
        first = int(m.tendon_adr[m.actuator_trnid[actuator, 0]])
        parts = range(first, first + int(m.tendon_num[m.actuator_trnid[actuator, 0]]))
        if all(int(m.wrap_type[w]) == int(mujoco.mjtWrap.mjWRAP_JOINT) for w in parts):
            gear = float(m.actuator_gear[actuator, 0])
            found[name] = {joints[int(m.wrap_objid[w])]: gear * float(m.wrap_prm[w]) for w in parts}
    return found


def leading(model: Model, joints: Sequence[str]) -> tuple[str, ...]:
    """These joints without those that equality constraints have follow others of them: both are one degree of freedom, of
    which motion tells one friction, one damping and one inertia, wherever they act. What is driven leads.
    """
    driven, kept = model.actuator_of_joint(), list(joints)
    for tie, _ in _ties(model):
        follower, leader = sorted(tie, key=lambda joint: joint in driven)  # stable: the first follows the second
        if tie[leader] != 0.0 and tie[follower] != 0.0 and {follower, leader} <= set(kept):
            kept.remove(follower)
    return tuple(kept)


def _ties(model: Model) -> list[tuple[dict[str, float], float]]:
    """Sums of joints that the model's equality constraints hold at a value, of those that are straight lines."""
    m, joints, found = model.compiled, model.names("joint"), []
    for i in np.flatnonzero((m.eq_type == int(mujoco.mjtEq.mjEQ_JOINT)) & m.eq_active0.astype(bool)):
        one, other = int(m.eq_obj1id[i]), int(m.eq_obj2id[i])
        begin, slope, *bends = (float(c) for c in m.eq_data[i, :5])
        if other >= 0 and not any(bends):
            first, second = (float(m.qpos0[m.jnt_qposadr[j]]) for j in (one, other))
            found.append(({joints[one]: 1.0, joints[other]: -slope}, first + begin - slope * second))
    return found


def _solved(
    channel: Channel, pulls: dict[str, dict[str, float]], ties: Sequence[tuple[dict[str, float], float]]
) -> tuple[Channel, dict[str, list[str]]] | None:
    """A channel with the joints that its drives tell, and which drives told which; None where they tell none."""
    own = {plain_name(drive): drive for drive in pulls}
    labels = {label: own[plain_name(label)] for label in channel.labels if plain_name(label) in own}
    rest = [label for label in channel.labels if label not in labels]
    joints = list(dict.fromkeys(joint for drive in labels.values() for joint in pulls[drive]))
    if not labels or set(labels) & set(joints):
        return None
    tied = [(tie, at) for tie, at in ties if tie.keys() <= set(joints)]
    sums = [*(pulls[drive] for drive in labels.values()), *(tie for tie, _ in tied)]
    held = np.tile([0.0 if channel.name == "velocity" else at for _, at in tied], (len(channel.time), 1))
    weights = np.array([[one.get(joint, 0.0) for joint in joints] for one in sums])
    measured, open_ = ([j for j in joints if (j in rest) == known] for known in (True, False))
    seen = np.concatenate([channel.select(list(labels)).values, held], axis=1)
    left = seen - _of(channel, measured) @ _columns(weights, joints, measured).T
    solve = _columns(weights, joints, open_)
    if np.linalg.matrix_rank(solve) < len(open_):
        return None
    values = np.concatenate([_of(channel, rest), left @ np.linalg.pinv(solve).T], axis=1)
    units = tuple(channel.unit_of(label) for label in (*rest, *[next(iter(labels))] * len(open_)))
    made = channel.replace(labels=(*rest, *open_), values=values, units=units if len(set(units)) > 1 else ())
    return made, {joint: list(labels) for joint in open_} or {"": list(labels)}


def _of(channel: Channel, labels: Sequence[str]) -> Array:
    """(T, k) the columns of these labels."""
    return np.stack([channel.column(label) for label in labels], axis=1) if labels else np.zeros((len(channel.time), 0))


def _columns(weights: Array, joints: Sequence[str], some: Sequence[str]) -> Array:
    return weights[:, [joints.index(joint) for joint in some]]
