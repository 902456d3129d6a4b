# SPDX-License-Identifier: Apache-2.0
"""What model files refer to: meshes that are found or left out, and paths that resolve from another folder."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from pathlib import Path

from trueup.model_files.urdf import Element
from trueup.model_files.xml_text import XmlText


def mesh_note(count: int, places: Iterable[str]) -> str:
    """What it costs that meshes are missing."""
    return (
        f"{count} meshes could not be found and were left out, at: {', '.join(places)}. This costs pictures and contacts "
        "there; a body whose inertia came from such a mesh needs an <inertial> of its own"
    )


def find_meshes(root: Element, folder: Path) -> tuple[set[str], set[str]]:
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


def without_meshes(root: Element) -> list[str]:
    """Takes all parts with a mesh out; the links that had them, once each."""
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


def relocate(text: XmlText, old: Path, new: Path) -> None:
    """Makes references to files resolve from another folder."""
    if old.resolve() == new.resolve():
        return

    def moved(value: str) -> str:
        return value if Path(value).is_absolute() else Path(os.path.relpath(old / value, new)).as_posix()

    given: set[str] = set()
    for compiler in text.all("compiler"):
        for name in ("assetdir", "meshdir", "texturedir"):
            if name in compiler.attributes:
                text.change(compiler, **{name: moved(compiler.attributes[name])})
                given |= {"meshdir", "texturedir"} if name == "assetdir" else {name}
    for element in (*text.all("include"), *text.all("model")):
        if "file" in element.attributes:
            text.change(element, file=moved(element.attributes["file"]))
    needed = {"meshdir": ("mesh", "hfield", "skin", "flexcomp"), "texturedir": ("texture",)}
    for name, tags in needed.items():
        files = [e.attributes.get("file", "") for tag in tags for e in text.all(tag)]
        if name not in given and any(f and not Path(f).is_absolute() for f in files):
            text.set_last("compiler", name, moved("."))


def relocate_meshes(text: XmlText, old: Path, new: Path) -> None:
    """Makes mesh files given by relative paths resolve from another folder; packages are left alone."""
    for mesh in text.all("mesh"):
        name = mesh.attributes.get("filename", "")
        if name and "://" not in name and not Path(name).is_absolute() and old != new:
            text.change(mesh, filename=Path(os.path.relpath(old / name, new)).as_posix())
