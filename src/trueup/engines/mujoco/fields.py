# SPDX-License-Identifier: Apache-2.0
"""Writes parameter values into the per-simulation model fields of a batch: all simulations at once, no rebuild."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from trueup.articulated.inertia import COMPONENTS, from_log_cholesky, principal
from trueup.engines.mujoco.floor_plane import FLOOR_KINDS, plane_of, turned
from trueup.engines.mujoco.inertia import log_cholesky_of_body
from trueup.engines.mujoco.quantities import Quantity

Array = NDArray[np.float64]


class Fields(Protocol):
    """Per-simulation values of a model field by name, (b, ...); a `mujoco.batch.Batch` offers it as `expand`."""

    def expand(self, name: str) -> Array:
        """The live array of a field."""
        ...


class SingleModel:
    """One compiled model seen as a batch of one, so that the same code writes files and simulations."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model

    def expand(self, name: str) -> Array:
        """A view of the model's own field with a leading axis of one."""
        owner = self._model.opt if name.startswith("opt.") else self._model
        return getattr(owner, name.removeprefix("opt."))[None]


class FromNominal:
    """Fields of a batch, each set back to the model's own values the first time it is asked for."""

    def __init__(self, batch: Fields, model: mujoco.MjModel) -> None:
        self._batch, self._model = batch, model
        self._done: set[str] = set()

    def expand(self, name: str) -> Array:
        """The live array of a field."""
        live = self._batch.expand(name)
        if name not in self._done:
            owner = self._model.opt if name.startswith("opt.") else self._model
            live[:] = getattr(owner, name.removeprefix("opt."))
            self._done.add(name)
        return live


def write_fields(model: mujoco.MjModel, fields: Fields, quantities: Sequence[Quantity], values: Array) -> None:
    """Writes values (b, n) of the parameters into `fields`. Kinds that are not model fields are skipped."""
    inertias: dict[int, dict[int, Array]] = {}
    tilt = np.zeros((len(values), 2))
    floor: dict[str, Array] = {}
    zeros: dict[str, Array] = {}
    for column, quantity in enumerate(quantities):
        for i, target in enumerate(quantity.targets):
            value = values[:, column] * quantity.sign(i)
            if quantity.kind.startswith("inertia_"):
                body = _id(model, mujoco.mjtObj.mjOBJ_BODY, target)
                inertias.setdefault(body, {})[COMPONENTS.index(quantity.kind.removeprefix("inertia_"))] = value
            elif quantity.kind in FLOOR_KINDS:
                floor[quantity.kind] = value
            elif quantity.kind.startswith("tilt_"):
                tilt[:, 0 if quantity.kind == "tilt_roll" else 1] = value
            elif quantity.kind == "zero":
                zeros[target] = value
            elif quantity.kind in _WRITERS:
                _WRITERS[quantity.kind](model, fields, target, value)
    for body, components in inertias.items():
        _write_inertia(model, fields, body, components)
    for target, value in zeros.items():  # once every stiffness is known
        i = _id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, target)
        fields.expand("actuator_biasprm")[:, i, 0] = fields.expand("actuator_gainprm")[:, i, 0] * value
    if np.any(tilt):
        _write_tilt(model, fields, tilt)
    if floor:
        _write_floor(model, fields, floor, np.zeros(len(values)))


def _write_inertia(model: mujoco.MjModel, fields: Fields, body: int, components: dict[int, Array]) -> None:
    theta = np.repeat(log_cholesky_of_body(model, body)[None], len(next(iter(components.values()))), axis=0)
    for component, value in components.items():
        theta[:, component] = value
    mass, com, inertia = from_log_cholesky(theta)
    moments, quaternions = principal(inertia)
    fields.expand("body_mass")[:, body] = mass
    fields.expand("body_ipos")[:, body] = com
    fields.expand("body_inertia")[:, body] = moments
    fields.expand("body_iquat")[:, body] = quaternions


def _write_tilt(model: mujoco.MjModel, fields: Fields, tilt: Array) -> None:
    """Turns gravity about x, then y: the base stands on a slope that the model does not know."""
    g = np.asarray(model.opt.gravity)
    (cr, cp), (sr, sp) = np.cos(tilt).T, np.sin(tilt).T
    rolled = np.stack([np.full_like(cr, g[0]), cr * g[1] - sr * g[2], sr * g[1] + cr * g[2]], axis=-1)
    fields.expand("opt.gravity")[:] = np.stack(
        [cp * rolled[:, 0] + sp * rolled[:, 2], rolled[:, 1], -sp * rolled[:, 0] + cp * rolled[:, 2]], axis=-1
    )


def _write_floor(model: mujoco.MjModel, fields: Fields, floor: dict[str, Array], level: Array) -> None:
    plane = plane_of(model)
    if "floor_height" in floor:
        fields.expand("geom_pos")[:, plane, 2] = floor["floor_height"]
    if "floor_roll" in floor or "floor_pitch" in floor:
        fields.expand("geom_quat")[:, plane] = turned(
            model.geom_quat[plane], floor.get("floor_roll", level), floor.get("floor_pitch", level)
        )
    if "floor_friction" in floor:
        fields.expand("geom_friction")[:, plane, 0] = floor["floor_friction"]


