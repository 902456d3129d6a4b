# SPDX-License-Identifier: Apache-2.0
"""The stand-in's body in DART: rotors behind gaps, servos as their firmware runs them, a supply that sags, a cable."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trueup.arrays import Array
from trueup.articulated.model import WORLD, BasePose
from trueup.engines.dart.copies import DartCopies, ServoLaw
from trueup.engines.dart.model import DartModel
from trueup.studies.balance.hidden import ENCODER, Truth

_TEETH = 40.0, 0.04  # N m/rad and N m s/rad of teeth in contact
_STRIBECK = 0.1  # rad/s
_CABLE_AT = np.array([-0.067, 0.0, 0.03])  # m, on the torso's back
_CABLE_HEIGHT, _CABLE_FRICTION = 0.20, 0.5  # m above the floor below which the cable is bent; what it drags with


@dataclass(frozen=True, eq=False)
class HiddenModel(DartModel):
    """The robot as it is, for `ArticulatedSimulator`: the file's joints and shapes, the truth's masses and drives."""

    truth: Truth
    cabled: bool = False
    """Whether the cable is in reach of the floor, as in a handstand."""

    def copies(self, rows: int) -> HiddenCopies:
        """See Engine."""
        return HiddenCopies(self, rows)


class HiddenCopies(DartCopies):
    """Each drive is a rotor of its own behind a gap, so that its inertia and friction lie on the other side of it."""

    def __init__(self, model: HiddenModel, rows: int) -> None:
        self._hidden = model
        super().__init__(model, model.file, rows)
        truth, everyone = model.truth, np.ones(rows)
        for joint in model.drives():
            for attribute in ("damping", "friction", "armature"):
                self.set(f"joint.{attribute}", joint, 0.0 * everyone)
        for body, factor in truth.mass.items():
            self.set("body.mass", body, factor * self.get("body.mass", body))
            self.set("body.com", body, self.get("body.com", body) + truth.com[body])
        for geom in model.names("geom"):
            self.set("geom.friction", geom, truth.friction * self.get("geom.friction", geom))
        self._gravity = float(np.linalg.norm(self.get("world.gravity", WORLD)[0]))
        self._angle, self._speed = np.array(self.position), np.zeros_like(self.position)

    def place(self, position: Array, velocity: Array, base: BasePose | None = None) -> None:
        """See Running. Rotors stand in the middle of their gaps."""
        super().place(position, velocity, base)
        self._angle, self._speed = np.array(self.position), np.array(self.velocity)

    def _law(self, command: Array) -> ServoLaw:
        none = np.zeros_like(self.position)
        return ServoLaw(command[:, self._columns], none, np.ones_like(none), none)

    def _forces(self, law: ServoLaw) -> Array:
        """(b, dofs) what the teeth pass on; moves the rotors by a substep. Joints are in the order of the drives."""
        s, dt = self._hidden.truth.servos, self.substep
        q, v = self.position[:, self._at], self.velocity[:, self._at]
        error = law.given - ENCODER * np.round((q + s.zero) / ENCODER)
        duty = s.stiffness * np.sign(error) * np.maximum(np.abs(error) - s.margin, 0.0) / s.stall
        duty = np.clip(duty + s.punch * np.sign(duty), -1.0, 1.0)
        supply = 1.0 - self._hidden.truth.sag * np.abs(s.stall * duty).sum(axis=1, keepdims=True)
        gap = self._angle - q
        stretch = gap - np.clip(gap, -0.5 * s.backlash, 0.5 * s.backlash)
        passed = _TEETH[0] * stretch + _TEETH[1] * (self._speed - v) * (stretch != 0.0)
        free = (s.rotor * self._speed + dt * (s.stall * duty * supply - passed)) / (s.rotor + dt * s.damping)
        grip = s.coulomb + s.breakaway * np.exp(-((self._speed / _STRIBECK) ** 2))
        # Friction brings a rotor to rest within a step and holds it there: it sticks, without creep.
        self._speed = np.sign(free) * np.maximum(np.abs(free) - dt * grip / (s.rotor + dt * s.damping), 0.0)
        self._angle = self._angle + dt * self._speed
        self.force[:, self._at] = passed
        self._lost |= ~np.isfinite(passed).all(axis=1)
        self._whole[:, self._dofs] = self.force
        if self._hidden.cabled:
            self._drag(self.robots)
        return self._whole

    def _drag(self, robots: Sequence[Any]) -> None:
        """The cable, bent against the floor, pushes the torso up and holds it back where it slides."""
        for robot in robots:
            torso = robot.getRootBodyNode()
            bent = _CABLE_HEIGHT - float(torso.getTransform().multiply(_CABLE_AT)[2])
            if bent > 0.0:
                pushed = self._hidden.truth.cable * bent
                sliding = torso.getLinearVelocity(_CABLE_AT)[:2]
                drag = -_CABLE_FRICTION * pushed * sliding / max(0.05, float(np.linalg.norm(sliding)))
                torso.addExtForce(np.array([*drag, pushed]), _CABLE_AT, False, True)
