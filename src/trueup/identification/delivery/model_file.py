# SPDX-License-Identifier: Apache-2.0
"""Writes bodies, friction and rotors into the URDF or MJCF they came from, and reads them back; comments and meshes stay."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING
from xml.sax.saxutils import quoteattr

import numpy as np

from trueup.arrays import Array
from trueup.errors import ModelError
from trueup.formats.aside import write_aside
from trueup.identification.estimation.file_fit import FileFit
from trueup.identification.inertial import NAMES, about_com, from_com, moved, pseudo_inertia, tensor
from trueup.identification.kinematic_tree import KinematicTree, of_angles
from trueup.identification.model_file import load_tree
from trueup.identification.urdf import GEAR, ROTOR, is_urdf
from trueup.model_files.references import relocate_meshes
from trueup.model_files.xml_text import Element, XmlText, tag
from trueup.rounding import NEGLIGIBLE, ROUNDED
from trueup.units import EARTH

if TYPE_CHECKING:
    import mujoco


_TENSOR = tuple(name.casefold() for name in NAMES if name.startswith("I"))
"""Attributes of <inertia>, in the order of the ten numbers."""


def write_model_file(
    fit: FileFit | None, tree: KinematicTree, model: str | Path, target: str | Path
) -> tuple[str, ...]:
    """Writes `model` with these bodies, damping, friction and rotor inertias to `target`.

    `tree` is the one that was identified, with its joints locked. Only the numbers change; beside a URDF goes an SRDF with
    the rotors, as Pinocchio reads them. Returns notes. Raises ModelError where there are no possible bodies to write, and
    OutputError.
    """
    if fit is None:
        raise ModelError("bodies that cannot exist are not written: identify with physically consistent links")
    source, path = Path(model), Path(target)
    write = _write_urdf if is_urdf(source) else _write_mjcf
    return (*write(fit, tree, source, path), *_lacking(fit, tree, urdf=is_urdf(source)), *_mounted(tree, path))


def _lacking(fit: FileFit, tree: KinematicTree, *, urdf: bool) -> list[str]:
    """What to say of springs that a file has no place for: a URDF has none, MJCF one for those of torsion."""
    kind = "URDF" if urdf else "MJCF"
    return [
        f"{kind} has no place for the spring of {joint}: its bodies weigh what they weigh, and torque there lacks {said}"
        for joint, said, held in zip(tree.joints, fit.springs, fit.stiffness, strict=True)
        if said and (urdf or not held)
    ]


def _mounted(tree: KinematicTree, path: Path) -> tuple[str, ...]:
    """What to say where a file that was written stands otherwise than the arm that was identified."""
    if np.allclose(own := load_tree(path).gravity, tree.gravity, rtol=0.0, atol=EARTH[1] - EARTH[0]):
        return ()
    there, here = (" ".join(f"{round(float(g), 3) + 0.0:g}" for g in each) for each in (tree.gravity, own))
    said = (
        f"its bodies were identified with gravity {there}, and it is read with {here}: turn the base, or gravity, there"
    )
    return (said,)


def read_back(path: str | Path, tree: KinematicTree) -> KinematicTree:
    """The tree of a file that was written, locked and mounted as `tree` is."""
    again = load_tree(path)
    return again.lock([j for j in again.joints if j not in tree.joints]).replace(gravity=tree.gravity)


def _write_urdf(fit: FileFit, tree: KinematicTree, source: Path, path: Path) -> tuple[str, ...]:
    text = XmlText(source.read_bytes())
    links = {e.attributes.get("name", ""): e for e in text.root.children if e.tag == "link"}
    joints = {e.attributes.get("name", ""): e for e in text.root.children if e.tag == "joint"}
    notes: list[str] = []
    for j, name in enumerate(tree.links):
        element = links[name]
        file = np.nan_to_num(tree.inertial[j])
        attached = file - _inertial(element)
        own, share = _without(fit.inertial[j], attached)
        if share < 1.0:
            notes.append(_lightened(f"link '{name}'", _lighten(text, name, share, tree, joints, links), share))
        _set_inertial(text, element, own)
    for j, name in enumerate(tree.joints):
        coulomb, viscous = f"{fit.friction[j]:.9g}", f"{fit.damping[j]:.9g}"
        dynamics = joints[name].child("dynamics")
        if dynamics is None:
            text.insert_first(joints[name], f'<dynamics damping="{viscous}" friction="{coulomb}"/>')
        else:
            text.change(dynamics, damping=viscous, friction=coulomb)
        _set_rotor(text, joints[name], float(fit.armature[j]))
    notes.append(
        f"rotors stand in <transmission> (as Drake reads them) and in {path.with_suffix('.srdf').name} (as Pinocchio does, "
        "loadRotorParameters); in simulators that read neither set each joint's armature: "
        + ", ".join(f"{joint} {fit.armature[j]:.3g}" for j, joint in enumerate(tree.joints))
    )
    relocate_meshes(text, source.absolute().parent, path.absolute().parent)
    write_aside(text.render(), path)
    _write_srdf(fit, tree, text.root.attributes.get("name", tree.name), path.with_suffix(".srdf"))
    return tuple(notes)


def _set_rotor(text: XmlText, joint: Element, inertia: float) -> None:
    """Writes a rotor's inertia at the joint to the transmission of the joint, which is made where there is none."""
    name, value = joint.attributes.get("name", ""), f"{inertia:.9g}"
    text.change(text.root, **{"xmlns:drake": "http://drake.mit.edu"})
    for transmission in text.all("transmission"):
        of, actuator = transmission.child("joint"), transmission.child("actuator")
        if of is None or of.attributes.get("name") != name or actuator is None or actuator.stop == actuator.end:
            continue
        for part, new in ((GEAR, "1"), (ROTOR, value)):
            if (element := actuator.child(part)) is not None:
                text.change(element, value=new)
            elif part == ROTOR:
                text.insert_first(actuator, tag(ROTOR, {"value": value}))
        return
    own = quoteattr(name)
    text.insert_after(
        joint,
        f"<transmission name={quoteattr(name + '_transmission')}><type>transmission_interface/SimpleTransmission</type>"
        f"<joint name={own}><hardwareInterface>hardware_interface/EffortJointInterface</hardwareInterface></joint>"
        f'<actuator name={quoteattr(name + "_motor")}><{ROTOR} value="{value}"/></actuator></transmission>',
    )


