# SPDX-License-Identifier: Apache-2.0
"""Writes a calibrated MJCF: the same file with other values in it, loaded again and compared before it counts."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from trueup.arrays import Array
from trueup.articulated.assignments import needs, write
from trueup.articulated.model import WORLD
from trueup.engines.mujoco.attributes import MujocoAttributes
from trueup.engines.mujoco.base import free_joint
from trueup.engines.mujoco.fields import SingleModel
from trueup.engines.mujoco.floor_plane import plane_of
from trueup.engines.mujoco.gears import SECOND_OF
from trueup.engines.mujoco.inertia import body_inertia
from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.reading.mjcf_spec import name_in_text
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.engines.mujoco.writing.edits import Edits, read
from trueup.engines.mujoco.writing.notes import delays_of, has_drive, notes_of, punches_of
from trueup.errors import ModelError, OutputError
from trueup.model_files.references import relocate
from trueup.model_files.xml_text import XmlText, numbers, with_includes
from trueup.rounding import NEGLIGIBLE, PRINTED

_FIELDS = {
    **dict.fromkeys(("actuator.kp", "actuator.kv", "actuator.gain", "actuator.zero"),
                    ("actuator_gainprm", "actuator_biasprm")),
    "actuator.force_limit": ("actuator_forcerange",),
    "joint.damping": ("dof_damping",),
    "joint.damping_quadratic": ("dof_dampingpoly",),
    "joint.friction": ("dof_frictionloss",),
    "joint.creep": ("dof_solimp",),
    "joint.armature": ("dof_armature",),
    **dict.fromkeys(("joint.spring", "joint.spring_cubic", "joint.spring_rest"),
                    ("jnt_stiffness", "jnt_stiffnesspoly", "qpos_spring")),
    **dict.fromkeys(("joint.stop_lower", "joint.stop_upper"), ("jnt_range",)),
    "body.mass": ("body_mass", "body_ipos"),
    "body.com": ("body_mass", "body_ipos"),
    "body.held": ("body_gravcomp",),
    "geom.friction": ("geom_friction",),
    "geom.softness": ("geom_solref",),
}  # fmt: skip
"""Fields that must be the same in the written file, by the attribute that was calibrated."""
_FLOOR = (
    "geom_pos",
    "geom_quat",
    "geom_friction",
    "geom_priority",
    "geom_condim",
    "geom_solref",
    "geom_solimp",
    "geom_contype",
    "geom_conaffinity",
)
_SECOND = (
    "jnt_range",
    "jnt_stiffness",
    "jnt_axis",
    "jnt_pos",
    "jnt_solref",
    "jnt_solimp",
    "dof_damping",
    "dof_armature",
    "dof_frictionloss",
)


def write_model(simulator: MujocoSimulator, values: ArrayLike, path: str | Path) -> tuple[str, ...]:
    """Writes the model with parameter values (n,) as MJCF to `path`; returns notes on what MJCF cannot say.

    The file that was loaded is kept byte for byte but for the attributes that changed; what came from a default class
    is written at the element itself, what stands in an included file in its place. Where that cannot be (URDF) MuJoCo
    writes the model anew, and a note says so. What was done for the fit alone (a base held, contacts left out, drives
    added) is not written; with drives added a second file beside it has them. The result is loaded and compared with what
    was simulated before it takes its place.

    Raises ModelError where the written model would not be the simulated one, and OutputError where the disk or folder
    does not take it; what was at `path` before is then untouched.
    """
    target = Path(path)
    given = np.asarray(values, dtype=np.float64)
    if given.shape != (len(simulator.quantities),):
        raise ModelError(f"expected {len(simulator.quantities)} values, one for each parameter, got {given.shape}")
    model = simulator.model
    lost = _written_of(simulator, given, model.given or model, target)
    if model.driven is not None:
        beside = target.with_name(f"{target.stem}_driven{target.suffix}")
        _written_of(simulator, given, model.driven, beside)
        lost += (f"{target.name} keeps the drives that it came with. {beside.name} has those that were fitted: errors shown "
                 "are its errors; for a controller of your own their gains are in parameters.toml",)  # fmt: skip
    return (*notes_of(simulator, given), *lost)


def _written_of(simulator: MujocoSimulator, values: Array, base: Model, path: Path) -> tuple[str, ...]:
    """Writes `base` with values (n,), as near to its text as can be; what could not be kept, in words."""
    wanted = simulated_model(simulator, values)
    reason = "the model came as URDF"
    if base.is_mjcf:
        content = base.path.read_bytes()
        for whole in (lambda: content, lambda: with_includes(content, base.path.parent)):
            try:
                _write(
                    simulator, values, wanted.__copy__(), base, whole(), path, degrees=bool(base.spec.compiler.degree)
                )
            except ModelError as error:
                reason = str(error)
            else:
                return ()
    content = _possible(base.spec.to_xml().encode())
    _write(simulator, values, wanted, base, content, path, degrees=_in_degrees(content), printed=True)
    return (f"comments and layout of the model file could not be kept: {reason}",)


def simulated_model(simulator: MujocoSimulator, values: ArrayLike) -> mujoco.MjModel:
    """The compiled model as the simulator runs it with values (n,): the fields that are part of a model."""
    wanted = simulator.compiled.__copy__()
    given = np.asarray(values, dtype=np.float64)[None]
    write(simulator.quantities, given, MujocoAttributes(simulator.compiled, SingleModel(wanted)))
    return wanted


def _write(
    simulator: MujocoSimulator, values: Array, wanted: mujoco.MjModel, model: Model, content: bytes, path: Path, *,
    degrees: bool, printed: bool = False,
) -> None:  # fmt: skip
    """One attempt: edit the text, write it aside, load it, compare, rename."""
    text = XmlText(content)
    name_in_text(text, model.spec)
    edits = Edits(text, model, wanted, degrees=degrees, printed=printed)
    delays, punches = (_of(model, simulator, values, what) for what in (delays_of, punches_of))
    _relieve(wanted, punches)
    attributes = [*_written(simulator, model), *(("actuator.force_limit", a) for a in punches)]
    for attribute, target in attributes:
        edits.write(attribute, target)
    for actuator, seconds in delays.items():
        edits.delay(actuator, seconds, min(float(model.compiled.opt.timestep), simulator.step))
    for actuator, force in punches.items():
        edits.onset(actuator, force)
    if ("world.gravity", WORLD) in attributes:
        edits.gravity()
    edits.weightless()
    edits.gains(simulator.gains.given_for)
    if model.compiled.opt.integrator != wanted.opt.integrator:
        text.set_last("option", "integrator", "implicitfast")
    if float(model.compiled.opt.timestep) > 1.01 * simulator.step:
        text.set_last("option", "timestep", f"{simulator.step:g}")
    relocate(text, model.path.absolute().parent, path.absolute().parent)
    aside = path.with_name(f".{path.stem}.{os.getpid()}.part.xml")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with aside.open("wb") as file:
            file.write(text.render())
            file.flush()
            os.fsync(file.fileno())
        _compare(simulator, attributes, wanted, _loaded(aside), delays)
        os.replace(aside, path)
    except OSError as error:
        raise OutputError(
            f"cannot write '{path}': {error.strerror or error}; what was there before is untouched"
        ) from error
    finally:
        aside.unlink(missing_ok=True)


def _of(
    model: Model, simulator: MujocoSimulator, values: Array, what: Callable[[MujocoSimulator, Array], dict[str, float]]
) -> dict[str, float]:
    """Delays or punches of the drives that a model has."""
    return {a: value for a, value in what(simulator, values).items() if has_drive(simulator, model, a)}


def _relieve(wanted: mujoco.MjModel, punches: Mapping[str, float]) -> None:
    """Takes off the range of a servo's force what its onset does beside it: both together end where the servo did."""
    for actuator, force in punches.items():
        i = mujoco.mj_name2id(wanted, mujoco.mjtObj.mjOBJ_ACTUATOR, actuator)
        if wanted.actuator_forcelimited[i]:
            least, most = wanted.actuator_forcerange[i]
            wanted.actuator_forcerange[i] = min(least + force, 1e-3 * least), max(most - force, 1e-3 * most)


