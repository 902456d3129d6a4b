# SPDX-License-Identifier: Apache-2.0
"""Where MuJoCo keeps the attributes of a model (see `articulated.model`), and how all copies are written at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import mujoco
import numpy as np
from mujoco.batch import Batch

from trueup.arrays import Array
from trueup.articulated.inertia import from_principal, principal
from trueup.engines.mujoco import gears
from trueup.engines.mujoco.fields import Fields, FromNominal
from trueup.engines.mujoco.floor_plane import FLOOR_FRICTION, contact_with, plane_of, rules, turned
from trueup.errors import unknown_name

_JOINTS = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
OBJECTS = {
    "joint": mujoco.mjtObj.mjOBJ_JOINT,
    "actuator": mujoco.mjtObj.mjOBJ_ACTUATOR,
    "body": mujoco.mjtObj.mjOBJ_BODY,
    "geom": mujoco.mjtObj.mjOBJ_GEOM,
}
"""What MuJoCo calls the families of named elements."""
_TILT = "tilt of the floor"
_STATES = {"position": "qpos", "velocity": "qvel", "force": "qfrc_actuator", "bias": "qfrc_bias"}


class MujocoAttributes:
    """Named attributes of b copies of a compiled model, kept in `fields` (`articulated.model.Writable`)."""

    def __init__(self, model: mujoco.MjModel, fields: Fields) -> None:
        self.model, self.fields = model, fields
        self.relative: dict[str, Array] = {}
        """What was written relative to the model: factors on forces, by the actuator's name; the tilt of the floor."""

    def get(self, attribute: str, name: str) -> Array:
        """See Attributes."""
        return _access(attribute).read(self, self.index(attribute, name))

    def set(self, attribute: str, name: str, values: Array) -> None:
        """See Writable."""
        write = _access(attribute).write
        if write is None:
            raise unknown_name("attribute", attribute, [a for a in _ACCESS if _ACCESS[a].write], "what can be written")
        write(self, self.index(attribute, name), values)

    def index(self, attribute: str, name: str) -> int:
        """The id of a named element of an attribute's family; that of the dof for attributes of joints that are dofs'."""
        family, _, what = attribute.partition(".")
        if family not in OBJECTS:
            return plane_of(self.model)
        kind = OBJECTS[family]
        i = int(mujoco.mj_name2id(self.model, kind, name + gears.SECOND_OF.get(what, "")))
        if i < 0 and what not in gears.SECOND_OF:
            count = {"joint": self.model.njnt, "actuator": self.model.nactuator, "body": self.model.nbody}
            names = [getattr(self.model, family)(k).name for k in range(count.get(family, self.model.ngeom))]
            raise unknown_name(family, name, [n for n in names if n])
        return i


class MujocoCopies(MujocoAttributes):
    """The copies of a batch while they are stepped (`articulated.model.Copies`)."""

    def __init__(self, model: mujoco.MjModel, batch: Batch) -> None:
        super().__init__(model, FromNominal(batch, model))
        self._batch = batch

    def reader(self, state: str, joints: Sequence[str]) -> Callable[[int], Array]:
        """See Copies."""
        m = self.model
        address = m.jnt_qposadr if state == "position" else m.jnt_dofadr
        where = np.array([address[self.index("joint.", j)] for j in joints], dtype=np.int64)
        live = self._batch.bind(_STATES[state])
        return lambda n: np.ascontiguousarray(live[:n, where])

    def writer(self, attribute: str, names: Sequence[str]) -> Callable[[Array], None]:
        """See Copies. Raises UnknownNameError for an attribute that is not one number of a dof."""
        if attribute not in _OF_DOFS:
            raise unknown_name("attribute", attribute, _OF_DOFS, "what can be written in each step")
        dofs = np.array([self.model.jnt_dofadr[self.index(attribute, n)] for n in names], dtype=np.int64)
        live = self.fields.expand(_OF_DOFS[attribute])

        def write(values: Array) -> None:
            live[: len(values), dofs] = values

        return write


class _Access(NamedTuple):
    """How one attribute is read, and written where it can be; both with the id of its element."""

    read: Callable[[MujocoAttributes, int], Array]
    write: Callable[[MujocoAttributes, int, Array], None] | None = None


def _access(attribute: str) -> _Access:
    if attribute not in _ACCESS:
        raise unknown_name("attribute", attribute, _ACCESS, "what the MuJoCo engine offers")
    return _ACCESS[attribute]


def _field(name: str, *column: int) -> _Access:
    """One number (or all) of a field at an element; at the dof or the position of a joint, where fields are of these."""

    def place(a: MujocoAttributes, i: int) -> tuple[slice | int, ...]:
        at = {"dof": a.model.jnt_dofadr, "qpos": a.model.jnt_qposadr}.get(name.partition("_")[0])
        return (slice(None), i if at is None else int(at[i]), *column)

    def read(a: MujocoAttributes, i: int) -> Array:
        return np.array(a.fields.expand(name)[place(a, i)])

    def write(a: MujocoAttributes, i: int, values: Array) -> None:
        a.fields.expand(name)[place(a, i)] = values

    return _Access(read, write)


