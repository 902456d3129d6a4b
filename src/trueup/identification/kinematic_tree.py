# SPDX-License-Identifier: Apache-2.0
"""The kinematic tree of a robot: its joints, how their axes lie to one another, their limits, and what the file weighs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from trueup.arrays import Array, Integers, Mask
from trueup.errors import ModelError, unknown_name
from trueup.identification.inertial import moved
from trueup.units import GRAVITY

GEOMETRY = ("parent", "prismatic", "axis", "rotation", "offset", "gravity")
"""Fields of a tree that say how it moves."""


@dataclass(frozen=True, eq=False)
class KinematicTree:
    """n revolute and prismatic joints on a fixed base, parents before children; arrays are read-only.

    The frame of link i is fixed to it, with its origin on the axis of joint i: at q = 0 it stands at `offset[i]`,
    `rotation[i]` in the frame of its parent link (or the base), and it moves with q about (or along) `axis[i]`.
    """

    name: str
    joints: tuple[str, ...]
    links: tuple[str, ...]
    """What each joint moves; bodies that are fixed to it are merged into it."""
    parent: Integers
    """(n,) index of the joint before, -1 for the base."""
    prismatic: Mask
    axis: Array
    """(n, 3) unit vectors in the link's own frame."""
    rotation: Array
    """(n, 3, 3) link frame to parent's link frame at q = 0."""
    offset: Array
    """(n, 3) in m, in the parent's link frame at q = 0."""
    gravity: Array
    """(3,) acceleration of free fall in the base frame, m/s^2."""
    lower: Array
    upper: Array
    speed: Array
    """(n,) limit in rad/s or m/s; NaN where the file has none, as for `lower`, `upper` and `effort`."""
    effort: Array
    inertial: Array
    """(n, 10) from the file, in the order of `trueup.identification.inertial`; NaN for a link that it does not weigh."""
    armature: Array
    """(n,) rotor inertia at the joint, kg m^2 (or kg)."""
    damping: Array = field(default_factory=lambda: np.zeros(0))
    """(n,) viscous friction that the file gives, N m s/rad (N s/m); zero where it gives none, as for `friction`."""
    friction: Array = field(default_factory=lambda: np.zeros(0))
    """(n,) Coulomb friction, N m (N)."""
    stiffness: Array = field(default_factory=lambda: np.zeros(0))
    """(n,) of springs at joints, N m/rad (N/m)."""
    slack: Array = field(default_factory=lambda: np.zeros(0))
    """(n,) rad (m) where these pull to neither side."""
    loops: tuple[tuple[str, ...], ...] = ()
    """Joints of each loop that the file closes between two bodies, which a tree lacks."""
    notes: tuple[str, ...] = ()
    """What was left out or assumed on reading, in words."""

    def __post_init__(self) -> None:
        """Copies arrays to read-only ones of the right kind. Raises ModelError where shapes disagree."""
        n = len(self.joints)
        shapes = {"axis": (n, 3), "rotation": (n, 3, 3), "offset": (n, 3), "gravity": (3,), "inertial": (n, 10)}
        for name in (f.name for f in fields(self) if f.name not in ("name", "joints", "links", "loops", "notes")):
            kind = {"parent": np.int64, "prismatic": np.bool_}.get(name, np.float64)
            values = np.array(getattr(self, name), dtype=kind)
            if name in ("damping", "friction", "stiffness", "slack") and not values.size:
                values = np.zeros(n)
            if values.shape != (wanted := shapes.get(name, (n,))):
                raise ModelError(f"{name} of tree '{self.name}' has shape {values.shape}, expected {wanted}")
            values.flags.writeable = False
            object.__setattr__(self, name, values)
        if np.any(self.parent >= np.arange(n)):
            raise ModelError(f"joints of tree '{self.name}' must come after the joints that carry them")

    @classmethod
    def of_geometry(
        cls, name: str, joints: Sequence[str], links: Sequence[str], geometry: Mapping[str, ArrayLike]
    ) -> KinematicTree:
        """A tree of which only the fields `GEOMETRY` are known: it weighs nothing and has no limits."""
        n = len(joints)
        given = {key: np.asarray(geometry[key]) for key in GEOMETRY}
        return cls(name=name, joints=tuple(joints), links=tuple(links), **unknown(n), **given)  # type: ignore[arg-type]

    @property
    def n(self) -> int:
        """The number of joints."""
        return len(self.joints)

    def index(self, joint: str) -> int:
        """The place of a joint. Raises UnknownNameError, which lists the joints."""
        if joint not in self.joints:
            raise unknown_name("joint", joint, self.joints)
        return self.joints.index(joint)

    def carries(self) -> Mask:
        """(n, n) whether joint i carries link j, itself included: where the torque of i depends on the mass of j."""
        moves = np.eye(self.n, dtype=bool)
        for j, p in enumerate(self.parent):
            if p >= 0:
                moves[:, j] |= moves[:, p]
        return moves

    def weighed(self) -> Array:
        """(n, 10) the file's inertial parameters. Raises ModelError naming the links that have none."""
        missing = [link for link, row in zip(self.links, self.inertial, strict=True) if np.isnan(row).any()]
        if missing:
            raise ModelError(
                f"model '{self.name}' gives no inertia for {len(missing)} of {self.n} links: {', '.join(missing)}; "
                "motion and base parameters need none, but torque from the file's own values does: fill in <inertial> "
                "(a rough guess from volume will do as a start) or pass inertial parameters of your own"
            )
        return self.inertial

    def replace(self, **changes: object) -> KinematicTree:
        """A copy with some fields changed: `tree.replace(gravity=(0, 0, 9.81))` for an arm that hangs."""
        return replace(self, **changes)  # type: ignore[arg-type]

    def lock(self, names: Iterable[str], at: float | ArrayLike = 0.0) -> KinematicTree:
        """A tree without these joints, each welded at its value `at` (rad or m); their links join the links before.

        Raises UnknownNameError for a joint that is not there.
        """
        gone = [self.index(name) for name in names]
        held = dict(zip(gone, np.broadcast_to(np.asarray(at, dtype=float), (len(gone),)), strict=True))
        tree = self
        for i in sorted(held, reverse=True):
            tree = tree._without(i, float(held[i]))
        return tree

    def _without(self, i: int, q: float) -> KinematicTree:
        """The tree with joint i welded at q: its children hang on its parent, which gains its mass."""
        R, p = joint_pose(self, i, q)
        rotation, offset, inertial, parent = (
            np.array(a) for a in (self.rotation, self.offset, self.inertial, self.parent)
        )
        for j in np.flatnonzero(parent == i):
            rotation[j], offset[j] = R @ rotation[j], p + R @ offset[j]
        if (carrier := int(parent[i])) >= 0:
            inertial[carrier] += moved(np.nan_to_num(inertial[i]), R, p)
        parent[parent == i] = carrier
        parent[parent > i] -= 1
        keep = np.arange(self.n) != i
        arrays = {
            k: getattr(self, k)[keep]
            for k in ("prismatic", "axis", "lower", "upper", "speed", "effort", "armature", "damping", "friction",
                      "stiffness", "slack")
        }  # fmt: skip
        return self.replace(
            joints=tuple(np.array(self.joints)[keep].tolist()), links=tuple(np.array(self.links)[keep].tolist()),
            parent=parent[keep], rotation=rotation[keep], offset=offset[keep], inertial=inertial[keep], **arrays,
        )  # fmt: skip