def _loaded(path: Path) -> mujoco.MjModel:
    try:
        return mujoco.MjModel.from_xml_path(str(path))
    except (ValueError, mujoco.FatalError) as error:
        raise ModelError(f"the calibrated model does not compile: {' '.join(str(error).split())}") from None


def _compare(
    simulator: MujocoSimulator, attributes: Sequence[tuple[str, str]], wanted: mujoco.MjModel, written: mujoco.MjModel,
    delays: dict[str, float],
) -> None:  # fmt: skip
    """Every calibrated field of the written model against the simulated one. Raises ModelError, naming the first."""
    for attribute, target in attributes:
        family = attribute.partition(".")[0]
        if family == "body":
            _close(target, "inertia", _inertia(written, target), _inertia(wanted, target))
        for field in _FIELDS.get(attribute, ()):
            _close(target, field, read(written, family, target, field), read(wanted, family, target, field))
        second = SECOND_OF.get(attribute.removeprefix("joint."))
        for field in _SECOND if second else ():
            name = target + str(second)
            _close(name, field, read(written, "joint", name, field), read(wanted, "joint", name, field))
    _close("bodies", "gravcomp", written.body_gravcomp, wanted.body_gravcomp)
    if needs(simulator.quantities, "floor"):
        planes = plane_of(written), plane_of(wanted)
        for field in _FLOOR:
            there, here = (np.atleast_1d(getattr(m, field)[g]) for m, g in zip((written, wanted), planes, strict=True))
            _close("floor", field, there, here)
    for actuator, seconds in delays.items():
        _close(actuator, "delay", read(written, "actuator", actuator, "actuator_delay"), np.array([seconds]))
    if ("world.gravity", WORLD) in attributes:
        _close("world", "gravity", np.asarray(written.opt.gravity), np.asarray(wanted.opt.gravity))


