# SPDX-License-Identifier: Apache-2.0
"""Loads MJCF and URDF files, says what is in them, and prepares them for many fast simulations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import mujoco
import numpy as np

from trueup import files
from trueup.arrays import Array
from trueup.engines.mujoco.attributes import OBJECTS, MujocoAttributes, is_position_servo
from trueup.engines.mujoco.fields import SingleModel
from trueup.engines.mujoco.floor_plane import add_floor, plane_of, rule
from trueup.engines.mujoco.gears import add_second
from trueup.engines.mujoco.reading.mjcf_spec import mjcf_spec
from trueup.engines.mujoco.reading.urdf_spec import urdf_spec
from trueup.errors import ModelError, unknown_name
from trueup.model_files.urdf import root_tag
from trueup.rounding import NEGLIGIBLE
from trueup.trial import LONGEST_STEP
from trueup.units import FURTHEST_TURN

# Sensors that look at geoms, those without contacts too.
_SEEING = tuple(int(getattr(mujoco.mjtSensor, f"mjSENS_{n}")) for n in
                ("RANGEFINDER", "GEOMDIST", "GEOMNORMAL", "GEOMFROMTO", "TACTILE", "PLUGIN"))  # fmt: skip
_MEASURED = {int(mujoco.mjtSensor.mjSENS_ACCELEROMETER): "m/s^2", int(mujoco.mjtSensor.mjSENS_GYRO): "rad/s"}
SETTING = "trueup_"
"""Begins the name of a <numeric> that says for which setting of its servos a calibrated file holds."""
_ITERATIONS, _LINE_SEARCH = 100, 50  # MuJoCo's own; a solver that has converged stops earlier
_OBJECTS = {**OBJECTS, "sensor": mujoco.mjtObj.mjOBJ_SENSOR}


@dataclass(frozen=True, eq=False)
class Model:
    """A compiled model, the spec it came from, and what had to be left out to load it."""

    path: Path
    spec: mujoco.MjSpec
    compiled: mujoco.MjModel
    notes: tuple[str, ...] = ()
    """What was changed or lost on loading, in words."""
    still: tuple[str, ...] = ()
    """Joints that are held in simulations, though the file lets them move (see `still.with_still_joints`)."""
    given: Model | None = None
    """What a calibrated file is made of, where this was changed for the fit alone: a base held, contacts left out."""
    driven: Model | None = None
    """The same with the drives that were added for the fit."""
    guessed: bool = False
    """Whether servos were added whose gains nobody has said: there is no such robot to compare with."""

    def __getstate__(self) -> dict[str, object]:
        """As it is sent to another process: what is simulated, not what a file is written from."""
        return {**self.__dict__, "spec": None, "given": None, "driven": None}

    @property
    def own_step(self) -> float:
        """s: integration step that its file names, `LONGEST_STEP` at most; MuJoCo's usual one where it names none."""
        return min(float(self.compiled.opt.timestep), LONGEST_STEP)

    @property
    def name(self) -> str:
        """The file's name without its ending."""
        return self.path.stem

    @property
    def is_mjcf(self) -> bool:
        """True for MJCF, False for URDF."""
        return root_tag(self.path) == "mujoco"

    def names(self, kind: str) -> tuple[str, ...]:
        """All names of one kind ('joint', 'actuator', 'body', 'geom', 'sensor'), '' where one has none; () of any other."""
        return self._named.get(kind, ())

    @cached_property
    def _named(self) -> dict[str, tuple[str, ...]]:
        m = self.compiled
        count = {"joint": m.njnt, "actuator": m.nactuator, "body": m.nbody, "geom": m.ngeom, "sensor": m.nsensor}
        return {k: tuple(getattr(m, k)(i).name for i in range(n)) for k, n in count.items()}

    def index(self, kind: str, name: str) -> int:
        """The id of a named element. Raises UnknownNameError, which lists the names of that kind."""
        found = mujoco.mj_name2id(self.compiled, _OBJECTS[kind], name)
        if found < 0:
            raise unknown_name(kind, name, [n for n in self.names(kind) if n])
        return int(found)

    def scalar_joints(self) -> tuple[str, ...]:
        """Names of the hinge and slide joints that move in simulations, in the model's order."""
        return self._scalar

    @cached_property
    def _scalar(self) -> tuple[str, ...]:
        kinds = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
        names = self.names("joint")
        return tuple(
            n for i, n in enumerate(names) if n and int(self.compiled.jnt_type[i]) in kinds and n not in self.still
        )

    def actuator_of_joint(self) -> dict[str, int]:
        """Joint name to the first actuator that drives it."""
        model = self.compiled
        names = self.names("joint")
        joint_kinds = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
        found: dict[str, int] = {}
        for i in range(model.nactuator):
            if int(model.actuator_trntype[i]) in joint_kinds:
                found.setdefault(names[int(model.actuator_trnid[i, 0])], i)
        return found

    def drives(self) -> dict[str, str]:
        """Hinge and slide joints, each to the name of the actuator that drives it, '' where none does."""
        driven, names = self.actuator_of_joint(), self.names("actuator")
        return {joint: names[driven[joint]] if joint in driven else "" for joint in self.scalar_joints()}

    def counted(self) -> dict[str, str]:
        """What `drives` has in the order in which a log that only numbers its motors counts them: of the actuators, where
        each joint has one. Bodies often stand in another (legs left first, in a file of a robot that counts right first).
        """
        drives = self.drives()
        return {j: drives[j] for j in self.actuator_of_joint() if j in drives} if all(drives.values()) else drives

    def sensors(self) -> dict[str, str]:
        """Sensors of three numbers, each to the unit of what accelerometers and gyros measure, '' of all others."""
        m, names = self.compiled, self.names("sensor")
        three = [i for i in range(m.nsensor) if names[i] and int(m.sensor_dim[i]) == len("xyz")]
        return {names[i]: _MEASURED.get(int(m.sensor_type[i]), "") for i in three}

    def columns(self) -> dict[str, int]:
        """Actuators, each to its column in the controls."""
        return {name: int(self.compiled.actuator_ctrladr[i]) for i, name in enumerate(self.names("actuator"))}

    @property
    def width(self) -> int:
        """Number of controls."""
        return int(self.compiled.nu)

    def get(self, attribute: str, name: str) -> Array:
        """(1, ...) an attribute of a named element (see `articulated.model`). Raises UnknownNameError."""
        return MujocoAttributes(self.compiled, SingleModel(self.compiled)).get(attribute, name)

    def changed(self, spec: mujoco.MjSpec, how: str, note: str) -> Model:
        """The model as a changed spec has it, with a note. Raises ModelError where it does not compile so (`how`)."""
        try:
            compiled = spec.compile()
        except (ValueError, mujoco.FatalError) as error:
            raise ModelError(f"model '{self.path}' does not compile {how}: {error}") from None
        return Model(self.path, spec, compiled, (*self.notes, note))

    def settings(self) -> dict[str, float]:
        """For which settings of its servos the file holds, where it says so; by quantity ('kp')."""
        m = self.compiled
        names = [m.numeric(i).name for i in range(m.nnumeric)]
        data = m.numeric_data[m.numeric_adr]
        own = zip(names, data.tolist(), strict=True)
        return {n.removeprefix(SETTING): float(v) for n, v in own if n.startswith(SETTING)}

    def is_position_servo(self, actuator: int) -> bool:
        """True where the actuator is a position servo: force = kp (command - position) - kv velocity."""
        return is_position_servo(self.compiled, actuator)


