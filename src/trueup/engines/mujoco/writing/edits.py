# SPDX-License-Identifier: Apache-2.0
"""Where an MJCF says what each attribute has become: edits of the text, and what to compare afterwards."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import mujoco
import numpy as np

from trueup.arrays import Array
from trueup.articulated.kernels import ONSET
from trueup.articulated.wiring import ONSET_OF
from trueup.engines.mujoco.attributes import OBJECTS
from trueup.engines.mujoco.floor_plane import plane_of
from trueup.engines.mujoco.gears import SECOND
from trueup.engines.mujoco.inertia import body_inertia
from trueup.engines.mujoco.model import SETTING, Model
from trueup.errors import ModelError
from trueup.model_files.xml_text import Element, XmlText, number, numbers, tag
from trueup.rounding import NEGLIGIBLE, ROUNDED

_ROTATIONS = ("quat", "axisangle", "euler", "xyaxes", "zaxis")
_TAGS = {"joint": ("joint", "hinge"), "actuator": (), "body": ("body",), "geom": ("geom",)}


class Edits:
    """Writes what `wanted` (the model as simulated) says into a text of `shipped`, `printed` by MuJoCo if to six digits."""

    def __init__(
        self, text: XmlText, shipped: Model, wanted: mujoco.MjModel, *, degrees: bool, printed: bool = False
    ) -> None:
        self._text, self._shipped, self._wanted = text, shipped.compiled, wanted
        self._degrees, self._autolimits = degrees, bool(shipped.spec.compiler.autolimits)
        self._digits = ".6g" if printed else ".17g"
        self._done: set[tuple[object, str]] = set()

    def write(self, attribute: str, target: str) -> None:
        """What MJCF calls one attribute of one element. Raises ModelError where this text does not hold it."""
        writer = _WRITERS.get(attribute)
        if writer is not None and (writer, target) not in self._done:
            self._done.add((writer, target))
            writer(self, target)

    def delay(self, actuator: str, seconds: float, step: float) -> None:
        """A delay of the command, linear between steps, which is exact for commands held over a step."""
        element = self._element("actuator", actuator)
        samples = math.ceil(seconds / step) + 2 if seconds > 0.0 else 0
        self._text.change(element, nsample=str(samples), interp="linear", delay=number(seconds))

    def onset(self, actuator: str, force: float) -> None:
        """A second actuator that takes the same command: a spring so steep that it is at its limit, `force`, within ONSET."""
        m, i, main = self._wanted, self._id("actuator", actuator), self._element("actuator", actuator)
        steep, zero = force / ONSET, m.actuator_biasprm[i, 0] / m.actuator_gainprm[i, 0]
        joint = m.joint(int(m.actuator_trnid[i, 0])).name
        inside = (
            f'name="{actuator}{ONSET_OF}" joint="{joint}" gear="{number(m.actuator_gear[i, 0])}" dyntype="none" '
            f'gaintype="fixed" biastype="affine" gainprm="{number(steep)} 0 0" '
            f'biasprm="{numbers([steep * zero, -steep, 0.0])}" forcelimited="true" forcerange="{numbers([-force, force])}"'
        )
        if m.actuator_ctrllimited[i]:
            inside += f' ctrllimited="true" ctrlrange="{numbers(m.actuator_ctrlrange[i])}"'
        inside += "".join(f' {k}="{v}"' for k in ("nsample", "interp", "delay") if (v := main.changes.get(k)))
        last = [e for e in self._text.root.children if e.tag == "actuator"][-1].children[-1]
        self._text.insert_after(last, f"<general {inside}/>")
        for key in self._text.all("key"):
            if given := str(key.changes.get("ctrl") or key.attributes.get("ctrl", "")):
                self._text.change(key, ctrl=f"{given} {given.split()[int(m.actuator_ctrladr[i])]}")

    def gravity(self) -> None:
        """The direction of gravity."""
        if not np.allclose(self._wanted.opt.gravity, self._shipped.opt.gravity, rtol=NEGLIGIBLE, atol=0.0):
            self._text.set_last("option", "gravity", numbers(self._wanted.opt.gravity))

    def weightless(self) -> None:
        """Bodies whose weight something else holds; the text has them in the model's order, with names or without."""
        changed = np.flatnonzero(np.abs(self._wanted.body_gravcomp - self._shipped.body_gravcomp) > NEGLIGIBLE)
        bodies = self._text.all("body")
        if len(changed) and len(bodies) != self._shipped.nbody - 1:
            raise ModelError("its bodies are not all written out, so that none can be told to be without weight")
        for i in changed:
            self._text.change(bodies[i - 1], gravcomp=number(self._wanted.body_gravcomp[i]))

    def gains(self, given_for: Mapping[str, float]) -> None:
        """For which setting of its servos the file holds, where recordings name several."""
        for quantity, value in given_for.items():
            name = f"{SETTING}{quantity}"
            there = [e for e in self._text.all("numeric") if e.attributes.get("name") == name]
            if there:
                self._text.change(there[-1], data=number(value))
            else:
                numeric = f'<numeric name="{name}" data="{number(value)}"/>'
                self._text.insert_first(self._text.root, f"<custom>{numeric}</custom>")

    def kp(self, actuator: str) -> None:
        """Gain and bias of an actuator, by the attributes that its tag has."""
        if self._same("actuator", actuator, "actuator_gainprm", "actuator_biasprm"):
            return
        element, i = self._element("actuator", actuator), self._id("actuator", actuator)
        gain, bias = self._wanted.actuator_gainprm[i], self._wanted.actuator_biasprm[i]
        if element.tag == "position" and bias[0]:
            # <position> has no constant term; <general> is the same servo with one.
            if {"inheritrange", "timeconst"} & set(element.attributes):
                raise ModelError(f"'{actuator}' has attributes that only <position> knows")
            element.renamed = "general"
            self._text.change(
                element, kp=None, kv=None, dampratio=None, biastype="affine", gainprm=number(gain[0]),
                biasprm=numbers(bias[:3]),
            )  # fmt: skip
        elif element.tag == "position":
            self._text.change(element, kp=number(gain[0]))
            damped = not np.isclose(bias[2], self._shipped.actuator_biasprm[i, 2], rtol=ROUNDED, atol=1e-15)
            if damped or "dampratio" in element.attributes:
                # The ratio that the file gave is no longer the one that was found.
                self._text.change(element, kv=number(-bias[2]), dampratio=None)
        elif element.tag == "velocity":
            self._text.change(element, kv=number(gain[0]))
        elif element.tag == "general" or (element.tag == "motor" and not np.any(bias)):
            element.renamed = "general" if element.tag == "motor" else ""
            self._text.change(element, gainprm=numbers(gain[:3]))
            if np.any(bias):
                self._text.change(element, biasprm=numbers(bias[:3]))
        else:
            raise ModelError(f"<{element.tag}> has no attribute for the gain of '{actuator}'")

    def force_limit(self, actuator: str) -> None:
        """The force range, the same on both sides."""
        if self._same("actuator", actuator, "actuator_forcerange"):
            return
        element, i = self._element("actuator", actuator), self._id("actuator", actuator)
        self._text.change(element, forcerange=numbers(self._wanted.actuator_forcerange[i]))
        if not self._shipped.actuator_forcelimited[i] and not self._autolimits:
            self._text.change(element, forcelimited="true")

    def damping(self, joint: str) -> None:
        """Viscous damping, with its quadratic part where there is one."""
        if self._same("joint", joint, "dof_damping", "dof_dampingpoly"):
            return
        bent, before = (read(m, "joint", joint, "dof_dampingpoly") for m in (self._wanted, self._shipped))
        values = [*read(self._wanted, "joint", joint, "dof_damping"), *(bent if np.any((bent, before)) else ())]
        self._text.change(self._element("joint", joint), damping=numbers(values))

    def spring(self, joint: str) -> None:
        """The stiffness of a joint's spring, with its bent part where there is one, and where it rests."""
        if self._same("joint", joint, "jnt_stiffness", "jnt_stiffnesspoly", "qpos_spring"):
            return
        element, j = self._element("joint", joint), self._id("joint", joint)
        bent = self._wanted.jnt_stiffnesspoly[j]
        stiffness = [self._wanted.jnt_stiffness[j], *(bent if np.any(bent) else ())]
        rest = read(self._wanted, "joint", joint, "qpos_spring")
        self._text.change(element, stiffness=numbers(stiffness), springref=numbers(self._as_written(j, rest)))

    def creep(self, joint: str) -> None:
        """How firmly friction holds."""
        if not self._same("joint", joint, "dof_solimp"):
            value = read(self._wanted, "joint", joint, "dof_solimp")
            self._text.change(self._element("joint", joint), solimpfriction=numbers(value))

    def stops(self, joint: str) -> None:
        """The range between hard stops."""
        if self._same("joint", joint, "jnt_range"):
            return
        element, j = self._element("joint", joint), self._id("joint", joint)
        self._text.change(element, range=numbers(self._as_written(j, self._wanted.jnt_range[j])))
        if not self._shipped.jnt_limited[self._shipped.joint(joint).id] and not self._autolimits:
            self._text.change(element, limited="true")

    def second(self, joint: str, name: str) -> None:
        """A second joint between the drive and the link, as it was simulated."""
        m = self._wanted
        element, j = self._element("joint", joint), mujoco.mj_name2id(m, mujoco.mjtObj.mjOBJ_JOINT, name)
        body, dof = element.parent, int(m.jnt_dofadr[j])
        if body is None or body.tag != "body" or m.nkey:
            raise ModelError(f"the gear of '{joint}' needs a joint directly in its body, and no keyframes")
        attributes = {
            "name": name, "type": "hinge" if self._turns(j) else "slide", "axis": numbers(m.jnt_axis[j]),
            "pos": numbers(m.jnt_pos[j]), "ref": "0", "limited": "true",
            "stiffness": numbers([m.jnt_stiffness[j], *m.jnt_stiffnesspoly[j]]),
            "range": numbers(self._as_written(j, m.jnt_range[j])),
            "solreflimit": numbers(m.jnt_solref[j]), "solimplimit": numbers(m.jnt_solimp[j]),
            "margin": number(m.jnt_margin[j]), "damping": numbers([m.dof_damping[dof], *m.dof_dampingpoly[dof]]),
            "frictionloss": number(m.dof_frictionloss[dof]), "armature": number(m.dof_armature[dof]),
        }  # fmt: skip
        last = [c for c in body.children if c.tag == "joint"][-1]
        self._text.insert_after(last, tag("joint", attributes))

    def inertial(self, body: str) -> None:
        """Mass, centre of mass and inertia of a body; one without <inertial> gets it."""
        if self._same("body", body, "body_mass", "body_ipos", "body_inertia", "body_iquat"):
            return
        element, i = self._element("body", body), self._id("body", body)
        m = self._wanted
        tensor = body_inertia(m, i)
        full = [tensor[0, 0], tensor[1, 1], tensor[2, 2], tensor[0, 1], tensor[0, 2], tensor[1, 2]]
        new: dict[str, str | None] = {"pos": numbers(m.body_ipos[i]), "mass": number(m.body_mass[i])}
        present = element.child("inertial")
        turned = not self._same("body", body, "body_inertia", "body_iquat")
        if present is None or turned:
            new["fullinertia"] = numbers(full, 12)
        if present is None:
            self._text.insert_first(element, tag("inertial", new))
            return
        if turned:
            new |= dict.fromkeys(("diaginertia", *_ROTATIONS))
        unchanged = [k for k, f in (("pos", "body_ipos"), ("mass", "body_mass")) if self._same("body", body, f)]
        self._text.change(present, **{k: v for k, v in new.items() if k not in unchanged})

    def floor(self, _: str) -> None:
        """The plane that the robot stands on: moved where the file has it, added where it has none."""
        m, g = self._wanted, plane_of(self._wanted)
        name = m.geom(g).name
        lies = {"pos": numbers(m.geom_pos[g]), "quat": numbers(m.geom_quat[g]), "friction": numbers(m.geom_friction[g])}
        if plane_of(self._shipped) < 0:
            new = {"name": name, "type": "plane", "size": "0 0 0.1", "priority": str(m.geom_priority[g]), "condim": "3",
                   "contype": "1", "conaffinity": "1", **lies}  # fmt: skip
            self._text.insert_first(self._text.all("worldbody")[0], tag("geom", new))
        elif not self._same("geom", name, "geom_pos", "geom_quat", "geom_friction", "geom_priority"):
            rules = [k for k in ("priority", "condim", "solref", "solimp") if not self._same("geom", name, f"geom_{k}")]
            ruled = {k: numbers(np.atleast_1d(getattr(m, f"geom_{k}")[g])) for k in rules}
            self._text.change(
                self._element("geom", name), name=name or None, **{**dict.fromkeys(_ROTATIONS), **lies, **ruled}
            )

    def copied(self, family: str, field: str, attribute: str, name: str) -> None:
        """A field of MuJoCo's that an attribute of the element holds as it is."""
        if not self._same(family, name, field):
            value = numbers(read(self._wanted, family, name, field))
            self._text.change(self._element(family, name), **{attribute: value})

    def _element(self, family: str, name: str) -> Element:
        section = "actuator" if family == "actuator" else "worldbody"
        found = self._text.named(section, name, _TAGS[family]) or (self._plane(name) if family == "geom" else None)
        if found is None:
            raise ModelError(f"{family} '{name}' is not written in this file itself")
        return found

    def _plane(self, name: str) -> Element | None:
        """The floor of that name, where the file gives it none: by its place among the geoms of the world."""
        m, g = self._shipped, plane_of(self._shipped)
        if g < 0 or m.geom(g).name or name != self._wanted.geom(plane_of(self._wanted)).name:
            return None
        return next(iter(self._text.of_world("geom")[int(np.sum(m.geom_bodyid[:g] == 0)) :]), None)

    def _same(self, family: str, name: str, *fields: str) -> bool:
        pairs = ((read(self._wanted, family, name, f), self._there(family, name, f)) for f in fields)
        return all(np.allclose(*pair, rtol=ROUNDED, atol=1e-15) for pair in pairs)

    def _there(self, family: str, name: str, field: str) -> Array:
        return np.array([float(f"{x:{self._digits}}") for x in read(self._shipped, family, name, field)])

    def _turns(self, joint: int) -> bool:
        return int(self._wanted.jnt_type[joint]) == int(mujoco.mjtJoint.mjJNT_HINGE)

    def _as_written(self, joint: int, place: Array) -> Array:
        """Positions of a joint in the unit of the file."""
        return np.degrees(place) if self._degrees and self._turns(joint) else place

    def _id(self, family: str, name: str) -> int:
        return int(mujoco.mj_name2id(self._wanted, OBJECTS[family], name))


