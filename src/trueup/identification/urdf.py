# SPDX-License-Identifier: Apache-2.0
"""Reads the kinematic tree of a URDF, with its inertias and limits exactly as written; meshes are never opened."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from trueup.arrays import Array
from trueup.errors import ModelError
from trueup.identification.inertial import from_com, moved
from trueup.identification.kinematic_tree import KinematicTree, of_angles
from trueup.model_files.urdf import parsed, root_tag
from trueup.model_files.xml_text import XmlText
from trueup.units import GRAVITY

Element = ElementTree.Element

ROTOR, GEAR = "drake:rotor_inertia", "drake:gear_ratio"
"""Elements of an <actuator> in a <transmission>: the one place that URDF has for rotors, as Drake reads it."""
_MOVING = ("revolute", "continuous", "prismatic")


def is_urdf(path: str | Path) -> bool:
    """True where the file's first element is <robot>. Raises ModelError where there is no such file or it is not XML."""
    return root_tag(path) == "robot"


@dataclass
class _Chain:
    """Rows of the tree while it is walked; `mass` are the inertial parameters gathered for each joint's link."""

    joints: list[Element] = field(default_factory=list)
    links: list[str] = field(default_factory=list)
    parent: list[int] = field(default_factory=list)
    rotation: list[Array] = field(default_factory=list)
    offset: list[Array] = field(default_factory=list)
    mass: list[Array] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def tree_from_urdf(path: str | Path, *, fix_base: bool = False) -> KinematicTree:
    """The tree of a URDF; what fixed joints hold is merged, `mimic` joints move on their own and are noted.

    Raises ModelError for loops, several roots, joints of other types, and unless `fix_base` for a floating base.
    """
    file = Path(path)
    root = parsed(file)
    links = {k.get("name", ""): k for k in root.findall("link")}
    below: dict[str, list[Element]] = {}
    children = set()
    for joint in root.findall("joint"):
        above, child = _end(joint, "parent", links, file), _end(joint, "child", links, file)
        below.setdefault(above, []).append(joint)
        if child in children:
            raise ModelError(f"link '{child}' of '{file}' hangs on two joints; only trees can be identified")
        children.add(child)
    tops = [name for name in links if name not in children]
    if len(tops) != 1:
        what = ", ".join(tops) or (
            "its joints form a loop" if links else "it has no links: is it a xacro to be expanded?"
        )
        raise ModelError(f"'{file}' has {len(tops)} root links ({what}); expected one")
    chain = _Chain()
    _walk(chain, tops[0], -1, np.eye(3), np.zeros(3), links, below, fix_base)
    if not chain.joints:
        raise ModelError(f"'{file}' has no joint that moves")
    return _tree(chain, root.get("name", file.stem), _rotors(file))


def _walk(
    chain: _Chain, link: str, carrier: int, R: Array, p: Array, links: dict[str, Element],
    below: dict[str, list[Element]], fix_base: bool,
) -> None:  # fmt: skip
    """Adds a link at pose R, p in the frame of joint `carrier`'s link, then all that hangs on it, depth first."""
    if carrier >= 0 and (element := links[link].find("inertial")) is not None:
        own = moved(_inertial(element, link), R, p)
        chain.mass[carrier] = own if np.isnan(chain.mass[carrier]).any() else chain.mass[carrier] + own
    for joint in below.get(link, []):
        kind, child = joint.get("type", ""), joint.find("child")
        child_name = child.get("link", "") if child is not None else ""
        turn, shift = _pose(joint.find("origin"))
        R_child, p_child = R @ turn, p + R @ shift
        if kind == "fixed" or (kind == "floating" and fix_base):
            _walk(chain, child_name, carrier, R_child, p_child, links, below, fix_base)
        elif kind in _MOVING:
            chain.joints.append(joint)
            chain.links.append(child_name)
            chain.parent.append(carrier)
            chain.rotation.append(R_child)
            chain.offset.append(p_child)
            chain.mass.append(np.full(10, np.nan))
            if (mimic := joint.find("mimic")) is not None:
                chain.notes.append(
                    f"joint '{joint.get('name')}' mimics '{mimic.get('joint')}'; here it moves on its own"
                )
            _walk(chain, child_name, len(chain.joints) - 1, np.eye(3), np.zeros(3), links, below, fix_base)
        else:
            hint = "; a floating base can be welded with fix_base=True" if kind == "floating" else ""
            raise ModelError(
                f"joint '{joint.get('name')}' is {kind!r}; only {', '.join(_MOVING)}, fixed are known{hint}"
            )


