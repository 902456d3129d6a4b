# SPDX-License-Identifier: Apache-2.0
"""From what the drives report to what the joints see: gear ratios, couplings, offsets, torque constants, in a TOML file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from trueup import files
from trueup.arrays import Array
from trueup.errors import IdentificationError, unknown_name
from trueup.typed_toml import build, check_finite


@dataclass(frozen=True)
class _Joint:
    ratio: float = 1.0
    offset: float = 0.0
    torque_constant: float | None = None
    spring: Literal["torsion", "strut", "none"] | None = None

    def __post_init__(self) -> None:
        for name in ("ratio", "torque_constant"):
            if getattr(self, name) == 0.0:
                raise ValueError(f"{name} is 0; a non-zero number is expected")


@dataclass(frozen=True)
class _Coupling:
    drive: str
    joint: str
    ratio: float = 1.0


@dataclass(frozen=True)
class _DrivesFile:
    positions: Literal["motor", "joint"] = "joint"
    torques: Literal["motor", "joint"] = "joint"
    joints: Mapping[str, _Joint] = field(default_factory=dict)
    couplings: tuple[_Coupling, ...] = ()


@dataclass(frozen=True, eq=False)
class Drives:
    """Drives of n joints; arrays are (n,). The default is one drive a joint that reports what the joint sees."""

    joints: tuple[str, ...]
    ratios: Array
    offsets: Array
    """rad (m)."""
    constants: Array
    """N m (N) per unit of what was logged: 1 for torques, the torque constant for currents."""
    coupling: Array
    """(n, n) unit diagonal: drive speed, geared to its joint, for joint speeds."""
    motor_positions: bool = False
    motor_torques: bool = False
    known_constants: tuple[str, ...] = field(default=())
    """Joints whose torque constant was given."""
    doubts: Array | None = None
    """(n,) relative standard deviations of the constants; None where they are exact."""
    springs: tuple[str, ...] = ()
    """What balances each joint (`effects.SPRINGS`), "" where nobody says; () where of none."""

    @classmethod
    def direct(cls, joints: Sequence[str]) -> Drives:
        """Drives that report joint positions and torques."""
        n = len(joints)
        return cls(tuple(joints), np.ones(n), np.zeros(n), np.ones(n), np.eye(n))

    @classmethod
    def load(cls, path: str | Path, joints: Sequence[str]) -> Drives:
        """The drives in a TOML file. Raises IdentificationError naming key and value, UnknownNameError for a joint."""
        return cls.from_dict(files.toml(Path(path), IdentificationError), joints, str(path))

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], joints: Sequence[str], where: str = "drives") -> Drives:
        """The drives in nested dicts, as TOML gives them."""
        check_finite(data, where, IdentificationError)
        given = build(_DrivesFile, data, where, IdentificationError)
        names, n = tuple(joints), len(joints)
        ratios, offsets, constants, coupling = np.ones(n), np.zeros(n), np.ones(n), np.eye(n)
        for name, joint in given.joints.items():
            at = _index(name, names, where)
            ratios[at], offsets[at], constants[at] = joint.ratio, joint.offset, joint.torque_constant or 1.0
        for k, one in enumerate(given.couplings, 1):
            if one.drive == one.joint:
                raise IdentificationError(f"{where}, [[couplings]] {k}: drive and joint are both '{one.drive}'")
            coupling[_index(one.drive, names, where), _index(one.joint, names, where)] = one.ratio
        known = tuple(name for name, joint in given.joints.items() if joint.torque_constant is not None)
        springs = tuple((given.joints[name].spring or "") if name in given.joints else "" for name in names)
        return cls(
            names, ratios, offsets, constants, coupling, given.positions == "motor", given.torques == "motor", known,
            springs=springs if any(springs) else (),
        )  # fmt: skip

    def only(self, joints: Sequence[str]) -> Drives:
        """The drives of some joints, in their order. Raises UnknownNameError."""
        at = [_index(name, self.joints, "drives") for name in joints]
        known = tuple(name for name in self.known_constants if name in joints)
        arrays = {name: getattr(self, name)[at] for name in ("ratios", "offsets", "constants")}
        if self.doubts is not None:
            arrays["doubts"] = self.doubts[at]
        return replace(
            self, joints=tuple(joints), coupling=self.coupling[np.ix_(at, at)], known_constants=known,
            springs=tuple(self.springs[k] for k in at) if self.springs else (), **arrays,
        )  # fmt: skip

    def joint_positions(self, logged: Array) -> Array:
        """(S, n) joint positions of logged ones (S, n)."""
        return self.joint_speeds(logged) + self.offsets

    def joint_speeds(self, logged: Array) -> Array:
        """(S, n) joint speeds of logged ones (S, n)."""
        return logged / self.ratios @ np.linalg.inv(self.coupling).T if self.motor_positions else logged

    def joint_torques(self, logged: Array) -> Array:
        """(S, n) joint torques of logged torques or currents (S, n): power is kept through gears and couplings."""
        torque = logged * self.constants
        return (torque * self.ratios) @ self.coupling if self.motor_torques else torque


def _index(name: str, names: Sequence[str], where: str) -> int:
    if name not in names:
        raise unknown_name("joint", name, names, f"the model ({where})")
    return names.index(name)