def load(path: str | Path) -> Model:
    """Loads an MJCF or URDF file. Meshes that are missing, or name packages, are left out and said.

    Raises ModelError where the file does not exist or does not compile, with MuJoCo's reason.
    """
    file = Path(path)
    files.check(file, ModelError)
    tag = root_tag(file)
    if tag not in ("mujoco", "robot"):
        part = "; this is a part that a whole model includes: give that one" if tag == "mujocoinclude" else ""
        part = (
            "; SDF is not read: give the URDF that it was made of, or an MJCF of this robot" if tag == "sdf" else part
        )
        raise ModelError(f"model file '{file}' starts with <{tag}>; expected <mujoco> (MJCF) or <robot> (URDF){part}")
    if tag == "mujoco":
        spec, compiled, notes = mjcf_spec(file)
    else:
        spec, notes = urdf_spec(file)
        compiled = spec.compile()
    _check_placed(file, compiled)
    return Model(file, spec, compiled, tuple(notes))


def _check_placed(file: Path, compiled: mujoco.MjModel) -> None:
    """Raises ModelError for a body or a joint that is nowhere: MuJoCo compiles that."""
    for kind, places in (("body", compiled.body_pos), ("joint", compiled.jnt_pos)):
        for i in np.flatnonzero(~np.isfinite(places).all(axis=1)):
            name = getattr(compiled, kind)(i).name or f"number {i}"
            raise ModelError(
                f"model '{file}': {kind} '{name}' is at ({' '.join(f'{v:g}' for v in places[i])}) m; give numbers"
            )


