# SPDX-License-Identifier: Apache-2.0
"""What may be calibrated in a MuJoCo model: each kind of quantity, its unit, its usual bounds, and where it lives.

A `Quantity` says which elements one parameter writes; several elements share one value (a group, a mirrored pair).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from trueup.articulated.inertia import COMPONENTS
from trueup.engines.mujoco.floor_plane import FLOOR_FRICTION, plane_of
from trueup.engines.mujoco.inertia import log_cholesky_of_body
from trueup.engines.mujoco.model import Model
from trueup.errors import ModelError, unknown_name

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Kind:
    """One kind of quantity. `bounds` gives (lower, upper) from a nominal value, in `unit`."""

    name: str
    family: str
    """What its targets are: joint, actuator, body, geom, channel, world, recording or controller."""
    unit: str
    scale: str
    nominal: Callable[[Model, str], float]
    """The model's own value for one target."""
    bounds: Callable[[float], tuple[float, float]]
    title: str
    shown_by: str = ""
    """Which motion shows it."""


_LINEAR = {
    "N m/rad": "N/m", "N m s/rad": "N s/m", "N m s2/rad2": "N s2/m2", "N m": "N", "kg m2": "kg", "rad": "m",
    "rad/s": "m/s", "rad/s2": "m/s2",
}  # fmt: skip
"""Units of hinges to those of slides."""


def unit_for(kind: Kind, model: Model, target: str) -> str:
    """The unit of a quantity at one joint or actuator: that of `kind`, with m for rad where the joint slides."""
    if kind.family not in ("joint", "actuator"):
        return kind.unit
    joint = model.index("joint", target) if kind.family == "joint" else _driven(model, target)
    slides = joint >= 0 and model.compiled.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
    return _LINEAR.get(kind.unit, kind.unit) if slides else kind.unit


def units_of(kind: Kind) -> tuple[str, ...]:
    """The units that a quantity may have: at hinges, at slides."""
    return kind.unit, _LINEAR.get(kind.unit, kind.unit)


def largest(kind: Kind, model: Model, target: str) -> float:
    """How far beyond its usual upper bound a joint's quantity may be sought, by the drive's strength; 0 if unknown.

    Friction up to what the servo holds against with 0.1 rad (0.02 m) of error, damping to a lag of 0.5 s, armature up to
    the inertia that it moves.
    """
    if kind.family != "joint" or kind.name not in ("friction", "friction_static", "damping", "armature"):
        return 0.0
    joint, actuator = model.index("joint", target), model.actuator_of_joint().get(target, -1)
    if kind.name == "armature":
        return float(model.compiled.dof_M0[model.compiled.jnt_dofadr[joint]])
    if actuator < 0 or not model.is_position_servo(actuator):
        return 0.0
    slides = model.compiled.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
    share = 0.5 if kind.name == "damping" else 0.02 if slides else 0.1  # half a second of lag; an error in m, in rad
    return share * float(model.compiled.actuator_gainprm[actuator, 0])


def _driven(model: Model, actuator: str) -> int:
    i = model.index("actuator", actuator)
    joints = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    return int(model.compiled.actuator_trnid[i, 0]) if int(model.compiled.actuator_trntype[i]) in joints else -1


_SHOWN_BY = {
    "kp": "holding against gravity in several poses, or stiff fast motion",
    "kv": "fast motion",
    "force_limit": "steps large enough to saturate the drive",
    "delay": "fast steps or chirps, recorded at a high rate",
    "speed_limit": "steps large enough to reach it",
    "acceleration_limit": "steps of several sizes",
    "dead_band": "slow reversals of small amplitude",
    "damping": "steady motion at several speeds",
    "damping_quadratic": "fast steady motion",
    "friction": "slow reversals",
    "friction_creep": "long holds under load",
    "friction_static": "starts from rest and slow reversals",
    "armature": "fast accelerations (chirps, steps)",
    "backlash": "slow reversals without load",
    "clock": "fast steps or chirps, recorded at a high rate",
    "zero": "holding in several poses",
    "bias": "holding in several poses",
    "offset": "holding against gravity in several poses",
    "mass": "accelerating and holding against gravity in several poses",
    "contact_friction": "sliding contacts",
    "floor_height": "touching the floor in several places",
    "floor_roll": "touching the floor in several places",
    "floor_pitch": "touching the floor in several places",
    "floor_friction": "sliding along the floor",
    "contact_softness": "landings and impacts",
}


@dataclass(frozen=True)
class Quantity:
    """What one parameter writes: a kind, the elements that take the value, and a sign for each (mirrored sides)."""

    kind: str
    targets: tuple[str, ...]
    signs: tuple[float, ...] = ()

    def sign(self, i: int) -> float:
        """The factor of target i; 1 unless mirrored."""
        return self.signs[i] if self.signs else 1.0


