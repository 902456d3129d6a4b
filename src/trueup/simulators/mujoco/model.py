# SPDX-License-Identifier: Apache-2.0
"""Loads MJCF and URDF files, says what is in them, and prepares them for many fast simulations."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from trueup.errors import ModelError, unknown_name
from trueup.simulators.mujoco.floor_plane import add_floor, plane_of

_OBJECTS = {
    "joint": mujoco.mjtObj.mjOBJ_JOINT,
    "actuator": mujoco.mjtObj.mjOBJ_ACTUATOR,
    "body": mujoco.mjtObj.mjOBJ_BODY,
    "geom": mujoco.mjtObj.mjOBJ_GEOM,
    "sensor": mujoco.mjtObj.mjOBJ_SENSOR,
}


@dataclass(frozen=True, eq=False)
class Model:
    """A compiled model, the spec it came from, and what had to be left out to load it."""

    path: Path
    spec: mujoco.MjSpec
    compiled: mujoco.MjModel
    notes: tuple[str, ...] = ()
    """What was changed or lost on loading, in words."""

    @property
    def name(self) -> str:
        """The file's name without its ending."""
        return self.path.stem

    @property
    def is_mjcf(self) -> bool:
        """True for MJCF, False for URDF."""
        return _root_tag(self.path) == "mujoco"

    def names(self, kind: str) -> tuple[str, ...]:
        """All names of one kind ('joint', 'actuator', 'body', 'geom', 'sensor'), '' where one has none."""
        model = self.compiled
        count = {"joint": model.njnt, "actuator": model.nactuator, "body": model.nbody, "geom": model.ngeom}
        total = count.get(kind, model.nsensor)
        return tuple(mujoco.mj_id2name(model, _OBJECTS[kind], i) or "" for i in range(total))

    def index(self, kind: str, name: str) -> int:
        """The id of a named element. Raises UnknownNameError, which lists the names of that kind."""
        found = mujoco.mj_name2id(self.compiled, _OBJECTS[kind], name)
        if found < 0:
            raise unknown_name(kind, name, [n for n in self.names(kind) if n])
        return int(found)

    def scalar_joints(self) -> tuple[str, ...]:
        """Names of the hinge and slide joints, in the model's order."""
        kinds = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
        names = self.names("joint")
        return tuple(n for i, n in enumerate(names) if n and int(self.compiled.jnt_type[i]) in kinds)

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

    def is_position_servo(self, actuator: int) -> bool:
        """True where the actuator is a position servo: force = kp (command - position) - kv velocity."""
        model = self.compiled
        affine = int(model.actuator_biastype[actuator]) == int(mujoco.mjtBias.mjBIAS_AFFINE)
        gain, bias = model.actuator_gainprm[actuator, 0], model.actuator_biasprm[actuator, 1]
        return bool(affine and gain != 0 and np.isclose(gain, -bias))


def load(path: str | Path) -> Model:
    """Loads an MJCF or URDF file. Meshes that are missing, or name packages, are left out and said.

    Raises ModelError where the file does not exist or does not compile, with MuJoCo's reason.
    """
    file = Path(path)
    if not file.is_file():
        raise ModelError(f"model file '{file}' does not exist (looked in {file.absolute().parent})")
    tag = _root_tag(file)
    if tag not in ("mujoco", "robot"):
        raise ModelError(f"model file '{file}' starts with <{tag}>; expected <mujoco> (MJCF) or <robot> (URDF)")
    spec, notes = _urdf_spec(file) if tag == "robot" else _mjcf_spec(file)
    try:
        compiled = spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise ModelError(f"model '{file}' does not compile: {_one_line(error)}") from None
    return Model(file, spec, compiled, tuple(notes))


def prepared(
    model: Model, *, step: float, slack: Sequence[str] = (), limited: Sequence[str] = (), floor: bool = False
) -> mujoco.MjModel:
    """A compiled copy for simulation: visual geoms dropped, a joint for each backlash.

    `step` in s; `slack` joints get a second, free joint '<name>/slack'
    with a range of its own (MuJoCo's documented way to model backlash); `limited` actuators get a force range; `floor`
    adds a plane to a model without one.
    """
    spec = model.spec.copy()
    spec.option.timestep = step
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    _drop_visuals(spec, model.compiled)
    for name in slack:
        _add_slack(spec, name)
    if floor and plane_of(model.compiled) < 0:
        add_floor(spec)
    for name in limited:
        actuator = spec.actuator(name)
        if actuator.forcelimited != mujoco.mjtLimited.mjLIMITED_TRUE and not np.any(actuator.forcerange):
            actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
            actuator.forcerange = [-1e6, 1e6]
    return spec.compile()


def _add_slack(spec: mujoco.MjSpec, name: str) -> None:
    """Backlash as a free joint of small inertia between the driven joint and its link, with stiff ends."""
    joint = spec.joint(name)
    spring = joint.parent.add_joint()
    spring.name = f"{name}/slack"
    spring.type, spring.axis, spring.pos = joint.type, joint.axis, joint.pos
    spring.limited = mujoco.mjtLimited.mjLIMITED_TRUE
    spring.range = [-1e-6, 1e-6]
    # The gap is small and the ends are gear teeth: contact within two steps, nearly rigid.
    spring.solref_limit = [max(2.0 * spec.option.timestep, 0.004), 1.0]
    spring.solimp_limit = [0.99, 0.999, 1e-4, 0.5, 2.0]
    spring.damping = [0.005, 0.0, 0.0]
    spring.armature = 1e-4
    spring.frictionloss, spring.stiffness = 0.0, [0.0, 0.0, 0.0]


