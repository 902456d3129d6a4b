# SPDX-License-Identifier: Apache-2.0
"""Parts of a robot that overlap in the model at postures in which the real robot was: they cannot touch there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import mujoco
import numpy as np

from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.setup.contacts import without_contacts
from trueup.engines.mujoco.setup.servos import postures
from trueup.engines.mujoco.wiring import joint_id
from trueup.errors import listed
from trueup.recording import Recording

_DEEP = 1e-3  # m: what meshes, soft contacts and calibration errors explain overlaps less


def passable(model: Model, recordings: Sequence[Recording]) -> Model:
    """The model without contacts between parts of the robot that overlap at measured postures, or meet at a joint.

    Convex hulls of links often reach into their neighbours; simulated, they throw the robot out of postures in which
    it really was, or hold its joints fast. MuJoCo spares a link and its parent, but not where the parent stands fixed
    (the base of an arm), nor those further away. What stands around the robot and the floor keep their contacts.
    """
    found = _overlaps(model.compiled, recordings)
    if not found:
        return model
    spec, body = without_contacts(model.spec, found)
    worst = sorted(found.items(), key=lambda entry: entry[1])
    shown = listed([f"{body[a]} and {body[b]} ({-1e3 * depth:.0f} mm)" for (a, b), depth in worst])
    note = f"parts that overlap in the model where the robot really was do not touch each other: {shown}"
    return model.changed(spec, "without contacts of overlapping parts", note)


def _overlaps(compiled: mujoco.MjModel, recordings: Sequence[Recording]) -> dict[tuple[int, int], float]:
    """Pairs of bodies of the robot, and how deep they reach into each other [m, negative], at worst."""
    found: dict[tuple[int, int], float] = {}
    if not np.any((compiled.geom_contype != 0) | (compiled.geom_conaffinity != 0)):
        return found
    own = {int(compiled.body_treeid[compiled.jnt_bodyid[j]]) for r in recordings for j in _measured(compiled, r)}
    data = mujoco.MjData(compiled)
    for qpos in postures(compiled, recordings, 50):  # of each
        data.qpos[:] = qpos
        mujoco.mj_kinematics(compiled, data)
        mujoco.mj_comPos(compiled, data)
        mujoco.mj_collision(compiled, data)
        for k in np.flatnonzero(data.contact.dist[: data.ncon] < -_DEEP):
            bodies = compiled.geom_bodyid[data.contact.geom[k]]
            pair = (int(bodies.min()), int(bodies.max()))
            if _of_the_robot(compiled, pair, own):
                found[pair] = min(found.get(pair, 0.0), float(data.contact.dist[k]))
    return found


def _of_the_robot(compiled: mujoco.MjModel, pair: tuple[int, int], own: set[int]) -> bool:
    """Whether both bodies are moved by measured joints, or one is and the other is the fixed base that it hangs on."""
    moved = [body for body in pair if int(compiled.body_treeid[body]) in own]
    if len(moved) == 2:
        return True
    (fixed,) = set(pair) - set(moved) if len(moved) == 1 else (0,)
    return fixed != 0 and int(compiled.body_treeid[fixed]) < 0 and fixed in _above(compiled, moved[0])


def _above(compiled: mujoco.MjModel, body: int) -> Iterator[int]:
    while body:
        body = int(compiled.body_parentid[body])
        yield body


def _measured(compiled: mujoco.MjModel, recording: Recording) -> list[int]:
    labels = recording.channel("position").labels if recording.has("position") else ()
    return [j for j in (joint_id(compiled, label) for label in labels) if j >= 0]
