# SPDX-License-Identifier: Apache-2.0
"""What lies between a drive and its link: a gap, and ends of it that give way, as a second joint of the model."""

from __future__ import annotations

import mujoco
import numpy as np

from trueup.arrays import Array
from trueup.engines.mujoco.fields import Fields
from trueup.rounding import PRINTED, ROUNDED

SLACK = "/slack"
SECOND = {"slack": SLACK, "gear": "/gear"}
"""What the name of a second joint between drive and link ends with, by what needs it (`Quantity.needs`)."""
SECOND_OF = {"backlash": SLACK, "gear_backlash": SECOND["gear"], "gear_compliance": SECOND["gear"]}
"""The same, by the joint's attribute that is kept there."""
_LAG = 1e-3  # s: damping over stiffness of a gear that twists
OWN = 0.05  # share of what it moves that a drive has of inertia itself, where a file has no rotor, so that it can be stepped


def add_second(spec: mujoco.MjSpec, name: str, kind: str, inertia: float) -> None:
    """Between a driven joint and its link, which has an `inertia` (kg m2): a free joint between two ends."""
    joint = spec.joint(name)
    gap = joint.parent.add_joint()
    gap.name = name + SECOND[kind]
    gap.type, gap.axis, gap.pos = joint.type, joint.axis, joint.pos
    gap.limited, gap.range = mujoco.mjtLimited.mjLIMITED_TRUE, [-PRINTED, PRINTED]
    gap.frictionloss, gap.stiffness = 0.0, [0.0, 0.0, 0.0]
    if kind == "gear":
        rate = 1.0 / spec.option.timestep
        gap.solref_limit, gap.solimp_limit = [-(rate**2), -_LAG * rate**2], [0.02, 0.02, 1e-4, 0.5, 2.0]
        gap.damping, gap.armature = [0.0, 0.0, 0.0], OWN * inertia
        return
    # The gap is small and the ends are gear teeth: contact within two steps, nearly rigid.
    gap.solref_limit = [max(2.0 * spec.option.timestep, 0.004), 1.0]
    gap.solimp_limit = [0.99, 0.999, 1e-4, 0.5, 2.0]
    gap.damping, gap.armature = [0.005, 0.0, 0.0], 1e-4


def write_gap(model: mujoco.MjModel, fields: Fields, joint: int, values: Array) -> None:
    """Gaps (b,) end to end, rad."""
    half = np.maximum(0.5 * values, PRINTED)
    ranges = fields.expand("jnt_range")[:, joint]
    ranges[:, 0], ranges[:, 1] = -half, half


def read_gap(model: mujoco.MjModel, fields: Fields, joint: int) -> Array:
    """See `write_gap`; 0 where there is no such joint."""
    return np.ptp(fields.expand("jnt_range")[:, joint], axis=-1) if joint >= 0 else np.zeros(1)


def write_compliance(model: mujoco.MjModel, fields: Fields, joint: int, values: Array) -> None:
    """The ends of a gear's gap as springs of compliances (b,), rad/(N m), no stiffer than that drive and link swing against
    one another by a radian a step.

    A constraint of small impedance is a spring: solref takes its stiffness and damping times the inverse inertia that MuJoCo
    reckons with (MuJoCo documentation, Computation, Solver parameters).
    """
    stiffness = np.minimum(_inverse(model, fields, joint) / np.maximum(values, ROUNDED), model.opt.timestep**-2.0)
    fields.expand("jnt_solref")[:, joint] = -np.stack([stiffness, _LAG * stiffness], axis=1)


def read_compliance(model: mujoco.MjModel, fields: Fields, joint: int) -> Array:
    """See `write_compliance`; 0 where there is no such joint."""
    return _inverse(model, fields, joint) / -fields.expand("jnt_solref")[:, joint, 0] if joint >= 0 else np.zeros(1)


def _inverse(model: mujoco.MjModel, fields: Fields, joint: int) -> Array:
    """(b,) inverse inertia of a gear's joint: as MuJoCo has it for the model's own rotor, with the rotor of each copy."""
    name = model.joint(joint).name.removesuffix(SECOND["gear"])
    gear, drive = int(model.jnt_dofadr[joint]), int(model.jnt_dofadr[model.joint(name).id])
    own = float(model.dof_armature[gear])
    link = float(model.dof_M0[gear]) - own

    def swinging(rotor: Array) -> Array:
        return own + rotor * link / (rotor + link)

    shipped = swinging(model.dof_armature[[drive]])
    return float(model.dof_invweight0[gear]) * shipped / swinging(fields.expand("dof_armature")[:, drive])