def _drop_visuals(spec: mujoco.MjSpec, compiled: mujoco.MjModel) -> None:
    """Removes geoms that touch nothing; the bodies keep the inertia that the full model gave them."""
    paired = {i for pair in zip(compiled.pair_geom1, compiled.pair_geom2, strict=True) for i in pair}
    visual = [
        g for g in spec.geoms if g.id >= 0 and g.id not in paired
        and compiled.geom_contype[g.id] == 0 and compiled.geom_conaffinity[g.id] == 0
    ]  # fmt: skip
    if not visual:
        return
    for body in spec.bodies[1:]:
        i = body.id
        body.explicitinertial = True
        body.mass = compiled.body_mass[i]
        body.ipos, body.iquat = compiled.body_ipos[i], compiled.body_iquat[i]
        body.inertia = compiled.body_inertia[i]
        body.fullinertia = np.full(6, np.nan)
    if spec.sensors or spec.tendons:
        # Sensors and tendon wraps may name a geom; dropping it would break them.
        return
    for geom in visual:
        spec.delete(geom)


def _mjcf_spec(file: Path) -> tuple[mujoco.MjSpec, list[str]]:
    try:
        spec = mujoco.MjSpec.from_file(str(file))
    except (ValueError, mujoco.FatalError) as error:
        raise ModelError(f"model '{file}' does not compile: {_one_line(error)}") from None
    folder = file.parent / (spec.meshdir or "")
    missing = [m for m in spec.meshes if m.file and not (folder / m.file).is_file() and not Path(m.file).is_file()]
    if not missing:
        return spec, []
    gone = {m.name or Path(m.file).stem for m in missing}
    geoms = [g for g in spec.geoms if g.meshname in gone]
    bodies = sorted({g.parent.name for g in geoms})
    for geom in geoms:
        spec.delete(geom)
    for mesh in missing:
        spec.delete(mesh)
    return spec, [_mesh_note(len(gone), bodies)]


def _urdf_spec(file: Path) -> tuple[mujoco.MjSpec, list[str]]:
    """A URDF through MuJoCo's reader, its mesh names resolved next to the file and above it, or left out."""
    tree = ElementTree.parse(file)
    root = tree.getroot()
    lost: set[str] = set()
    links: set[str] = set()
    for link in root.iter("link"):
        for part in [*link.findall("visual"), *link.findall("collision")]:
            for mesh in part.iter("mesh"):
                found = _resolve(mesh.get("filename", ""), file.parent)
                if found is None:
                    lost.add(mesh.get("filename", ""))
                    links.add(link.get("name", "?"))
                    link.remove(part)
                    break
                mesh.set("filename", str(found))
    extension = root.find("mujoco")
    if extension is None:
        extension = ElementTree.SubElement(root, "mujoco")
    compiler = extension.find("compiler")
    if compiler is None:
        compiler = ElementTree.SubElement(extension, "compiler")
    for key, value in {"strippath": "false", "fusestatic": "false", "discardvisual": "true"}.items():
        compiler.attrib.setdefault(key, value)
    massless = [k.get("name", "?") for k in root.iter("link") if k.find("inertial") is None]
    notes = [_mesh_note(len(lost), sorted(links))] if lost else []
    if massless and len(massless) < len(list(root.iter("link"))):
        notes.append(f"links without <inertial> carry no mass: {', '.join(massless)}")
    return _compilable(file, root, compiler, notes), notes


def _compilable(
    file: Path, root: ElementTree.Element, compiler: ElementTree.Element, notes: list[str]
) -> mujoco.MjSpec:
    """The spec; where moving links have no mass, MuJoCo's smallest is given to them and said."""
    try:
        spec = mujoco.MjSpec.from_string(ElementTree.tostring(root, encoding="unicode"))
        spec.compile()
        return spec
    except (ValueError, mujoco.FatalError) as error:
        if "mass and inertia of moving bodies" not in str(error):
            raise ModelError(f"model '{file}' does not compile: {_one_line(error)}") from None
    compiler.set("boundmass", "1e-4")
    compiler.set("boundinertia", "1e-7")
    notes.append("moving links without mass were given 0.1 g; forces there mean nothing until <inertial> is filled in")
    try:
        return mujoco.MjSpec.from_string(ElementTree.tostring(root, encoding="unicode"))
    except (ValueError, mujoco.FatalError) as error:
        raise ModelError(f"model '{file}' does not compile: {_one_line(error)}") from None


def _resolve(name: str, folder: Path) -> Path | None:
    """The mesh file that a URDF names: as written, or with its package looked for in the folders above."""
    plain = re.sub(r"^(package|file|model)://", "", name)
    if not plain.lower().endswith((".stl", ".obj", ".msh")):
        return None  # MuJoCo reads no other format
    choices = [folder / plain]
    for above in [folder, *folder.parents][:4]:
        choices += [above / plain, above / Path(*Path(plain).parts[1:])] if len(Path(plain).parts) > 1 else []
    return next((c.resolve() for c in choices if c.is_file()), None)


def _mesh_note(count: int, places: Iterable[str]) -> str:
    return (
        f"{count} meshes could not be found and were left out, at: {', '.join(places)}. This costs pictures and contacts "
        "there; a body whose inertia came from such a mesh needs an <inertial> of its own"
    )


def _root_tag(file: Path) -> str:
    try:
        for _, element in ElementTree.iterparse(file, events=("start",)):
            return element.tag
    except (ElementTree.ParseError, UnicodeDecodeError) as error:
        raise ModelError(f"model file '{file}' is not XML: {error}") from None
    return "nothing"


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