def _id(model: mujoco.MjModel, kind: mujoco.mjtObj, name: str) -> int:
    return int(mujoco.mj_name2id(model, kind, name))


def _dof(model: mujoco.MjModel, joint: str) -> int:
    return int(model.jnt_dofadr[_id(model, mujoco.mjtObj.mjOBJ_JOINT, joint)])


def _dof_field(field: str, column: int | None = None) -> Callable[[mujoco.MjModel, Fields, str, Array], None]:
    def write(model: mujoco.MjModel, fields: Fields, target: str, value: Array) -> None:
        where = fields.expand(field)[:, _dof(model, target)]
        if column is None:
            fields.expand(field)[:, _dof(model, target)] = value
        else:
            where[:, column] = value

    return write


def _creep(model: mujoco.MjModel, fields: Fields, target: str, value: Array) -> None:
    fields.expand("dof_solimp")[:, _dof(model, target), :2] = (1.0 - value)[:, None]


def _kp(model: mujoco.MjModel, fields: Fields, target: str, value: Array) -> None:
    i = _id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, target)
    fields.expand("actuator_gainprm")[:, i, 0] = value
    fields.expand("actuator_biasprm")[:, i, 1] = -value


def _kv(model: mujoco.MjModel, fields: Fields, target: str, value: Array) -> None:
    fields.expand("actuator_biasprm")[:, _id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, target), 2] = -value


def _gain(model: mujoco.MjModel, fields: Fields, target: str, value: Array) -> None:
    """Scales the whole force: gain and bias alike (a wrong torque constant, a sagging supply)."""
    i = _id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, target)
    gain, bias = fields.expand("actuator_gainprm")[:, i], fields.expand("actuator_biasprm")[:, i]
    gain *= value[:, None]
    bias *= value[:, None]


def _force_limit(model: mujoco.MjModel, fields: Fields, target: str, value: Array) -> None:
    ranges = fields.expand("actuator_forcerange")[:, _id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, target)]
    ranges[:, 0], ranges[:, 1] = -value, value


def _backlash(model: mujoco.MjModel, fields: Fields, target: str, value: Array) -> None:
    joint = _id(model, mujoco.mjtObj.mjOBJ_JOINT, f"{target}/slack")
    ranges = fields.expand("jnt_range")[:, joint]
    half = np.maximum(0.5 * value, 1e-6)
    ranges[:, 0], ranges[:, 1] = -half, half


def _mass(model: mujoco.MjModel, fields: Fields, target: str, value: Array) -> None:
    """A denser or lighter body of the same shape: inertia about the CoM scales with the mass, so it stays physical."""
    i = _id(model, mujoco.mjtObj.mjOBJ_BODY, target)
    fields.expand("body_mass")[:, i] = value
    fields.expand("body_inertia")[:, i] = model.body_inertia[i] * (value / model.body_mass[i])[:, None]


def _com(axis: int) -> Callable[[mujoco.MjModel, Fields, str, Array], None]:
    def write(model: mujoco.MjModel, fields: Fields, target: str, value: Array) -> None:
        fields.expand("body_ipos")[:, _id(model, mujoco.mjtObj.mjOBJ_BODY, target), axis] = value

    return write


def _geom(field: str) -> Callable[[mujoco.MjModel, Fields, str, Array], None]:
    def write(model: mujoco.MjModel, fields: Fields, target: str, value: Array) -> None:
        fields.expand(field)[:, _id(model, mujoco.mjtObj.mjOBJ_GEOM, target), 0] = value

    return write


_WRITERS: dict[str, Callable[[mujoco.MjModel, Fields, str, Array], None]] = {
    "kp": _kp,
    "kv": _kv,
    "gain": _gain,
    "force_limit": _force_limit,
    "damping": _dof_field("dof_damping"),
    "damping_quadratic": _dof_field("dof_dampingpoly", 0),
    "friction": _dof_field("dof_frictionloss"),
    "friction_creep": _creep,
    "armature": _dof_field("dof_armature"),
    "backlash": _backlash,
    "mass": _mass,
    "com_x": _com(0),
    "com_y": _com(1),
    "com_z": _com(2),
    "contact_friction": _geom("geom_friction"),
    "contact_softness": _geom("geom_solref"),
}

LIVE_KINDS = ("dead_band", "friction_static", "stribeck_speed", "friction_load")
"""Kinds that act at every step and so need the simulations stepped in lockstep."""
SIGNAL_KINDS = (
    "delay",
    "speed_limit",
    "acceleration_limit",
    "bias",
    "offset",
    "sensor_delay",
    "clock",
    "start_position",
    "start_velocity",
)
"""Kinds that change signals, not the model."""
