# SPDX-License-Identifier: Apache-2.0
"""From what the drives report to what the joints see: gear ratios, couplings, offsets, torque constants, in a TOML file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup import files
from trueup.errors import IdentificationError, unknown_name

Array = NDArray[np.float64]

_TOP = ("positions", "torques", "joints", "couplings")
_JOINT = ("ratio", "offset", "torque_constant")
_COUPLING = ("drive", "joint", "ratio")


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
        _known(data, _TOP, where)
        names, n = tuple(joints), len(joints)
        ratios, offsets, constants, coupling = np.ones(n), np.zeros(n), np.ones(n), np.eye(n)
        given = []
        for name, entry in _table(data.get("joints", {}), f"{where}, [joints]").items():
            at, here = _index(name, names, where), f"{where}, [joints.{name}]"
            values = _table(entry, here)
            _known(values, _JOINT, here)
            ratios[at] = _number(values.get("ratio", 1.0), f"{here}, ratio", zero=False)
            offsets[at] = _number(values.get("offset", 0.0), f"{here}, offset")
            if "torque_constant" in values:
                constants[at] = _number(values["torque_constant"], f"{here}, torque_constant", zero=False)
                given.append(name)
        for i, entry in enumerate(data.get("couplings", [])):
            here = f"{where}, [[couplings]] {i + 1}"
            values = _table(entry, here)
            _known(values, _COUPLING, here)
            if missing := [key for key in ("drive", "joint") if key not in values]:
                raise IdentificationError(f"{here}: '{missing[0]}' is missing; name the joints with drive and joint")
            drive, joint = (_index(str(values[key]), names, here) for key in ("drive", "joint"))
            if drive == joint:
                raise IdentificationError(f"{here}: drive and joint are both '{names[drive]}'")
            coupling[drive, joint] = _number(values.get("ratio", 1.0), f"{here}, ratio")
        positions, torques = (_side(data.get(key, "joint"), f"{where}, {key}") for key in ("positions", "torques"))
        return cls(names, ratios, offsets, constants, coupling, positions, torques, tuple(given))

    def only(self, joints: Sequence[str]) -> Drives:
        """The drives of some joints, in their order. Raises UnknownNameError."""
        at = [_index(name, self.joints, "drives") for name in joints]
        known = tuple(name for name in self.known_constants if name in joints)
        arrays = {name: getattr(self, name)[at] for name in ("ratios", "offsets", "constants")}
        return replace(
            self, joints=tuple(joints), coupling=self.coupling[np.ix_(at, at)], known_constants=known, **arrays
        )

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


def _side(value: Any, where: str) -> bool:
    if value not in ("motor", "joint"):
        raise IdentificationError(f"{where}: '{value}' is unknown; choices are: 'motor', 'joint'")
    return value == "motor"


def _index(name: str, names: Sequence[str], where: str) -> int:
    if name not in names:
        raise unknown_name("joint", name, names, f"the model ({where})")
    return names.index(name)


def _known(data: Mapping[str, Any], known: Sequence[str], where: str) -> None:
    for key in data:
        if key not in known:
            raise IdentificationError(f"{where}: unknown key '{key}'; keys are: {', '.join(known)}")


def _table(value: Any, where: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise IdentificationError(f"{where}: {value!r} is not a table of keys")
    return value


def _number(value: Any, where: str, *, zero: bool = True) -> float:
    if (
        isinstance(value, bool)
        or not isinstance(value, int | float)
        or not abs(value) < 1e12
        or (not zero and value == 0)
    ):
        raise IdentificationError(f"{where}: {value!r} is not a {'' if zero else 'non-zero '}finite number")
    return float(value)