def _only(read: Callable[[mujoco.MjModel, int], float]) -> _Access:
    """Something that is only read, and the same in all copies."""
    return _Access(lambda a, i: np.array([float(read(a.model, i))]))


def _write_kp(a: MujocoAttributes, i: int, values: Array) -> None:
    a.fields.expand("actuator_gainprm")[:, i, 0] = values
    a.fields.expand("actuator_biasprm")[:, i, 1] = -values


def _write_kv(a: MujocoAttributes, i: int, values: Array) -> None:
    a.fields.expand("actuator_biasprm")[:, i, 2] = -values


def _write_zero(a: MujocoAttributes, i: int, values: Array) -> None:
    a.fields.expand("actuator_biasprm")[:, i, 0] = a.fields.expand("actuator_gainprm")[:, i, 0] * values


def _read_zero(a: MujocoAttributes, i: int) -> Array:
    return a.fields.expand("actuator_biasprm")[:, i, 0] / a.fields.expand("actuator_gainprm")[:, i, 0]


def _write_gain(a: MujocoAttributes, i: int, values: Array) -> None:
    """Scales the whole force: gain and bias alike (a wrong torque constant, a sagging supply)."""
    name = a.model.actuator(i).name
    a.fields.expand("actuator_gainprm")[:, i] *= values[:, None]
    a.fields.expand("actuator_biasprm")[:, i] *= values[:, None]
    a.relative[name] = a.relative.get(name, 1.0) * values


def _read_gain(a: MujocoAttributes, i: int) -> Array:
    return np.array(a.relative.get(a.model.actuator(i).name, np.ones(1)))


def _write_limit(a: MujocoAttributes, i: int, values: Array) -> None:
    ranges = a.fields.expand("actuator_forcerange")[:, i]
    ranges[:, 0], ranges[:, 1] = -values, values


def _read_limit(a: MujocoAttributes, i: int) -> Array:
    limited = float(a.model.actuator_forcelimited[i])
    return limited * a.fields.expand("actuator_forcerange")[:, i, 1]


def _second(
    read: Callable[[mujoco.MjModel, Fields, int], Array], write: Callable[[mujoco.MjModel, Fields, int, Array], None]
) -> _Access:
    """What a second joint between drive and link holds."""
    return _Access(lambda a, i: read(a.model, a.fields, i), lambda a, i, v: write(a.model, a.fields, i, v))


def _read_creep(a: MujocoAttributes, i: int) -> Array:
    """MuJoCo lets a joint that dry friction should hold creep: one minus the impedance of its friction constraint.

    The default, 0.1, means some 10 mrad/s for a small arm; real gears stick, which is 0.001 and less.
    """
    return 1.0 - a.fields.expand("dof_solimp")[:, int(a.model.jnt_dofadr[i]), 0]


def _write_creep(a: MujocoAttributes, i: int, values: Array) -> None:
    a.fields.expand("dof_solimp")[:, int(a.model.jnt_dofadr[i]), :2] = (1.0 - values)[:, None]


def _write_mass(a: MujocoAttributes, i: int, values: Array) -> None:
    """A denser or lighter body of the same shape: inertia about the CoM scales with the mass, so it stays physical."""
    mass = a.fields.expand("body_mass")[:, i]
    a.fields.expand("body_inertia")[:, i] *= (values / mass)[:, None]
    mass[:] = values


def _read_inertia(a: MujocoAttributes, i: int) -> Array:
    return from_principal(a.fields.expand("body_inertia")[:, i], a.fields.expand("body_iquat")[:, i])


def _write_inertia(a: MujocoAttributes, i: int, values: Array) -> None:
    moments, quaternions = principal(values)
    a.fields.expand("body_inertia")[:, i] = moments
    a.fields.expand("body_iquat")[:, i] = quaternions


def _stop(side: int) -> _Access:
    """One end of a joint's range; half a turn where it has none."""
    whole = _field("jnt_range", side)
    far = np.array([(-np.pi, np.pi)[side]])
    return _Access(lambda a, i: whole.read(a, i) if a.model.jnt_limited[i] else far, whole.write)


def _slides(m: mujoco.MjModel, joint: int) -> float:
    return float(joint >= 0 and m.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE)


def _driven(m: mujoco.MjModel, actuator: int) -> int:
    return int(m.actuator_trnid[actuator, 0]) if int(m.actuator_trntype[actuator]) in _JOINTS else -1


def is_position_servo(m: mujoco.MjModel, actuator: int) -> bool:
    """True where an actuator is a position servo: force = kp (command - position) - kv velocity."""
    affine = int(m.actuator_biastype[actuator]) == int(mujoco.mjtBias.mjBIAS_AFFINE)
    gain, bias = m.actuator_gainprm[actuator, 0], m.actuator_biasprm[actuator, 1]
    return bool(affine and gain != 0 and np.isclose(gain, -bias))