def _write_srdf(fit: FileFit, tree: KinematicTree, name: str, path: Path) -> None:
    """The rotors as Pinocchio reads them: their inertia at the joint, geared one to one."""
    lines = [f'    <joint name={quoteattr(joint)} mass="{fit.armature[j]:.9g}" gear_ratio="1"/>'
             for j, joint in enumerate(tree.joints)]  # fmt: skip
    text = "\n".join(
        [f"<robot name={quoteattr(name)}>", "  <rotor_params>", *lines, "  </rotor_params>", "</robot>", ""]
    )
    write_aside(text, path)


def _write_mjcf(fit: FileFit, tree: KinematicTree, source: Path, path: Path) -> tuple[str, ...]:
    from trueup.engines.mujoco.inertia import body_inertia
    from trueup.engines.mujoco.model import load
    from trueup.engines.mujoco.writing.bodies import Body, JointDrive, write_bodies

    model = load(source)
    notes, bodies = [], {}
    for j, (joint, name) in enumerate(zip(tree.joints, tree.links, strict=True)):
        compiled, at = model.compiled, model.index("body", name)
        if name in tree.links[j + 1 :]:
            notes.append(f"body '{name}' has several joints: its inertia is written for the last one alone")
            continue
        anchor = np.array(compiled.jnt_pos[model.index("joint", joint)])
        file = from_com(float(compiled.body_mass[at]), np.array(compiled.body_ipos[at]), body_inertia(compiled, at))
        here = moved(np.stack([fit.inertial[j], np.nan_to_num(tree.inertial[j])]), np.eye(3), anchor)
        own, share = _without(here[0], here[1] - file)
        bodies[name] = Body(*about_com(own))
        if share < 1.0:
            hanging = _hanging(compiled, at, {model.index("body", link) for link in tree.links})
            for b in hanging:
                mass, com = share * float(compiled.body_mass[b]), np.array(compiled.body_ipos[b])
                bodies[compiled.body(b).name] = Body(mass, com, share * body_inertia(compiled, b))
            notes.append(_lightened(f"body '{name}'", [compiled.body(b).name for b in hanging], share))
    joints = {
        name: JointDrive(*(float(x[j]) for x in (fit.damping, fit.friction, fit.armature, fit.stiffness, fit.slack)))
        for j, name in enumerate(tree.joints)
    }
    return (*notes, *write_bodies(model, bodies, joints, path))