def _factor(down: float, up: float, least: float) -> Callable[[float], tuple[float, float]]:
    """Bounds a factor below and above the nominal, which counts as `least` if it is smaller (a friction of zero)."""

    def bounds(nominal: float) -> tuple[float, float]:
        size = max(nominal, least)
        return (min(size / down, nominal) if nominal > 0 else size / down), size * up

    return bounds


def _around(half: float) -> Callable[[float], tuple[float, float]]:
    return lambda nominal: (nominal - half, nominal + half)


def _between(lower: float, upper: float) -> Callable[[float], tuple[float, float]]:
    return lambda nominal: (min(lower, nominal), max(upper, nominal))


def _dof(field: str, column: int | None = None) -> Callable[[Model, str], float]:
    def read(model: Model, joint: str) -> float:
        dof = int(model.compiled.jnt_dofadr[model.index("joint", joint)])
        value = getattr(model.compiled, field)[dof]
        return float(value if column is None else value[column])

    return read


def _kp(model: Model, actuator: str) -> float:
    return _servo(model, actuator).compiled.actuator_gainprm[model.index("actuator", actuator), 0]


def _kv(model: Model, actuator: str) -> float:
    return -_servo(model, actuator).compiled.actuator_biasprm[model.index("actuator", actuator), 2]


def _zero_error(model: Model, actuator: str) -> float:
    i = _servo(model, actuator).index("actuator", actuator)
    return float(model.compiled.actuator_biasprm[i, 0] / model.compiled.actuator_gainprm[i, 0])


def _servo(model: Model, actuator: str) -> Model:
    if not model.is_position_servo(model.index("actuator", actuator)):
        names = model.names("actuator")
        servos = [n for i, n in enumerate(names) if n and model.is_position_servo(i)]
        raise ModelError(
            f"actuator '{actuator}' is not a position servo, so it has no kp, kv or dead band; "
            f"position servos are: {', '.join(servos) or 'none'}"
        )
    return model


def _force_limit(model: Model, actuator: str) -> float:
    i = model.index("actuator", actuator)
    return float(model.compiled.actuator_forcerange[i, 1]) if model.compiled.actuator_forcelimited[i] else 0.0


def _mass(model: Model, body: str) -> float:
    return float(model.compiled.body_mass[model.index("body", body)])


def _com(axis: int) -> Callable[[Model, str], float]:
    return lambda model, body: float(model.compiled.body_ipos[model.index("body", body), axis])


def _inertia(component: int) -> Callable[[Model, str], float]:
    return lambda model, body: float(log_cholesky_of_body(model.compiled, model.index("body", body))[component])


def _creep(model: Model, joint: str) -> float:
    """MuJoCo lets a joint that dry friction should hold creep: one minus the impedance of its friction constraint.

    The default, 0.1, means some 10 mrad/s for a small arm; real gears stick, which is 0.001 and less.
    """
    return float(1.0 - model.compiled.dof_solimp[int(model.compiled.jnt_dofadr[model.index("joint", joint)]), 0])


def _geom(field: str) -> Callable[[Model, str], float]:
    return lambda model, geom: float(getattr(model.compiled, field)[model.index("geom", geom), 0])


def _floor(field: str, column: int, otherwise: float) -> Callable[[Model, str], float]:
    """The plane that the model stands on, or what a floor would start with that it lacks."""

    def read(model: Model, target: str) -> float:
        plane = plane_of(model.compiled)
        return float(getattr(model.compiled, field)[plane, column]) if plane >= 0 else otherwise

    return read


def _zero(model: Model, target: str) -> float:
    return 0.0


def _delay(model: Model, actuator: str) -> float:
    return float(model.compiled.actuator_delay[model.index("actuator", actuator)])


def _constant(value: float) -> Callable[[Model, str], float]:
    return lambda model, target: value


def _inertia_bounds(component: str) -> Callable[[float], tuple[float, float]]:
    if component.startswith("t"):
        return _around(0.1)
    if component == "alpha":
        return _around(0.5 * np.log(4.0))
    return _around(np.log(3.0)) if component.startswith("d") else _around(0.2)


