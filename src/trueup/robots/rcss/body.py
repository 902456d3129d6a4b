# SPDX-License-Identifier: Apache-2.0
"""The robots of RoboCup servers: their joints, with the effector and the perceptor of each, and how these are ordered."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from trueup.arrays import Array
from trueup.errors import ParameterError, unknown_name


@dataclass(frozen=True)
class Joint:
    """One joint, as recordings and commands name it."""

    name: str
    effector: str
    perceptor: str
    lower: float
    """rad; orders beyond are cut, and so are those beyond `upper`."""
    upper: float
    kp: float
    """Of its servo: N m/rad for rcssservermj, 1/s for SimSpark, whose effectors take speeds."""
    kd: float
    """N m s/rad; SimSpark has none."""
    sign: float = 1.0
    """-1 where the server turns it the other way."""
    fastest: float = math.radians(351.77)
    """rad/s that an effector which takes speeds is told at most: of SimSpark's Nao (`naorobottypes.rb`)."""


@dataclass(frozen=True)
class Body:
    """A robot that a server knows by name."""

    scene: str
    """What it is asked for by: 'T1', 'rsg/agent/nao/nao.rsg'."""
    simspark: bool
    """Whether the server is rcssserver3d (SimSpark), whose effectors take speeds, or rcssservermj, with a servo's law."""
    joints: tuple[Joint, ...]

    def joining(self, team: str, number: int) -> tuple[str, ...]:
        """The messages by which an agent comes into being; SimSpark answers the first before it takes the second."""
        if self.simspark:
            return f"(scene {self.scene})", f"(init (unum {number})(teamname {team}))"
        return (f"(init {self.scene} {team} {number})",)

    def order(self, target: Array, seen: Array) -> str:
        """The effector messages that take joints from where they are seen (k,) to `target` (k,), in rad."""
        parts = []
        for joint, angle, now in zip(self.joints, target, seen, strict=True):
            if self.simspark:
                speed = float(np.clip(joint.kp * (angle - now), -joint.fastest, joint.fastest))
                parts.append(f"({joint.effector} {joint.sign * speed:.5f})")
            else:
                degrees = math.degrees(joint.sign * angle)
                parts.append(f"({joint.effector} {degrees:.4f} 0 {joint.kp:.6g} {joint.kd:.6g} 0)")
        return "".join(parts)

    def within(self, values: Array) -> Array:
        """(..., k) angles cut to what the joints can reach."""
        low, high = np.array([(j.lower, j.upper) for j in self.joints]).T
        return np.clip(values, low, high)

    def renamed(self, joints: Mapping[str, str]) -> Body:
        """With joints by the names of one's own model: `joints` maps these to the server's, with a '-' before one that turns
        the other way. Raises UnknownNameError, and ParameterError where two are the same.
        """
        known, own = {j.name: j for j in self.joints}, {}
        for name, there in joints.items():
            bare = there.removeprefix("-")
            if bare not in known:
                raise unknown_name("joint", bare, known, f"the server's robot '{self.scene}'")
            if bare in own:
                raise ParameterError(f"joints '{own[bare].name}' and '{name}' are both the server's '{bare}'")
            j, sign = known[bare], -1.0 if there.startswith("-") else 1.0
            low, high = sorted((sign * j.lower, sign * j.upper))
            own[bare] = replace(j, name=name, sign=sign * j.sign, lower=low, upper=high)
        made = tuple(own.get(j.name, j) for j in self.joints)
        twice = [j.name for k, j in enumerate(made) if j.name in [m.name for m in made[:k]]]
        if twice:
            raise ParameterError(f"two joints of '{self.scene}' would be called '{twice[0]}'")
        return replace(self, joints=made)

    def tuned(self, kp: Mapping[str, float], kd: Mapping[str, float]) -> Body:
        """With the gains of some joints' servos, by name, settled. Raises UnknownNameError, ParameterError."""
        names = [j.name for j in self.joints]
        for what, gains in (("kp", kp), ("kd", kd)):
            for name, value in gains.items():
                if name not in names:
                    raise unknown_name("joint", name, names, f"the server's robot '{self.scene}'")
                if not (math.isfinite(value) and value >= 0.0):
                    raise ParameterError(f"{what} of joint '{name}' is {value}; it must be 0 or more")
        joints = (replace(j, kp=kp.get(j.name, j.kp), kd=kd.get(j.name, j.kd)) for j in self.joints)
        return replace(self, joints=tuple(joints))


_UT = math.degrees(0.15)
"""1/s: UT Austin Villa's released agent turns a joint by .15 rad/s for each degree that it is off."""


def _booster(scene: str, table: str) -> Body:
    """Lines of name, effector (perceptors have 'q_' before it, and j for e), range in rad, largest torque in N m.

    kp is such that a joint gives all its torque when it is off by a tenth of a radian: softer ankles do not hold the T1.
    kd is 15 ms of it: with 40 ms the server, which computes damping explicitly, shakes it off its feet.
    """
    joints = []
    for name, effector, low, high, torque in (line.split() for line in table.strip().splitlines()):
        kp = float(torque) / _REACH
        joints.append(Joint(name, effector, "q_" + effector.replace("e", "j"), float(low), float(high), kp, kp * _LEAD))
    return Body(scene, False, tuple(joints))


