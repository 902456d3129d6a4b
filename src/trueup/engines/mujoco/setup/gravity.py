# SPDX-License-Identifier: Apache-2.0
"""Commands on top of a controller's gravity compensation: the model's links then lose their weight, too, or a share of it."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from trueup.arrays import Array
from trueup.articulated.declarations import Declaration
from trueup.articulated.quantities.known import quantity
from trueup.engines.mujoco.lone.loads import inverse_dynamics, rigid
from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.setup.motors import KnownTorque, known_torques, of_a_drive, pushes
from trueup.engines.mujoco.setup.still import carriers
from trueup.engines.mujoco.wiring import joint_id
from trueup.evidence import FEWEST_PARTS, HALVED, STANDARD_ERRORS, evidence
from trueup.inspection.zeros import held_at
from trueup.recording import Recording
from trueup.rounding import ROUNDED
from trueup.trial import command_of

SUPPORTED = "weight held beside the servos"
"""Of an arm on servos: by a controller that compensates gravity, so that it does not sag as their stiffness asks."""
_MOTORS = ("N m", "N", "")
"""Units of what motors are told: torques, forces, and controls as they are, of which the motor's gear makes torque."""


def compensated(model: Model, recordings: Sequence[Recording]) -> Model:
    """The model with `gravcomp` at its bodies, where the motion is explained better by commanded torques without gravity.

    Many arms (Franka, Kinova, KUKA's LBR) hold their own weight and take commands on top of that. Both models get the
    drives that fit them best, as `motors.drives_seen` does; what is left counts over stretches of all joints, each by the
    torque that it was told, and must clearly be less (`trueup.evidence`): where weight hardly matters nothing is seen of
    it. Torque of an unknown scale leaves most of the motion unexplained, and changes nothing. Nor does a robot that hangs on
    a joint that nothing drives (a leg on a rail, a boom): what it stands on carries it, of which no torque of a drive tells.
    """
    if carriers(model):
        return model
    told = [r for r in recordings for c in (command_of(r),) if c is not None and c.unit in _MOTORS]
    parts = known_torques(model, told)
    weights = [_weight(model, part.motion.position) for part in parts]
    shares = []
    for dof in range(model.compiled.nv) if parts else ():
        known = [(p, w[:, dof]) for p, w in zip(parts, weights, strict=True) if p.known[dof]]
        squares = float(sum(np.sum(np.square(p.torque[:, dof])) for p, _ in known))
        if squares > 0.0:
            own, weight = [p for p, _ in known], np.concatenate([w for _, w in known])
            shares.append([_unexplained(own, dof, added) / squares for added in (0.0 * weight, weight)])
    held, without = np.mean(shares, axis=0).sum(axis=1) if shares else (0.0, 0.0)
    weighty, weightless = np.concatenate(shares, axis=1) if shares else np.zeros((2, 0))
    # By what either leaves: stretches that weight explains and its absence does not would not count by the first alone.
    # Where more of the torques' squares is left, neither a scale nor a weight is seen in them.
    if without >= HALVED or not evidence(weighty, weightless, weighty + weightless).holds:
        return model
    spec = model.spec.copy()
    for body in spec.bodies[1:]:
        body.gravcomp = 1.0
    note = (
        "the commanded torques do not hold the arm's weight, as where a controller compensates gravity beside them (without "
        f"it the motion leaves {100 * without:.2g} % of their squares unexplained, with it {100 * held:.2g} %): the links "
        'are simulated without weight (gravcomp="1" in MJCF, in the calibrated file too)'
    )
    return model.changed(spec, "without the links' weight", note)


def of_held_weight(model: Model, servos: Sequence[str], recordings: Sequence[Recording]) -> list[Declaration]:
    """The share of its weight that the controller of an arm on servos holds beside what their stiffness gives, where the arm
    sags by less than half of what the file's servos would let it: else servos would be as stiff as that asks, or have zeros
    that lift it. One for all links: a controller knows them all. Not asked of a robot that hangs on what nothing drives (a
    rail, a boom, a free base).
    """
    m = model.compiled
    names = model.names("body")
    moved = tuple(names[i] for i in range(1, m.nbody) if m.body_weldid[i] and m.body_mass[i] > 0.0 and names[i])
    if not servos or not moved or m.ngravcomp or m.nq != m.nv or carriers(model):
        return []
    share, error = _sagging(model, servos, recordings)
    if not share + STANDARD_ERRORS * error < HALVED:
        return []
    most = quantity("weight_held").bounds(1.0)[1]
    # It begins at none, which is what the arm is replayed with where it is left out.
    return [Declaration("weight_held", moved, tie="all", name="weight_held", nominal=0.0, lower=0.0, upper=most,
                        optional=SUPPORTED)]  # fmt: skip


def _sagging(model: Model, servos: Sequence[str], recordings: Sequence[Recording]) -> tuple[float, float]:
    """Torque that servos give where commands are held, by how far the joints are behind these, for one N m of the links'
    weight there, and its standard error, which holds what friction and zeros do to it; no number where nothing is held.
    """
    m, driven = model.compiled, model.actuator_of_joint()
    given, asked = list[Array](), list[Array]()
    for recording, joint in itertools.product(recordings, servos):
        instants, apart = held_at(recording, joint)
        if len(instants):
            known = recording.channel("position")
            labels = [label for label in known.labels if joint_id(m, label) >= 0]
            positions = np.tile(m.qpos0, (len(instants), 1))
            positions[:, [joint_id(m, label) for label in labels]] = known.select(labels).at(instants)
            asked.append(_weight(model, positions)[:, joint_id(m, joint)])
            given.append(-float(m.actuator_gainprm[driven[joint], 0]) * apart)
    torque, weight = (np.concatenate(x or [np.zeros(0)]) for x in (given, asked))
    # Joints that bear none of it, as those of a level stage, tell nothing.
    borne = np.abs(weight) > ROUNDED * float(m.body_mass.sum()) * float(np.linalg.norm(m.opt.gravity))
    good = np.isfinite(torque) & borne
    torque, weight = torque[good], weight[good]
    squares = float(weight @ weight)
    if len(weight) < FEWEST_PARTS:
        return np.nan, np.nan
    share = float(torque @ weight) / squares
    return share, float(np.sqrt(np.sum(np.square(torque - share * weight)) / (len(weight) - 1) / squares))


def _weight(model: Model, positions: Array) -> Array:
    """(L, nv) torque that holds the links' weight at positions (L, nv), as the model has it."""
    plain, still = rigid(model.compiled), np.zeros_like(positions)
    weightless = plain.__copy__()
    weightless.opt.gravity[:] = 0.0
    held, free = (inverse_dynamics(m, positions, still, still)[1] for m in (plain, weightless))
    return held - free


def _unexplained(parts: Sequence[KnownTorque], dof: int, added: Array) -> Array:
    """(`FEWEST_PARTS`,) of each stretch of time, squares that a drive leaves of what its motor gives beyond the rigid robot,
    `added` to that.
    """
    columns, extra, _ = pushes(parts, dof)
    columns[:, -1] = 0.0  # an offset would be the weight itself, where a link stays near level
    extra = extra + added
    left = np.square(extra - columns @ of_a_drive(columns, extra))
    return np.array([np.sum(part) for part in np.array_split(left, FEWEST_PARTS)])