def unknown(n: int) -> dict[str, Array]:
    """Limits and inertias of a tree of which nobody has said any; no rotors."""
    nothing = np.full(n, np.nan)
    rest = dict.fromkeys(("lower", "upper", "speed", "effort"), nothing)
    return {**rest, "inertial": np.full((n, 10), np.nan), "armature": np.zeros(n)}


def about(axis: Array, angle: ArrayLike) -> Array:
    """(..., 3, 3) rotation by `angle` (...) rad about a unit `axis` (3,)."""
    return exponential(np.asarray(angle, dtype=float)[..., None] * axis)


def exponential(vector: Array) -> Array:
    """(..., 3, 3) rotations about vectors (..., 3) by their length in rad: Rodrigues' formula."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    x, y, z = np.moveaxis(vector, -1, 0)
    nought = np.zeros_like(x)
    K = np.stack([nought, -z, y, z, nought, -x, -y, x, nought], axis=-1).reshape(*vector.shape[:-1], 3, 3)
    return np.eye(3) + np.sinc(angle / np.pi) * K + 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2 * (K @ K)


def of_quaternion(quaternion: Array) -> Array:
    """(3, 3) rotation of a quaternion w x y z of any length above zero."""
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


def of_angles(roll: float, pitch: float, yaw: float) -> Array:
    """(3, 3) rotation by roll, pitch and yaw in rad about the fixed axes x, y, z, as URDF has them."""
    x, y, z = np.eye(3)
    return about(z, yaw) @ about(y, pitch) @ about(x, roll)


def joint_pose(tree: KinematicTree, i: int, q: float) -> tuple[Array, Array]:
    """Rotation (3, 3) and position (3,) of link i in its parent's frame, with its joint at q."""
    if tree.prismatic[i]:
        return tree.rotation[i], tree.offset[i] + tree.rotation[i] @ tree.axis[i] * q
    return tree.rotation[i] @ about(tree.axis[i], q), tree.offset[i]