def prepared(
    model: Model, *, step: float, second: Mapping[str, Sequence[str]] | None = None, limited: Sequence[str] = (),
    stopped: Sequence[str] = (), held: bool = False, floor: bool = False, sliding: bool = False, bare: bool = False,
) -> mujoco.MjModel:  # fmt: skip
    """A compiled copy for simulation: visual geoms and delays of commands dropped, a joint for each gap or gear.

    `step` in s; `second` are joints, by SECOND, that get a second one '<name>/slack' with a range of its own (MuJoCo's
    documented way to model backlash) or a spring; `limited` actuators get a force range, `stopped` joints a range; where
    weight may be `held` MuJoCo is made to look for it; `floor` adds a plane to a model without one, `sliding` has its
    friction count against that of the feet. `bare` leaves out all shapes, for simulations in which nothing touches.
    """
    spec = model.spec.copy()
    spec.option.timestep = step
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    # Files for MJX stop the solver after an iteration or two, with which contacts are soft or blow up.
    spec.option.iterations = max(spec.option.iterations, _ITERATIONS)
    spec.option.ls_iterations = max(spec.option.ls_iterations, _LINE_SEARCH)
    _hold(spec, model)
    if bare:
        _unshape(spec)
    if bare or not needs_shapes(model.compiled):
        _drop_visuals(spec, model.compiled)
    # Before anything else is added, with which a spec forgets which of its parts is which.
    if floor and plane_of(model.compiled) < 0:
        add_floor(spec)
    elif sliding:
        rule(spec, model.compiled)
    for actuator in spec.actuators:
        # Signals delay commands, by fractions of a step too; the engine's own delay would come on top.
        actuator.delay, actuator.nsample = 0.0, 0
    for kind, names in (second or {}).items():
        for name in names:
            add_second(spec, name, kind, float(model.get("joint.inertia", name)[0]))
    for name in limited:
        actuator = spec.actuator(name)
        if actuator.forcelimited != mujoco.mjtLimited.mjLIMITED_TRUE and not np.any(actuator.forcerange):
            actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
            actuator.forcerange = [-1e6, 1e6]
    for name in stopped:
        _limit(spec, name, model.compiled)
    if held and not model.compiled.ngravcomp:
        spec.bodies[1].gravcomp = NEGLIGIBLE
    return spec.compile()


def _limit(spec: mujoco.MjSpec, name: str, compiled: mujoco.MjModel) -> None:
    """Gives a joint without a range one that it never leaves, in rad or m."""
    if not compiled.jnt_limited[compiled.joint(name).id]:
        joint = spec.joint(name)
        hinge = joint.type == mujoco.mjtJoint.mjJNT_HINGE
        open_end = np.degrees(FURTHEST_TURN) if hinge and spec.compiler.degree else FURTHEST_TURN
        joint.limited, joint.range = mujoco.mjtLimited.mjLIMITED_TRUE, [-open_end, open_end]


def _hold(spec: mujoco.MjSpec, model: Model) -> None:
    """Takes out the joints that are held; MuJoCo takes their places out of keyframes."""
    for name in model.still:
        spec.delete(spec.joint(name))


def needs_shapes(compiled: mujoco.MjModel) -> bool:
    """Whether shapes matter without any contact: sensors look at them, or a fluid flows around them."""
    fluid = bool(compiled.opt.density or compiled.opt.viscosity)
    return fluid or compiled.nflex > 0 or bool(np.isin(compiled.sensor_type, _SEEING).any())


def _unshape(spec: mujoco.MjSpec) -> None:
    """Makes everything visual."""
    for pair in list(spec.pairs):
        spec.delete(pair)
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0


def _drop_visuals(spec: mujoco.MjSpec, compiled: mujoco.MjModel) -> None:
    """Leaves out geoms that touch nothing, and meshes and textures that only pictures need: every copy of the model
    would carry them along. The bodies keep the inertia that the full model gave them.
    """
    spec.compiler.discardvisual = True
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
    for body in spec.bodies[1:]:
        i = body.id
        body.explicitinertial = True
        body.mass = compiled.body_mass[i]
        body.ipos, body.iquat = compiled.body_ipos[i], compiled.body_iquat[i]
        body.inertia = compiled.body_inertia[i]
        body.fullinertia = np.full(6, np.nan)
