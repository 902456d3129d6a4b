# SPDX-License-Identifier: Apache-2.0
"""An MJCF made into a spec that compiles: missing meshes and pictures left out, what has no name named."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco

from trueup.engines.mujoco.reading.urdf_spec import mesh_note
from trueup.errors import ModelError
from trueup.model_files.xml_text import Element, XmlText


def mjcf_spec(file: Path) -> tuple[mujoco.MjSpec, mujoco.MjModel, list[str]]:
    """The spec of an MJCF, what it compiles to, and what was changed or left out. Raises ModelError where it does not.

    Files that are missing are left out only where MuJoCo itself cannot find them: attached models have folders of
    their own.
    """
    notes: list[str] = []
    dropped: set[str] = set()
    bounded = False
    while True:
        spec = _read(file)
        try:
            if bounded:
                spec.compiler.boundmass, spec.compiler.boundinertia = 1e-4, 1e-7
            places = _without(spec, dropped)
            said = name_all(spec)
            compiled = spec.compile()
        except (ValueError, mujoco.FatalError) as error:
            reason = " ".join(str(error).split())
        else:
            meshes = [f for f in dropped if not _picture(f)]
            notes += [mesh_note(len(meshes), places)] if meshes else []
            return spec, compiled, [*notes, *said]
        more = _missing(spec, file.parent, reason) - dropped if "Error opening file" in reason else set()
        if more:
            dropped |= more
        elif "mass and inertia of moving bodies" in reason and not bounded:
            bounded = True
            notes.append("moving bodies without mass were given 0.1 g; forces there mean nothing until they have one")
        else:
            raise ModelError(f"model '{file}' does not compile: {reason}")


def _read(file: Path) -> mujoco.MjSpec:
    try:
        return mujoco.MjSpec.from_file(str(file))
    except (ValueError, mujoco.FatalError) as error:
        raise ModelError(f"model '{file}' does not compile: {' '.join(str(error).split())}") from None


def name_all(spec: mujoco.MjSpec) -> list[str]:
    """Gives joints and actuators without a name one, so that recordings and results can speak of them; says which.

    A joint is called after its body, an actuator after what it drives.
    """
    taken = {j.name for j in spec.joints}
    given = []
    for joint in spec.joints:
        if not joint.name and joint.type != mujoco.mjtJoint.mjJNT_FREE:
            joint.name = _free(f"{joint.parent.name or 'body'}_joint", taken)
            given.append(joint.name)
    taken = {a.name for a in spec.actuators}
    for actuator in spec.actuators:
        if not actuator.name:
            actuator.name = _free(actuator.target or "actuator", taken)
    return [f"joints without a name are called after their bodies: {', '.join(given)}"] if given else []


def _free(name: str, taken: set[str]) -> str:
    choice, n = name, 1
    while choice in taken:
        n += 1
        choice = f"{name}_{n}"
    taken.add(choice)
    return choice


def _missing(spec: mujoco.MjSpec, folder: Path, reason: str) -> set[str]:
    """Files that cannot be opened: the one that MuJoCo names, and those missing by the same folder as it."""
    match = re.search(r"Error opening file '([^']*)'", reason)
    named = match[1] if match else ""
    files = {m.file for m in spec.meshes if m.file}
    files |= {f for t in spec.textures for f in (t.file, *t.cubefiles) if f}
    one = {f for f in files if named and named.replace("\\", "/").endswith(f.replace("\\", "/"))}
    gone = set()
    for file in files:
        base = folder / ((spec.texturedir if _picture(file) else spec.meshdir) or "")
        if not (base / file).is_file() and not Path(file).is_file():
            gone.add(file)
    return gone if one <= gone else one


def _picture(file: str) -> bool:
    return file.lower().endswith((".png", ".ktx", ".jpg", ".jpeg"))


def _without(spec: mujoco.MjSpec, files: set[str]) -> list[str]:
    """Takes meshes and textures out of a spec; the bodies that lost a mesh."""
    textures = [t for t in spec.textures if {t.file, *t.cubefiles} & files]
    gone = {t.name for t in textures}
    for material in spec.materials:
        used = list(material.textures)
        if gone & set(used):
            material.textures = ["" if t in gone else t for t in used]
    for texture in textures:
        spec.delete(texture)
    meshes = [m for m in spec.meshes if m.file in files]
    lost = {m.name or Path(m.file).stem for m in meshes}
    geoms = [g for g in spec.geoms if g.meshname in lost]
    places = sorted({g.parent.name for g in geoms})
    for geom in geoms:
        spec.delete(geom)
    for mesh in meshes:
        spec.delete(mesh)
    return places


def name_in_text(text: XmlText, spec: mujoco.MjSpec) -> None:
    """Writes the names that `name_all` gave into the text too, where it holds all elements in the same order."""
    actuators = [e for part in text.root.children if part.tag == "actuator" for e in part.children]
    joints = [e for part in text.root.children if part.tag == "worldbody" for e in _joints(part)]
    for elements, things in ((actuators, spec.actuators), (joints, spec.joints)):
        if len(elements) == len(things):
            for element, thing in zip(elements, things, strict=True):
                if thing.name and "name" not in element.attributes:
                    element.attributes["name"] = thing.name
                    text.change(element, name=thing.name)


def _joints(element: Element) -> list[Element]:
    """Joints as MuJoCo orders them: a body's own before those of the bodies below it."""
    own = [c for c in element.children if c.tag in ("joint", "freejoint")]
    inside = [e for c in element.children if c.tag in ("body", "frame") for e in _joints(c)]
    return own + inside