def kinds() -> Mapping[str, Kind]:
    """All kinds by name. Bounds are generous: a factor where a value is usually known to a factor.

    Longer than 40 lines because it is one table.
    """
    rows = [
        Kind("kp", "actuator", "N m/rad", "log", _kp, _factor(100, 30, 1.0), "servo stiffness"),
        Kind("kv", "actuator", "N m s/rad", "log", _kv, _factor(100, 30, 0.05), "servo damping"),
        Kind("force_limit", "actuator", "N m", "log", _force_limit, _factor(10, 10, 0.3), "force limit"),
        Kind("gain", "actuator", "", "log", _constant(1.0), _factor(5, 5, 1.0), "factor on the actuator's force"),
        Kind("delay", "actuator", "s", "linear", _delay, _between(0.0, 0.1), "delay of the command"),
        Kind("zero", "actuator", "rad", "linear", _zero_error, _around(0.2), "zero error of the servo's own sensor"),
        Kind("speed_limit", "actuator", "rad/s", "log", _zero, _factor(5, 1e3, 1.0), "speed limit of the command"),
        Kind("acceleration_limit", "actuator", "rad/s2", "log", _zero, _factor(20, 1e4, 10.0),
             "acceleration limit of the command"),
        Kind("dead_band", "actuator", "rad", "linear", _zero, _between(0.0, 0.1), "dead band of the servo"),
        Kind("damping", "joint", "N m s/rad", "log", _dof("dof_damping"), _factor(100, 50, 0.05), "viscous friction"),
        Kind("damping_quadratic", "joint", "N m s2/rad2", "linear", _dof("dof_dampingpoly", 0), _between(0.0, 5.0),
             "friction growing with speed squared"),
        Kind("friction", "joint", "N m", "log", _dof("dof_frictionloss"), _factor(100, 50, 0.05), "Coulomb friction"),
        Kind("friction_creep", "joint", "", "log", _creep, lambda nominal: (1e-4, 0.2), "creep of a joint held by friction"),
        Kind("friction_static", "joint", "N m", "linear", _zero, _between(0.0, 2.0), "breakaway above Coulomb friction"),
        Kind("stribeck_speed", "joint", "rad/s", "log", _constant(0.05), _factor(10, 10, 0.05), "Stribeck speed"),
        Kind("friction_load", "joint", "", "linear", _zero, _between(0.0, 1.0), "friction per unit of actuator force"),
        Kind("armature", "joint", "kg m2", "log", _dof("dof_armature"), _factor(100, 50, 0.005), "rotor inertia"),
        Kind("backlash", "joint", "rad", "linear", _constant(0.005), _between(0.0, 0.1), "backlash, end to end"),
        Kind("bias", "joint", "rad", "linear", _zero, _around(0.2), "error of the position sensor"),
        Kind("offset", "joint", "rad", "linear", _zero, _around(0.2), "zero error shared by sensor and command"),
        Kind("sensor_delay", "channel", "s", "linear", _zero, _between(0.0, 0.1), "delay of a measured channel"),
        Kind("mass", "body", "kg", "log", _mass, _factor(4, 4, 1e-3), "mass (inertia scales along)"),
        Kind("com_x", "body", "m", "linear", _com(0), _around(0.1), "centre of mass, x in the body frame"),
        Kind("com_y", "body", "m", "linear", _com(1), _around(0.1), "centre of mass, y in the body frame"),
        Kind("com_z", "body", "m", "linear", _com(2), _around(0.1), "centre of mass, z in the body frame"),
        Kind("tilt_roll", "world", "rad", "linear", _zero, _around(0.2), "gravity turned about x"),
        Kind("tilt_pitch", "world", "rad", "linear", _zero, _around(0.2), "gravity turned about y"),
        Kind("floor_height", "world", "m", "linear", _floor("geom_pos", 2, 0.0), _around(0.05), "height of the floor"),
        Kind("floor_roll", "world", "rad", "linear", _zero, _around(0.2), "floor turned about x"),
        Kind("floor_pitch", "world", "rad", "linear", _zero, _around(0.2), "floor turned about y"),
        Kind("floor_friction", "world", "", "log", _floor("geom_friction", 0, FLOOR_FRICTION), _factor(30, 5, 0.3),
             "sliding friction of the floor"),
        Kind("contact_friction", "geom", "", "log", _geom("geom_friction"), _factor(10, 5, 0.3), "sliding friction"),
        Kind("contact_softness", "geom", "s", "log", _geom("geom_solref"), _factor(5, 10, 0.01),
             "time constant of the contact"),
        Kind("clock", "recording", "s", "linear", _zero, _around(0.1), "how late the commands' time stamps are"),
        Kind("start_position", "recording", "rad", "linear", _zero, _around(0.2), "correction of the start position"),
        Kind("start_velocity", "recording", "rad/s", "linear", _zero, _around(2.0), "correction of the start speed"),
    ]  # fmt: skip
    rows += [
        Kind(f"inertia_{name}", "body", "m" if name.startswith("t") else "", "linear", _inertia(i),
             _inertia_bounds(name), f"log-Cholesky {name} of the pseudo-inertia")
        for i, name in enumerate(COMPONENTS)
    ]  # fmt: skip
    return {k.name: replace(k, shown_by=_SHOWN_BY.get(k.name, "")) for k in rows}


def kind(name: str) -> Kind:
    """One kind. Raises UnknownNameError, which lists all kinds."""
    known = kinds()
    if name not in known:
        raise unknown_name("quantity", name, known, "what MuJoCo models offer")
    return known[name]
