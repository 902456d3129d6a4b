# SPDX-License-Identifier: Apache-2.0
"""Writes masses, inertias, friction and rotor inertias into an MJCF file and leaves the rest of its text as it is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from trueup.arrays import Array
from trueup.articulated.inertia import principal
from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.writing.edits import Edits
from trueup.errors import ModelError
from trueup.formats.aside import write_aside
from trueup.model_files.references import relocate
from trueup.model_files.xml_text import XmlText


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body in its own frame: kg, m, kg m^2 about its centre of mass."""

    mass: float
    com: Array
    inertia: Array
    """(3, 3)."""


@dataclass(frozen=True)
class JointDrive:
    """What MJCF knows of a joint's drive: N m s/rad, N m, kg m^2, N m/rad, rad."""

    damping: float
    friction: float
    armature: float
    stiffness: float = 0.0
    slack: float = 0.0
    """Where its spring pulls to neither side."""


def write_bodies(
    model: Model, bodies: Mapping[str, Body], joints: Mapping[str, JointDrive], path: Path
) -> tuple[str, ...]:
    """Writes the MJCF `model` with these bodies and joints changed to `path`; the result is loaded before it counts.

    Returns notes: where elements come from included files, MuJoCo writes the model anew and comments are lost. Raises
    ModelError for a result that does not compile, OutputError where the folder does not take it.
    """
    spec = model.spec.copy()
    for name, body in bodies.items():
        element = spec.body(name)
        element.explicitinertial = True
        moments, turn = principal(body.inertia[None])
        element.mass, element.ipos, element.iquat, element.inertia = body.mass, body.com, turn[0], moments[0]
        element.fullinertia = np.full(6, np.nan)
    for name, joint in joints.items():
        element = spec.joint(name)
        element.damping = [joint.damping, 0.0, 0.0]
        element.frictionloss, element.armature = joint.friction, joint.armature
        if joint.stiffness or np.any(element.stiffness):
            turns = int(element.type) == int(mujoco.mjtJoint.mjJNT_HINGE) and bool(spec.compiler.degree)
            element.stiffness = [joint.stiffness, 0.0, 0.0]
            element.springref = np.degrees(joint.slack) if turns else joint.slack
    wanted = _compiled(spec)
    try:
        content, notes = _edited(model, wanted, bodies, joints, path), ()
    except ModelError as error:
        content = spec.to_xml().encode()
        notes = (f"MuJoCo wrote the model anew, without its comments: {error}",)
    write_aside(content, path)
    return notes


def _edited(
    model: Model, wanted: mujoco.MjModel, bodies: Mapping[str, Body], joints: Mapping[str, JointDrive], path: Path
) -> bytes:
    text = XmlText(model.path.read_bytes())
    edits = Edits(text, model, wanted, degrees=bool(model.spec.compiler.degree))
    for name in bodies:
        edits.write("body.mass", name)
    for name in joints:
        for kind in ("joint.damping", "joint.friction", "joint.armature", "joint.spring"):
            edits.write(kind, name)
    relocate(text, model.path.absolute().parent, path.absolute().parent)
    return text.render()


def _compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
    try:
        return spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise ModelError(f"the identified model does not compile: {' '.join(str(error).split())}") from None