def is_motor(m: mujoco.MjModel, actuator: int) -> bool:
    """True where the actuator's force is a constant times its control: a torque command, by its gear and gain."""
    plain = int(m.actuator_biastype[actuator]) == int(mujoco.mjtBias.mjBIAS_NONE)
    fixed = int(m.actuator_gaintype[actuator]) == int(mujoco.mjtGain.mjGAIN_FIXED)
    return plain and fixed and int(m.actuator_dyntype[actuator]) == int(mujoco.mjtDyn.mjDYN_NONE)


def follows_position(m: mujoco.MjModel, actuator: int) -> bool:
    """False where a command cannot be an angle: the force of a motor, or of a drive of speed, does not depend on any."""
    bias = int(m.actuator_biastype[actuator])
    affine = bias == int(mujoco.mjtBias.mjBIAS_AFFINE)
    return bias != int(mujoco.mjtBias.mjBIAS_NONE) and (not affine or float(m.actuator_biasprm[actuator, 1]) != 0.0)


def _torque(m: mujoco.MjModel, actuator: int) -> float:
    return float(m.actuator_gear[actuator, 0] * m.actuator_gainprm[actuator, 0]) if is_motor(m, actuator) else 0.0


_HEIGHT, _SLIDING = _field("geom_pos", 2), _field("geom_friction", 0)


def _read_floor_friction(a: MujocoAttributes, i: int) -> Array:
    """Of what stands on the floor, whichever of both friction is, until another is written; or of a floor that is added."""
    if i < 0:
        return np.array([FLOOR_FRICTION])
    own, contact = _SLIDING.read(a, i), contact_with(a.model, i).friction[0]
    return own if rules(a.model, i) else np.where(own == a.model.geom_friction[i, 0], contact, own)


def _write_floor_tilt(a: MujocoAttributes, i: int, values: Array) -> None:
    a.fields.expand("geom_quat")[:, i] = turned(a.model.geom_quat[i], values[:, 0], values[:, 1])
    a.relative[_TILT] = np.array(values)


def _write_gravity(a: MujocoAttributes, i: int, values: Array) -> None:
    a.fields.expand("opt.gravity")[:] = values


_OF_DOFS = {"joint.friction": "dof_frictionloss", "joint.damping": "dof_damping", "joint.armature": "dof_armature"}
_ACCESS: Mapping[str, _Access] = {
    **{attribute: _field(field) for attribute, field in _OF_DOFS.items()},
    "joint.damping_quadratic": _field("dof_dampingpoly", 0),
    "joint.creep": _Access(_read_creep, _write_creep),
    **dict.fromkeys(("joint.backlash", "joint.gear_backlash"), _second(gears.read_gap, gears.write_gap)),
    "joint.gear_compliance": _second(gears.read_compliance, gears.write_compliance),
    "joint.spring": _field("jnt_stiffness"),
    "joint.spring_cubic": _field("jnt_stiffnesspoly", 1),
    "joint.spring_rest": _field("qpos_spring"),
    "joint.stop_lower": _stop(0),
    "joint.stop_upper": _stop(1),
    "joint.inertia": _only(lambda m, i: m.dof_M0[m.jnt_dofadr[i]]),
    "joint.slides": _only(_slides),
    "joint.start": _only(lambda m, i: (m.key_qpos[0] if m.nkey else m.qpos0)[m.jnt_qposadr[i]]),
    "joint.start_velocity": _only(lambda m, i: m.key_qvel[0][m.jnt_dofadr[i]] if m.nkey else 0.0),
    "actuator.kp": _Access(_field("actuator_gainprm", 0).read, _write_kp),
    "actuator.kv": _Access(lambda a, i: -a.fields.expand("actuator_biasprm")[:, i, 2], _write_kv),
    "actuator.zero": _Access(_read_zero, _write_zero),
    "actuator.gain": _Access(_read_gain, _write_gain),
    "actuator.force_limit": _Access(_read_limit, _write_limit),
    "actuator.delay": _only(lambda m, i: m.actuator_delay[i]),
    "actuator.servo": _only(is_position_servo),
    "actuator.slides": _only(lambda m, i: _slides(m, _driven(m, i))),
    "actuator.torque": _only(_torque),
    "body.mass": _Access(_field("body_mass").read, _write_mass),
    "body.com": _field("body_ipos"),
    "body.held": _field("body_gravcomp"),
    "body.inertia": _Access(_read_inertia, _write_inertia),
    "geom.friction": _field("geom_friction", 0),
    "geom.softness": _field("geom_solref", 0),
    "geom.touches": _only(lambda m, i: float(m.geom_contype[i] or m.geom_conaffinity[i])),
    "world.step": _Access(lambda a, i: np.array([a.model.opt.timestep])),
    "world.gravity": _Access(lambda a, i: np.array(a.fields.expand("opt.gravity")), _write_gravity),
    "world.floor_height": _Access(lambda a, i: _HEIGHT.read(a, i) if i >= 0 else np.zeros(1), _HEIGHT.write),
    "world.floor_tilt": _Access(lambda a, i: np.array(a.relative.get(_TILT, np.zeros((1, 2)))), _write_floor_tilt),
    "world.floor_friction": _Access(_read_floor_friction, _SLIDING.write),
}
