# SPDX-License-Identifier: Apache-2.0
"""Friction, damping and rotor inertia of joints whose torque is commanded: where a search begins.

Along a measured motion, what the motor gives beyond the robot's inverse dynamics goes into the drive itself (C. G. Atkeson,
C. H. An, J. M. Hollerbach, Int. J. Robotics Research 5(3), 1986). A model without friction replays such commands so far off
that slopes there lead nowhere.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from trueup.arrays import Array, Mask
from trueup.articulated.wiring import commanded, control_of
from trueup.engines.mujoco.attributes import is_motor
from trueup.engines.mujoco.lone.drives import alone
from trueup.engines.mujoco.lone.loads import (
    Motion,
    inverse_dynamics,
    measured_motion,
    rigid,
    speed_noise,
)
from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.wiring import joint_id, rest
from trueup.evidence import HALVED, STANDARD_ERRORS
from trueup.instant import HARDLY, MOVING, samples_of_cubic, usual_step
from trueup.recording import Recording
from trueup.rounding import NEGLIGIBLE, TINY
from trueup.samples import rms
from trueup.trial import command_of

AT_LEAST = 2.0
"""Times what a recording shows of a friction or a torque at least, as other things took part in it: where a search begins."""


@dataclass(frozen=True)
class Drive:
    """What a joint's drive takes: N m, N m s/rad and kg m2 (N, N s/m, kg where it slides); None where nothing tells."""

    friction: float
    damping: float | None = None
    armature: float | None = None


def drives_seen(model: Model, recordings: Sequence[Recording]) -> dict[str, Drive]:
    """Drives of the joints of which the torque and everybody's motion is known in a recording, by least squares; of joints
    that stood still, friction alone, as much as held them. {} where models have a free base or several drives at a joint.
    """
    compiled = model.compiled
    parts = known_torques(model, recordings)
    found: dict[str, Drive] = {}
    for joint in model.scalar_joints() if parts else ():
        dof = int(compiled.jnt_dofadr[joint_id(compiled, joint)])
        known = [part for part in parts if part.known[dof]]
        if known:
            found[joint] = _fitted(known, dof)
    return found


def known_torques(model: Model, recordings: Sequence[Recording]) -> list[KnownTorque]:
    """Recordings of which the torque and everybody's motion is known; none where models have a free base or several drives at
    a joint.
    """
    return [p for r in recordings for p in _known(model, r)] if alone(model.compiled, ()) else []


def pushes(parts: Sequence[KnownTorque], dof: int) -> tuple[Array, Array, Array]:
    """(L, 4) sign of the speed, speed, acceleration and one, which `of_a_drive` weighs, (L,) torque beyond the rigid
    robot's, and how many samples speeds are smoothed over (L,), 0 where the joint hardly moves.
    """
    extra, speed, rate = np.concatenate(
        [np.stack([p.extra[:, dof], p.motion.speed[:, dof], p.motion.acceleration[:, dof]], axis=1) for p in parts]
    ).T
    noise, window = np.repeat([(p.speed_noise[dof], p.window) for p in parts], [len(p.extra) for p in parts], axis=0).T
    seen = np.abs(speed) > np.maximum(HARDLY * np.abs(speed).max(), MOVING * noise)
    columns = np.stack([np.sign(speed), speed, rate, np.ones_like(speed)], axis=1)
    return columns, extra, np.where(seen, window, 0.0)


def of_a_drive(columns: Array, extra: Array) -> Array:
    """(4,) friction, damping and armature, none below zero, and an offset for what the rigid robot's gravity lacks; further
    columns as they come.
    """
    count = columns.shape[1]
    size = np.maximum(np.abs(columns).max(axis=0), TINY)
    least = np.array([0.0, 0.0, 0.0, *[-np.inf] * (count - 3)])
    # Coefficients that nothing tells are drawn to zero, far below what is told.
    # Of columns that are alike, as friction and offset of a joint that moved one way, this takes the shortest solution.
    short = np.sqrt(len(columns)) * NEGLIGIBLE**0.5 * np.eye(count)
    rows, right = np.concatenate([columns / size, short]), np.concatenate([extra, np.zeros(count)])
    return lsq_linear(rows, right, (least, np.full(count, np.inf)), method="bvls").x / size


def _fitted(parts: Sequence[KnownTorque], dof: int) -> Drive:
    columns, extra, window = pushes(parts, dof)
    seen = window > 0.0
    if np.sum(1.0 / window[seen]) < columns.shape[1]:  # stretches as long as speeds are smoothed over; unknowns
        return Drive(AT_LEAST * float(np.abs(extra).max()))
    columns, window = columns[seen], window[seen]
    x, left = _of_a_gain(columns, extra[seen], _rigid(parts, dof)[seen])
    friction, damping, armature = (float(v) for v in x[:3])
    inertia = armature + float(np.median(np.concatenate([p.inertia[:, dof] for p in parts])))
    # a joint that keeps no speed for a sample, and shows no friction by which it slides, gives way to one that holds it
    doubt = _standard_error(columns, left, float(np.sum(1.0 / window)))
    creeps = inertia < damping * max(p.sample for p in parts) and friction < STANDARD_ERRORS * doubt
    return Drive(AT_LEAST * float(np.abs(extra).max())) if creeps else Drive(friction, damping, armature)