def _tree(chain: _Chain, name: str, rotors: Mapping[str, float]) -> KinematicTree:
    limits = [j.find("limit") for j in chain.joints]
    bounded = [k if j.get("type") != "continuous" else None for j, k in zip(chain.joints, limits, strict=True)]
    unweighed = [k for k, mass in zip(chain.links, chain.mass, strict=True) if np.isnan(mass).any()]
    if unweighed:
        chain.notes.append(f"no <inertial> for {', '.join(unweighed)}")
    light = [k for k, mass in zip(chain.links, chain.mass, strict=True) if mass[0] == 0.0]
    if light:
        chain.notes.append(f"links whose mass is 0 in the file: {', '.join(light)}; fill in their <inertial>")
    if len(light) == len(chain.links):  # it weighs nothing at all
        chain.mass = [np.full(10, np.nan) for _ in light]
    return KinematicTree(
        name=name, joints=tuple(j.get("name", "") for j in chain.joints), links=tuple(chain.links),
        parent=np.array(chain.parent), prismatic=np.array([j.get("type") == "prismatic" for j in chain.joints]),
        axis=np.array([_axis(j) for j in chain.joints]), rotation=np.array(chain.rotation), offset=np.array(chain.offset),
        gravity=np.array([0.0, 0.0, -GRAVITY]), lower=_limits(bounded, "lower"), upper=_limits(bounded, "upper"),
        speed=_limits(limits, "velocity"), effort=_limits(limits, "effort"), inertial=np.array(chain.mass),
        armature=np.array([rotors.get(j.get("name", ""), 0.0) for j in chain.joints]),
        damping=_dynamics(chain.joints, "damping"), friction=_dynamics(chain.joints, "friction"), notes=tuple(chain.notes),
    )  # fmt: skip


def _end(joint: Element, which: str, links: dict[str, Element], file: Path) -> str:
    element = joint.find(which)
    name = element.get("link", "") if element is not None else ""
    if name not in links:
        raise ModelError(f"joint '{joint.get('name')}' of '{file}' has {which} link '{name}', which is not in the file")
    return name


def _dynamics(joints: list[Element], key: str) -> Array:
    """(n,) what <dynamics> says of each joint; zero without."""
    elements = [j.find("dynamics") for j in joints]
    return np.array([_number(e.get(key, "0")) if e is not None else 0.0 for e in elements])


def _rotors(path: Path) -> dict[str, float]:
    """Joint -> inertia of its rotor at the joint, kg m^2: <drake:rotor_inertia> and <drake:gear_ratio> of transmissions."""
    content = path.read_bytes()
    if b"rotor_inertia" not in content:
        return {}
    found = {}
    for transmission in XmlText(content).all("transmission"):
        joint, actuator = transmission.child("joint"), transmission.child("actuator")
        values = {e.tag: _number(e.attributes.get("value", "nan")) for e in (actuator.children if actuator else ())
                  if e.tag in (ROTOR, GEAR)}  # fmt: skip
        if joint is not None and ROTOR in values:
            found[joint.attributes.get("name", "")] = values[ROTOR] * values.get(GEAR, 1.0) ** 2
    return found


def _limits(elements: list[Element | None], key: str) -> Array:
    """(n,) one limit of each joint; 0 for speed or effort means that nobody filled it in."""
    values = np.array([_number(e.get(key, "nan")) if e is not None else np.nan for e in elements])
    return np.where(values == 0.0, np.nan, values) if key in ("velocity", "effort") else values


def _axis(joint: Element) -> Array:
    element = joint.find("axis")
    axis = _numbers(element.get("xyz", "1 0 0")) if element is not None else np.array([1.0, 0.0, 0.0])
    if not 0.0 < (length := float(np.linalg.norm(axis))) < np.inf:
        raise ModelError(f"joint '{joint.get('name')}' has axis {axis}, which has no direction")
    return axis / length


def _pose(origin: Element | None) -> tuple[Array, Array]:
    """Rotation and offset of an <origin>: fixed-axis roll, pitch, yaw."""
    if origin is None:
        return np.eye(3), np.zeros(3)
    return of_angles(*_numbers(origin.get("rpy", "0 0 0"))), _numbers(origin.get("xyz", "0 0 0"))


def _inertial(element: Element, link: str) -> Array:
    mass, inertia = element.find("mass"), element.find("inertia")
    if mass is None or inertia is None:
        raise ModelError(f"<inertial> of link '{link}' lacks {'<mass>' if mass is None else '<inertia>'}")
    R, p = _pose(element.find("origin"))
    xx, xy, xz, yy, yz, zz = (_number(inertia.get(k, "0")) for k in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
    full = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return from_com(_number(mass.get("value", "0")), p, R @ full @ R.T)


def _numbers(text: str) -> Array:
    """Three numbers, as an <origin> or <axis> has them. Raises ModelError."""
    values = np.array([_number(word) for word in text.split()])
    if len(values) != 3 or not np.isfinite(values).all():
        raise ModelError(f"'{text}' are not three numbers")
    return values


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        raise ModelError(f"'{word}' is not a number") from None