def _behind(kind: str) -> Callable[[Edits, str], None]:
    """A gap between drive and link ('slack'), or one with springs ('gear')."""
    return lambda edits, joint: edits.second(joint, joint + SECOND[kind])


def _copied(family: str, field: str, attribute: str) -> Callable[[Edits, str], None]:
    return lambda edits, name: edits.copied(family, field, attribute, name)


_WRITERS: Mapping[str, Callable[[Edits, str], None]] = {
    **dict.fromkeys(("actuator.kp", "actuator.kv", "actuator.gain", "actuator.zero"), Edits.kp),
    "actuator.force_limit": Edits.force_limit,
    **dict.fromkeys(("joint.damping", "joint.damping_quadratic"), Edits.damping),
    "joint.friction": _copied("joint", "dof_frictionloss", "frictionloss"), "joint.creep": Edits.creep,
    "joint.armature": _copied("joint", "dof_armature", "armature"),
    **dict.fromkeys(("joint.spring", "joint.spring_cubic", "joint.spring_rest"), Edits.spring),
    **dict.fromkeys(("joint.stop_lower", "joint.stop_upper"), Edits.stops),
    "joint.backlash": _behind("slack"),
    **dict.fromkeys(("joint.gear_backlash", "joint.gear_compliance"), _behind("gear")),
    **dict.fromkeys(("body.mass", "body.com", "body.inertia"), Edits.inertial),
    **dict.fromkeys(("world.floor_height", "world.floor_tilt", "world.floor_friction"), Edits.floor),
    "geom.friction": _copied("geom", "geom_friction", "friction"),
    "geom.softness": _copied("geom", "geom_solref", "solref"),
}  # fmt: skip


def read(model: mujoco.MjModel, family: str, name: str, field: str) -> Array:
    """A field of a named element; fields of a joint's dof and of its position by the joint's name."""
    i = int(mujoco.mj_name2id(model, OBJECTS[family], name))
    if i < 0:
        return np.array([np.nan])
    of_joint = {"dof": model.jnt_dofadr, "qpos": model.jnt_qposadr}.get(field.partition("_")[0])
    at = i if of_joint is None else int(of_joint[i])
    return np.atleast_1d(np.array(getattr(model, field)[at], dtype=np.float64))
