# SPDX-License-Identifier: Apache-2.0
"""A URDF made into a MuJoCo spec: meshes found or left out, masses and inertias such that it compiles."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable
from pathlib import Path

import mujoco

from trueup.engines.mujoco.reading.urdf_text import Element, mend_inertias, parsed
from trueup.errors import ModelError


def urdf_spec(file: Path) -> tuple[mujoco.MjSpec, list[str]]:
    """The spec of a URDF and what had to be changed or left out. Raises ModelError where it cannot be compiled.

    Mesh names are resolved next to the file and in the folders above it.
    """
    root = parsed(file)
    lost, links = _find_meshes(root, file.parent)
    compiler = _compiler(root)
    massless = [k.get("name", "?") for k in root.iter("link") if k.find("inertial") is None]
    notes = [mesh_note(len(lost), sorted(links))] if lost else []
    if massless and len(massless) < len(list(root.iter("link"))):
        notes.append(f"links without <inertial> carry no mass: {', '.join(massless)}")
    notes += mend_inertias(root)
    return _compilable(file, root, compiler, notes), notes


def mesh_note(count: int, places: Iterable[str]) -> str:
    """What it costs that meshes are missing."""
    return (
        f"{count} meshes could not be found and were left out, at: {', '.join(places)}. This costs pictures and contacts "
        "there; a body whose inertia came from such a mesh needs an <inertial> of its own"
    )


def _find_meshes(root: Element, folder: Path) -> tuple[set[str], set[str]]:
    """Makes mesh names absolute; returns those that are nowhere, which are taken out, and the links that had them."""
    lost: set[str] = set()
    links: set[str] = set()
    for link in root.iter("link"):
        for part in [*link.findall("visual"), *link.findall("collision")]:
            for mesh in part.iter("mesh"):
                found = _resolve(mesh.get("filename", ""), folder)
                if found is None:
                    lost.add(mesh.get("filename", ""))
                    links.add(link.get("name", "?"))
                    link.remove(part)
                    break
                mesh.set("filename", str(found))
    return lost, links


def _compiler(root: Element) -> Element:
    """The <compiler> of MuJoCo's extension, with what we need where the file does not say otherwise."""
    extension = root.find("mujoco")
    if extension is None:
        extension = ElementTree.SubElement(root, "mujoco")
    compiler = extension.find("compiler")
    if compiler is None:
        compiler = ElementTree.SubElement(extension, "compiler")
    for key, value in {"strippath": "false", "fusestatic": "false", "discardvisual": "true"}.items():
        compiler.attrib.setdefault(key, value)
    return compiler


def _compilable(file: Path, root: Element, compiler: Element, notes: list[str]) -> mujoco.MjSpec:
    """The spec, after the mending that MuJoCo's own complaints ask for; each is done once, and said."""
    done: set[str] = set()
    while True:
        try:
            spec = mujoco.MjSpec.from_string(ElementTree.tostring(root, encoding="unicode"))
            spec.compile()
            return spec
        except (ValueError, mujoco.FatalError) as error:
            reason = " ".join(str(error).split())
        if "mass and inertia of moving bodies" in reason and "mass" not in done:
            done.add("mass")
            compiler.set("boundmass", "1e-4")
            compiler.set("boundinertia", "1e-7")
            notes.append(
                "moving links without mass were given 0.1 g; forces there mean nothing until <inertial> is filled in"
            )
        elif "inertia must satisfy" in reason and "balance" not in done:
            done.add("balance")
            compiler.set("balanceinertia", "true")
            notes.append("inertias that no body can have were made possible (MuJoCo's balanceinertia)")
        elif re.search(r"mesh|stl|obj", reason, re.IGNORECASE) and "mesh" not in done:
            done.add("mesh")
            places = _without_meshes(root)
            notes.append(f"meshes cannot be used ({reason}): all were left out, at: {', '.join(places)}")
        else:
            raise ModelError(f"model '{file}' does not compile: {reason}")


def _without_meshes(root: Element) -> list[str]:
    places = []
    for link in root.iter("link"):
        for part in [*link.findall("visual"), *link.findall("collision")]:
            if part.find("geometry/mesh") is not None:
                link.remove(part)
                places.append(link.get("name", "?"))
    return list(dict.fromkeys(places))


def _resolve(name: str, folder: Path) -> Path | None:
    """The mesh file that a URDF names: as written, or with its package looked for in the folders above."""
    plain = re.sub(r"^(package|file|model)://", "", name)
    if not plain.lower().endswith((".stl", ".obj", ".msh")):
        return None  # MuJoCo reads no other format
    choices = [folder / plain]
    for above in [folder, *folder.parents][:4]:
        choices += [above / plain, above / Path(*Path(plain).parts[1:])] if len(Path(plain).parts) > 1 else []
    return next((c.resolve() for c in choices if c.is_file()), None)
