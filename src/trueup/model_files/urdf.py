# SPDX-License-Identifier: Apache-2.0
"""Reads model files as people write them: prefixes that nobody declared, inertias that no body can have."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from xml.parsers import expat

import numpy as np

from trueup import files
from trueup.arrays import Array
from trueup.errors import ModelError, listed
from trueup.rounding import NEGLIGIBLE, ROUNDED

Element = ElementTree.Element

_PREFIX = re.compile(rb"<([A-Za-z_][\w.-]*):|\s([A-Za-z_][\w.-]*):[\w.-]+\s*=")
_BROKEN = (ElementTree.ParseError, UnicodeDecodeError, ValueError, LookupError)
DENSITY = 2000.0
"""kg/m^3 of a link as a whole: aluminium castings with motors in them."""
_THIN = 1e-3  # least principal moment of inertia, as a share of the largest: a needle


def parsed(path: str | Path) -> Element:
    """The root of a URDF, without what other programs have added under a prefix of their own (`drake:acceleration`).

    Raises ModelError where the file is no XML.
    """
    content = files.content(Path(path), ModelError)
    try:
        root = _root(content)
    except _BROKEN as error:
        try:
            root = _root(_declared(content))
        except _BROKEN:
            raise ModelError(f"model file '{path}' is not XML: {error}") from None
    for element in root.iter():
        for child in [c for c in element if isinstance(c.tag, str) and c.tag.startswith("{")]:
            element.remove(child)
        for name in [a for a in element.attrib if a.startswith("{")]:
            del element.attrib[name]
    return root


def _root(content: bytes) -> Element:
    return ElementTree.fromstring(content)


def _declared(content: bytes) -> bytes:
    """The same file with all prefixes declared at the root: many programs write them without."""
    used = {name for found in _PREFIX.findall(content) for name in found if name and not name.startswith(b"xml")}
    spaces = b"".join(b' xmlns:%s="%s"' % (name, name) for name in sorted(used) if b"xmlns:" + name not in content)
    return re.sub(rb"(<robot)\b", rb"\1" + spaces, content, count=1)


def root_tag(path: str | Path) -> str:
    """The name of a file's outermost element, "nothing" where there is none.

    Raises ModelError for what is no XML, or what a model is yet to be made of (xacro).
    """
    found: list[str] = []
    unmade: list[str] = []
    content = files.content(Path(path), ModelError)

    def opened(tag: str, attributes: dict[str, str]) -> None:
        found.append(tag)
        if tag.startswith("xacro:") or any("${" in value for value in attributes.values()):
            unmade.append(tag)

    parser = expat.ParserCreate()
    parser.StartElementHandler = opened
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        is_usd = content.startswith((b"#usda", b"PXR-USDC", b"PK"))
        how = "; USD is not read: the tool that made it exports URDF or MJCF, too" if is_usd else ""
        raise ModelError(f"model file '{path}' is not XML: {error}{how}") from None
    if found[:1] == ["robot"] and unmade:
        raise ModelError(
            f"model file '{path}' is xacro (<{unmade[0]}>), from which a URDF is made: `xacro {Path(path).name} > "
            "robot.urdf` (of ROS, or `pip install xacro`), then give robot.urdf"
        )
    return found[0] if found else "nothing"


def mend_inertias(root: Element) -> list[str]:
    """Makes every <inertial> one that a body can have, and says which were not.

    No <inertia>: a ball of `DENSITY`. Moments below zero, or one larger than the other two together: the nearest that are
    possible. Masses stay as they are.
    """
    without, impossible = [], []
    for link in root.iter("link"):
        inertial = link.find("inertial")
        mass = _mass(inertial) if inertial is not None else 0.0
        if inertial is None or mass <= 0.0:
            continue
        written = inertial.find("inertia")
        tensor = _tensor(written) if written is not None else np.zeros((3, 3))
        if written is None or np.abs(tensor).max() < NEGLIGIBLE:
            written = ElementTree.SubElement(inertial, "inertia") if written is None else written
            radius = (3.0 * mass / (4.0 * math.pi * DENSITY)) ** (1.0 / 3.0)
            # A frame that somebody gave a mass of a microgram still turns.
            _write(written, max(0.4 * mass * radius**2, ROUNDED) * np.eye(3))
            without.append(link.get("name", "?"))
            continue
        possible = _possible(tensor)
        if not np.allclose(tensor, possible, rtol=ROUNDED, atol=0.0):
            _write(written, possible)
            impossible.append(link.get("name", "?"))
    notes = []
    if without:
        notes.append(
            f"links with a mass but no <inertia> were taken for balls as dense as links are: {listed(without)}"
        )
    if impossible:
        notes.append(f"no body can have the inertia of {listed(impossible)}: the nearest that can be is simulated")
    return notes


def _possible(tensor: Array) -> Array:
    """The inertia with the same axes whose moments are above zero and none larger than the others together."""
    moments, axes = np.linalg.eigh(tensor)
    least = _THIN * max(float(np.abs(moments).max()), ROUNDED)
    moments = np.where(moments < NEGLIGIBLE * np.abs(moments).max(), least, moments)
    if moments[2] > moments[0] + moments[1]:
        # The largest moment is the one that is measured best: the others grow, alike.
        moments[:2] *= 1.001 * moments[2] / (moments[0] + moments[1])
    elif np.allclose(moments, np.linalg.eigvalsh(tensor), rtol=NEGLIGIBLE, atol=0.0):
        return tensor
    return (axes * moments) @ axes.T


def _mass(inertial: Element) -> float:
    element = inertial.find("mass")
    try:
        return float(element.get("value", "0")) if element is not None else 0.0
    except ValueError:
        return 0.0


def _tensor(element: Element) -> Array:
    """(3, 3); zero where it is no numbers, which MuJoCo then says in its own words."""
    try:
        xx, xy, xz, yy, yz, zz = (float(element.get(k, "0")) for k in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
    except ValueError:
        return np.zeros((3, 3))
    return np.nan_to_num(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))


def _write(element: Element, tensor: Array) -> None:
    for i, row in enumerate("xyz"):
        for j, column in enumerate("xyz"):
            if i <= j:
                element.set(f"i{row}{column}", repr(float(tensor[i, j])))
