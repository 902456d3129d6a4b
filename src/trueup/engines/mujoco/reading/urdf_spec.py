# SPDX-License-Identifier: Apache-2.0
"""A URDF made into a MuJoCo spec: meshes found or left out, masses and inertias such that it compiles."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import mujoco

from trueup.errors import ModelError, listed
from trueup.model_files.references import find_meshes, mesh_note, without_meshes
from trueup.model_files.urdf import Element, mend_inertias, parsed


def urdf_spec(file: Path) -> tuple[mujoco.MjSpec, list[str]]:
    """The spec of a URDF and what had to be changed or left out. Raises ModelError where it cannot be compiled.

    Mesh names are resolved next to the file and in the folders above it.
    """
    root = parsed(file)
    lost, links = find_meshes(root, file.parent)
    compiler = _compiler(root)
    massless = [k.get("name", "?") for k in root.iter("link") if k.find("inertial") is None]
    notes = [mesh_note(len(lost), sorted(links))] if lost else []
    if massless and len(massless) < len(list(root.iter("link"))):
        notes.append(f"links without <inertial> carry no mass: {', '.join(massless)}")
    notes += [*_led_by_nothing(root), *mend_inertias(root)]
    return _compilable(file, root, compiler, notes), notes


def _led_by_nothing(root: Element) -> list[str]:
    """A note on each joint that mimics one that the file does not have: MuJoCo leaves it alone without a word."""
    joints = [joint.get("name", "") for joint in root.iter("joint")]
    mimics = [(joint.get("name", ""), m.get("joint", "")) for joint in root.iter("joint") for m in joint.iter("mimic")]
    return [
        f"joint '{name}' mimics '{leader}', which is no joint of the file, and so moves on its own; joints are: "
        f"{listed(tuple(j for j in joints if j != name))}"
        for name, leader in mimics
        if leader not in joints
    ]


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
            places = without_meshes(root)
            notes.append(f"meshes cannot be used ({reason}): all were left out, at: {', '.join(places)}")
        else:
            raise ModelError(f"model '{file}' does not compile: {reason}")
