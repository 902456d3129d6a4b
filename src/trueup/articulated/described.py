# SPDX-License-Identifier: Apache-2.0
"""A robot described by plain numbers, without files: what an engine of one's own needs beside its equations of motion."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.articulated.model import WORLD, BasePose, Model
from trueup.errors import unknown_name

_OPTIONAL = frozenset([
    "joint.start", "joint.start_velocity", "joint.slides",
    "actuator.slides", "actuator.delay", "actuator.servo", "actuator.torque",
])  # fmt: skip
"""Attributes that a description may leave out: hinges at rest, driven by motors that are told their torque. All others it
names only where its equations heed them: a quantity without effect would be calibrated in vain."""


@dataclass(frozen=True, eq=False)
class Described:
    """A robot as names and attributes (`articulated.model.Model`); a subclass adds the equations of motion, `advance`."""

    name: str
    joints: Mapping[str, str]
    """Each joint to its actuator, '' where it has none."""
    attributes: Mapping[tuple[str, str], float | Sequence[float]]
    """('body.mass', 'pole') -> a number or several; quantities can read and write these, and no others."""

    def advance(self, copies: StoredCopies, force: Array, step: float) -> None:
        """One step of `step` s with the commands `force` (b, width): writes `copies.position`, `copies.velocity` (b, k).

        May write `copies.force` (b, k) too, what the drives pushed the joints with.
        """
        raise NotImplementedError(f"'{self.name}' does not say how it moves")

    def names(self, kind: str) -> tuple[str, ...]:
        """See Model."""
        if kind == "actuator":
            return tuple(a for a in self.joints.values() if a)
        return tuple(dict.fromkeys(n for a, n in self.attributes if a.partition(".")[0] == kind))

    def drives(self) -> Mapping[str, str]:
        """See Model."""
        return self.joints

    def columns(self) -> Mapping[str, int]:
        """See Model."""
        return {name: i for i, name in enumerate(self.names("actuator"))}

    @property
    def width(self) -> int:
        """See Model."""
        return len(self.names("actuator"))

    def channels(self) -> Mapping[str, tuple[str, ...]]:
        """See Engine: none; what a subclass adds, its copies must show."""
        return {}

    def get(self, attribute: str, name: str) -> Array:
        """See Model."""
        value = self.attributes.get((attribute, name))
        if value is not None:
            return np.asarray([value], dtype=np.float64)
        family = attribute.partition(".")[0]
        known = {"joint": self.joints, "world": (WORLD,)}.get(family, self.names(family))
        if name not in known:
            raise unknown_name(family, name, known, f"model '{self.name}'")
        if attribute not in _OPTIONAL:
            offered = {a for a, n in self.attributes if n == name}
            raise unknown_name("attribute", attribute, offered, f"what model '{self.name}' offers of '{name}'")
        return np.array([float(attribute == "actuator.torque")])

    def copies(self, rows: int) -> StoredCopies:
        """See `articulated.simulator.Engine`."""
        return StoredCopies(self, rows)


class StoredCopies:
    """b copies of a model whose attributes and states are kept here as arrays (`articulated.model.Copies`).

    Of any model, as what quantities write into; of a `Described` one they can be stepped.
    """

    def __init__(self, model: Model, rows: int) -> None:
        self.model, self.rows = model, rows
        self._kept: dict[tuple[str, str], Array] = {}
        self._joints = list(model.drives())
        self.position, self.velocity, self.force = np.zeros((3, rows, len(self._joints)))

    def get(self, attribute: str, name: str) -> Array:
        """See Attributes."""
        if (attribute, name) not in self._kept:
            self._kept[attribute, name] = np.repeat(self.model.get(attribute, name), self.rows, axis=0)
        return np.array(self._kept[attribute, name])

    def set(self, attribute: str, name: str, values: Array) -> None:
        """See Writable."""
        self.get(attribute, name)  # says what is not there
        self._kept[attribute, name] = np.array(values, dtype=np.float64)

    def reader(self, state: str, joints: Sequence[str]) -> Callable[[int], Array]:
        """See Copies."""
        where = [self._joints.index(j) for j in joints]
        return lambda n: np.ascontiguousarray(getattr(self, state)[:n, where])

    def writer(self, attribute: str, names: Sequence[str]) -> Callable[[Array], None]:
        """See Copies."""

        def write(values: Array) -> None:
            for name, column in zip(names, values.T, strict=True):
                whole = self.get(attribute, name)
                whole[: len(column)] = column
                self.set(attribute, name, whole)

        return write

    def place(self, position: Array, velocity: Array, base: BasePose | None = None) -> None:
        """See Running."""
        self.position, self.velocity = np.array(position), np.array(velocity)

    def step(self, command: Array, step: float) -> None:
        """See Running."""
        if not isinstance(self.model, Described):
            raise TypeError(f"'{self.model.name}' is no Described model: copies kept here cannot step it")
        self.model.advance(self, command, step)