_REACH, _LEAD = 0.1, 0.015


def _nao() -> Body:
    """SimSpark's: joints by the names of its perceptors, ranges in degrees as its scene files have them."""
    head, arm, leg = [(-120, 120), (-45, 45)], [(-120, 120), (-1, 95), (-120, 120), (-90, 1)], [(-90, 1), (-25, 45),
        (-25, 100), (-130, 1), (-45, 75), (-45, 25)]  # fmt: skip
    mirrored = {"raj2", "raj4", "rlj2", "rlj6"}
    joints = []
    for limb, ranges in (("h", head), ("la", arm), ("ra", arm), ("ll", leg), ("rl", leg)):
        for k, span in enumerate(ranges):
            name, effector = f"{limb}j{k + 1}", f"{limb}e{k + 1}"
            low, high = (-span[1], -span[0]) if name in mirrored else span
            joints.append(Joint(name, effector, name, math.radians(low), math.radians(high), _UT, 0.0))
    return Body("rsg/agent/nao/nao.rsg", True, tuple(joints))


def body_named(name: str) -> Body:
    """The body of that name. Raises UnknownNameError, which lists them."""
    if name not in BODIES:
        raise unknown_name("robot", name, BODIES, "what is known of RoboCup servers")
    return BODIES[name]


def columns(body: Body, labels: Sequence[str], where: str) -> list[int]:
    """Where labels stand among the body's joints. Raises UnknownNameError."""
    names = [j.name for j in body.joints]
    for label in labels:
        if label not in names:
            raise unknown_name("joint", label, names, where)
    return [names.index(label) for label in labels]


_T1 = """
AAHead_yaw he1 -1.57 1.57 7
Head_pitch he2 -0.35 1.22 7
Left_Shoulder_Pitch lae1 -3.31 1.22 18
Left_Shoulder_Roll lae2 -1.74 1.57 18
Left_Elbow_Pitch lae3 -2.27 2.27 18
Left_Elbow_Yaw lae4 -2.44 0 18
Right_Shoulder_Pitch rae1 -3.31 1.22 18
Right_Shoulder_Roll rae2 -1.57 1.74 18
Right_Elbow_Pitch rae3 -2.27 2.27 18
Right_Elbow_Yaw rae4 0 2.44 18
Waist te1 -1.57 1.57 30
Left_Hip_Pitch lle1 -1.8 1.57 45
Left_Hip_Roll lle2 -0.2 1.57 30
Left_Hip_Yaw lle3 -1 1 30
Left_Knee_Pitch lle4 0 2.34 60
Left_Ankle_Pitch lle5 -0.87 0.35 20
Left_Ankle_Roll lle6 -0.44 0.44 15
Right_Hip_Pitch rle1 -1.8 1.57 45
Right_Hip_Roll rle2 -1.57 0.2 30
Right_Hip_Yaw rle3 -1 1 30
Right_Knee_Pitch rle4 0 2.34 60
Right_Ankle_Pitch rle5 -0.87 0.35 20
Right_Ankle_Roll rle6 -0.44 0.44 15
"""
_K1 = """
AAHead_yaw he1 -1 1 6
Head_pitch he2 -0.349 0.855 6
ALeft_Shoulder_Pitch lae1 -3.316 1.22 14
Left_Shoulder_Roll lae2 -1.74 1.57 14
Left_Elbow_Pitch lae3 -2.27 2.27 14
Left_Elbow_Yaw lae4 -2.44 0 14
ARight_Shoulder_Pitch rae1 -3.316 1.22 14
Right_Shoulder_Roll rae2 -1.57 1.74 14
Right_Elbow_Pitch rae3 -2.27 2.27 14
Right_Elbow_Yaw rae4 0 2.44 14
Left_Hip_Pitch lle1 -3 2.21 30
Left_Hip_Roll lle2 -0.4 1.57 35
Left_Hip_Yaw lle3 -1 1 20
Left_Knee_Pitch lle4 0 2.23 40
Left_Ankle_Pitch lle5 -0.87 0.345 20
Left_Ankle_Roll lle6 -0.345 0.345 20
Right_Hip_Pitch rle1 -3 2.21 30
Right_Hip_Roll rle2 -1.57 0.4 35
Right_Hip_Yaw rle3 -1 1 20
Right_Knee_Pitch rle4 0 2.23 40
Right_Ankle_Pitch rle5 -0.87 0.345 20
Right_Ankle_Roll rle6 -0.345 0.345 20
"""
BODIES: Mapping[str, Body] = MappingProxyType({
    "T1": _booster("T1", _T1), "K1": _booster("K1", _K1), "nao": _nao(),
})  # fmt: skip
"""Booster's T1 and K1 of rcssservermj 0.2.1, and SimSpark's NAO."""