def from_dh(
    a: Sequence[float], alpha: Sequence[float], d: Sequence[float], theta: Sequence[float] | None = None, *,
    prismatic: Sequence[bool] | None = None, convention: Literal["standard", "modified"] = "standard",
    joints: Sequence[str] | None = None, name: str = "arm", gravity: ArrayLike = (0.0, 0.0, -GRAVITY), **given: ArrayLike,
) -> KinematicTree:  # fmt: skip
    """A chain from Denavit-Hartenberg rows (m, rad); `theta` are the offsets of revolute joints, `given` other fields.

    'standard' (distal): T_i = Rz(theta_i + q_i) Tz(d_i) Tx(a_i) Rx(alpha_i); link i has the axes of frame i and the
    origin of frame i - 1, a point of its joint axis, so that its moments depend on no a or d. 'modified' (Craig):
    T_i = Rx(alpha_i) Tx(a_i) Rz(theta_i + q_i) Tz(d_i), with link frames those of the table.
    """
    n = len(a)
    turns = np.zeros(n) if theta is None else np.asarray(theta, dtype=float)
    x, z = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
    twist = about(x, np.asarray(alpha, dtype=float))
    lengths = np.column_stack([a, np.zeros(n), d])
    if convention == "standard":
        axis = np.einsum("nij,i->nj", twist, z)  # the joint's axis z of frame i - 1, seen from frame i
        rotation = about(z, turns) @ twist
        ahead = np.einsum("nij,ni->nj", twist, lengths)  # origin i seen from origin i - 1 in the axes of frame i
        offset = np.vstack([np.zeros(3), ahead[:-1]])
    else:
        axis, rotation = np.tile(z, (n, 1)), twist @ about(z, turns)
        offset = np.einsum("nij,nj->ni", twist, lengths)
    names = tuple(joints) if joints is not None else tuple(f"joint{i + 1}" for i in range(n))
    values = {**unknown(n), "links": tuple(f"link{i + 1}" for i in range(n)), **given}
    return KinematicTree(
        name=name, joints=names, parent=np.arange(n) - 1, axis=axis, rotation=rotation, offset=offset,
        prismatic=np.zeros(n, dtype=bool) if prismatic is None else np.asarray(prismatic, dtype=bool),
        gravity=np.asarray(gravity, dtype=float), **values,  # type: ignore[arg-type]
    )  # fmt: skip