def _written(simulator: MujocoSimulator, model: Model) -> list[tuple[str, str]]:
    """(attribute, element) of all that the parameters write into a model, in their order: not into drives that it lacks,
    and not how the stand leaned that its free base was held by.
    """
    stood = free_joint(model.compiled) >= 0 > free_joint(simulator.model.compiled)
    return [
        (attribute, target)
        for assignment in simulator.quantities
        if assignment.quantity.written
        for target in assignment.targets
        for attribute in assignment.quantity.attributes
        if (assignment.quantity.family != "actuator" or has_drive(simulator, model, target))
        and not (stood and attribute == "world.gravity")
    ]


def _close(name: str, field: str, written: Array, wanted: Array) -> None:
    size = float(np.max(np.abs(wanted), initial=0.0))
    if written.shape != wanted.shape or not np.all(np.abs(written - wanted) <= PRINTED * size + NEGLIGIBLE):
        raise ModelError(
            f"the written model differs from the simulated one: {field} of '{name}' is {written}, not {wanted}"
        )


def _inertia(model: mujoco.MjModel, body: str) -> Array:
    found = int(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, body))
    return body_inertia(model, found) if found >= 0 else np.full((3, 3), np.nan)


def _possible(content: bytes) -> bytes:
    """MuJoCo's own text with the largest moment of thin bodies taken back by what rounding to six digits added to it."""
    text = XmlText(content)
    for element in text.all("inertial"):
        moments = [float(v) for v in element.attributes.get("diaginertia", "").split()]
        if len(moments) == 3 and 2.0 * max(moments) > sum(moments):
            moments[moments.index(max(moments))] = (sum(moments) - max(moments)) * (1.0 - 1e-8)
            text.change(element, diaginertia=numbers(moments, 12))
    return text.render()


def _in_degrees(content: bytes) -> bool:
    return not any(e.attributes.get("angle") == "radian" for e in XmlText(content).all("compiler"))