def _of_a_gain(columns: Array, extra: Array, rigid: Array) -> tuple[Array, Array]:
    """(4,) as `of_a_drive`, and what is left of the torque (L,): of a motor that gives another share of what it is told,
    where that halves what is left. Files have torque constants and payloads wrong; damping and a rotor would stand for that,
    and leave nothing to friction.
    """
    plain = of_a_drive(columns, extra)
    left = extra - columns @ plain
    size = np.maximum(np.abs(rigid).max(), TINY)
    wide = np.column_stack([columns, rigid / size])
    more = of_a_drive(wide, extra)
    share = 1.0 + float(more[4]) / size  # of what it is told to what the robot takes
    other = extra - wide @ more
    if share <= 0.0 or rms(other) > HALVED * rms(left):
        return plain, left
    return more[:4] / share, other


def _rigid(parts: Sequence[KnownTorque], dof: int) -> Array:
    """(L,) torque of the rigid robot, in the order of `pushes`."""
    return np.concatenate([p.torque[:, dof] - p.extra[:, dof] for p in parts])


def _standard_error(columns: Array, left: Array, independent: float) -> float:
    """Of the first coefficient of least squares, from what is `left` (L,) of samples of which so many are `independent`."""
    inverse = np.linalg.pinv(columns.T @ columns)
    return float(np.sqrt(inverse[0, 0] * np.sum(left**2) / independent))


@dataclass(frozen=True, eq=False)
class KnownTorque:
    """One recording of L instants."""

    motion: Motion
    speed_noise: Array
    """(nv,) rad/s (m/s), standard deviation."""
    sample: float
    """s between instants."""
    window: int
    """Samples over which speeds are smoothed."""
    torque: Array
    """(L, nv) of the motors."""
    extra: Array
    """(L, nv) torque of the motors beyond what the rigid robot takes."""
    inertia: Array
    """(L, nv) of each joint by itself, without armature."""
    known: Mask
    """(nv,) where that is known."""


def _known(model: Model, recording: Recording) -> Iterator[KnownTorque]:
    """The recording, if it has the motion of all joints and their commands, without gaps in most of its time. Joints that it
    does not name and nothing drives are taken to rest, as the fingers of a hand do.
    """
    compiled, command, joints = model.compiled, command_of(recording), model.scalar_joints()
    measured = recording.channels.get("position")
    if command is None or measured is None:
        return
    unseen = [j for j in joints if j not in measured.labels]
    if any(j in model.actuator_of_joint() for j in unseen):
        return
    if len(measured.time) < 2 or 2 * usual_step(measured.time) * len(measured.time) < np.ptp(measured.time):
        return
    driven = compiled.jnt_dofadr[compiled.actuator_trnid[:, 0]]
    known = ~np.isin(np.arange(compiled.nv), driven)
    motion = measured_motion(compiled, measured, rest(compiled)[0])
    torque = np.zeros_like(motion.speed)
    sample = float(motion.time[1] - motion.time[0])
    # Half of what was commanded around an instant was held from before it.
    around = motion.time + sample * np.array([[-0.5], [0.5]])
    held = np.stack([command.at(t, hold=True) for t in around])
    for column, name in enumerate(commanded(model, command)):
        actuator = model.index("actuator", name)
        known[driven[actuator]] = is_motor(compiled, actuator)
        control = held[:, :, column] * control_of(model, name, command.unit_of(command.labels[column]))
        torque[:, driven[actuator]] = given(compiled, actuator, control).mean(axis=0)
    noise = np.zeros(compiled.nv)
    seen = [j for j in joints if j not in unseen]
    noise[_dofs(compiled, seen)] = np.nan_to_num(speed_noise(measured.select(seen)))
    known[_dofs(compiled, unseen)] = False
    inertia, asked = inverse_dynamics(rigid(compiled), motion.position, motion.speed, motion.acceleration)
    window = samples_of_cubic(usual_step(measured.time))
    middle = np.arange(window // 2, len(torque) - window // 2)  # a cubic tells little of the speed at its ends
    good = middle[np.isfinite(torque[middle]).all(axis=1)]
    if not len(good):
        return
    part = Motion(motion.time[good], motion.position[good], motion.speed[good], motion.acceleration[good])
    yield KnownTorque(part, noise, sample, window, torque[good], (torque - asked)[good], inertia[good], known)


def _dofs(compiled: mujoco.MjModel, joints: Sequence[str]) -> NDArray[np.intp]:
    return np.array([compiled.jnt_dofadr[joint_id(compiled, j)] for j in joints], dtype=np.intp)


def given(compiled: mujoco.MjModel, actuator: int, asked: Array) -> Array:
    """Torques at the joint of an actuator that is asked for controls, of any shape, within all limits."""

    def within(values: Array, limited: object, bounds: Array) -> Array:
        return np.clip(values, *bounds) if limited else values

    m, joint = compiled, compiled.actuator_trnid[actuator, 0]
    control = within(asked, m.actuator_ctrllimited[actuator], m.actuator_ctrlrange[actuator])
    force = m.actuator_gainprm[actuator, 0] * control
    force = within(force, m.actuator_forcelimited[actuator], m.actuator_forcerange[actuator])
    return within(m.actuator_gear[actuator, 0] * force, m.jnt_actfrclimited[joint], m.jnt_actfrcrange[joint])