def _hanging(compiled: mujoco.MjModel, at: int, links: set[int]) -> list[int]:
    """Bodies with mass that hang on body `at` by joints that were not identified, or none."""
    found, above = list[int](), {at}
    for b in range(at + 1, compiled.nbody):  # parents come before children
        if int(compiled.body_parentid[b]) in above and b not in links:
            above.add(b)
            found += [b] if compiled.body_mass[b] > 0.0 else []
    return found


def _lightened(where: str, below: list[str], share: float) -> str:
    return (
        f"{where}: less was identified than the file hangs on it ({', '.join(below)}), so that those have {share:.2g} "
        "times their mass now; the sum is what was identified"
    )


def _without(total: Array, attached: Array) -> tuple[Array, float]:
    """(10,) a body less what hangs on it in the file, and the share of that which hangs on it still.

    The whole, where that leaves a body that can exist; else half of the most that does.
    """
    own = total - attached
    size = max(float(np.abs(pseudo_inertia(total)).max()), NEGLIGIBLE)
    if not np.abs(attached).max() > NEGLIGIBLE * size:
        return total, 1.0
    if np.linalg.eigvalsh(pseudo_inertia(own))[0] > ROUNDED * size:
        return own, 1.0
    root = np.linalg.inv(np.linalg.cholesky(pseudo_inertia(total)))
    most = 1.0 / float(np.linalg.eigvalsh(root @ pseudo_inertia(attached) @ root.T)[-1])
    share = 0.5 * min(most, 1.0)
    return total - share * attached, share


def _inertial(link: Element) -> Array:
    """(10,) what a link's own <inertial> says, in the link's frame; zero without one."""
    element = link.child("inertial")
    if element is None:
        return np.zeros(10)
    origin, mass, inertia = (element.child(tag) for tag in ("origin", "mass", "inertia"))
    if mass is None or inertia is None:
        return np.zeros(10)
    numbers = {key: origin.attributes.get(key, "0 0 0") if origin else "0 0 0" for key in ("xyz", "rpy")}
    com, angles = (np.array([float(w) for w in numbers[key].split()]) for key in ("xyz", "rpy"))
    turn = of_angles(*angles)
    moments = np.array([0.0] * 4 + [float(inertia.attributes.get(key, "0")) for key in _TENSOR])
    return from_com(float(mass.attributes.get("value", "0")), com, turn @ tensor(moments) @ turn.T)


def _set_inertial(text: XmlText, link: Element, inertial: Array) -> None:
    mass, com, inertia = about_com(inertial)
    moments = from_com(0.0, np.zeros(3), inertia)[-len(_TENSOR) :]
    values = {key: f"{value:.9g}" for key, value in zip(_TENSOR, moments, strict=True)}
    xyz = " ".join(f"{c:.9g}" for c in com)
    element = link.child("inertial")
    parts = {part: element.child(part) if element else None for part in ("origin", "mass", "inertia")}
    if element is None or parts["mass"] is None or parts["inertia"] is None:
        children = (
            tag("origin", {"xyz": xyz, "rpy": "0 0 0"}),
            tag("mass", {"value": f"{mass:.9g}"}),
            tag("inertia", values),
        )
        text.insert_first(link, f"<inertial>{''.join(children)}</inertial>")
        return
    text.change(parts["mass"], value=f"{mass:.9g}")
    text.change(parts["inertia"], **values)
    if parts["origin"] is None:
        text.insert_first(element, tag("origin", {"xyz": xyz, "rpy": "0 0 0"}))
    else:
        text.change(parts["origin"], xyz=xyz, rpy="0 0 0")


def _lighten(
    text: XmlText, link: str, share: float, tree: KinematicTree, joints: dict[str, Element], links: dict[str, Element]
) -> list[str]:  # fmt: skip
    """Leaves a share of the mass of all links that hang on `link` by joints that were not identified; returns their names."""
    lighter = []
    for name, joint in joints.items():
        above, below = joint.child("parent"), joint.child("child")
        if name in tree.joints or above is None or below is None or above.attributes.get("link") != link:
            continue
        child = below.attributes.get("link", "")
        element = links[child].child("inertial")
        mass, inertia = (element.child(tag) if element else None for tag in ("mass", "inertia"))
        if mass is not None and inertia is not None:
            text.change(mass, value=f"{share * float(mass.attributes.get('value', '0')):.9g}")
            left = {key: f"{share * float(inertia.attributes.get(key, '0')):.9g}" for key in _TENSOR}
            text.change(inertia, **left)
            lighter.append(child)
        lighter += _lighten(text, child, share, tree, joints, links)
    return lighter
