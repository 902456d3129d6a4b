# SPDX-License-Identifier: Apache-2.0
"""The stand-in for the real arm: it moves as commanded, and its motors feel more than rigid links and simple friction.

Joints bend, friction depends on load, temperature, direction and standstill, the wrist's drives are coupled, gears
ripple. Each effect has a strength, 0 leaves it out. Or friction is of another form altogether.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cache

import numpy as np
from scipy.signal import bilinear, lfilter, lfilter_zi

from trueup.arrays import Array
from trueup.excitation.trajectories import Trajectory
from trueup.identification.kinematic_tree import KinematicTree
from trueup.identification.regressors import inverse_dynamics
from trueup.recording import Channel, Recording
from trueup.studies.arm.foreign import foreign_friction
from trueup.studies.arm.robot import COULOMB, NOMINAL, QUADRATIC, RATIOS, ROTORS, VISCOUS

RATE = 500.0
"""Samples per second of the arm's controller."""
_RESONANCE = np.array([12.0, 14.0, 17.0, 22.0, 25.0, 28.0])  # Hz
_DAMPING = 0.08
_STRIBECK = np.array([0.03, 0.03, 0.03, 0.08, 0.08, 0.10])  # rad/s
_STICK = 0.003  # rad/s over which friction changes its sign
_COUPLED = np.eye(6)  # speeds of the drives, geared to their joints, for speeds of the joints
_COUPLED[4, 3], _COUPLED[5, 4], _COUPLED[5, 3] = 0.3, 0.8, 0.1


@dataclass(frozen=True)
class Effects:
    """Strengths of what the rigid model does not know; 1 is the arm as it stands, 0 is none."""

    elastic: float = 1.0
    """Joints that bend: resonances at 12 to 28 Hz."""
    stribeck: float = 1.0
    """Friction that is 30 % higher near standstill."""
    load: float = 1.0
    """Friction that grows by 5 % of the torque that the gear carries."""
    temperature: float = 1.0
    """Friction 20 % higher when cold, lower when warm; each recording has a temperature of its own."""
    asymmetric: float = 1.0
    """Friction 8 % higher in one direction."""
    coupling: float = 1.0
    """Drives of the wrist that turn with other joints: their friction and rotors load these too."""
    ripple: float = 1.0
    """Torque with the turns of motor and gear, 1 % of nominal."""
    noise: float = 1.0
    """White torque noise, 1 % of nominal; position in steps of the motor's encoder."""
    foreign: float = 0.0
    """Above zero: friction of another form than any that is fitted, see foreign.py, in place of all friction above."""

    @classmethod
    def none(cls, **kept: float) -> Effects:
        """None but the noise, and those given."""
        nothing = {f.name: 0.0 for f in fields(cls) if f.name != "noise"}
        return cls(**{**nothing, **kept})

    def without(self, name: str) -> Effects:
        """All but one."""
        return replace(self, **{name: 0.0})


@dataclass(frozen=True, eq=False)
class HiddenArm:
    """The arm that is to be identified. Nothing but its recordings may be used for that."""

    tree: KinematicTree
    effects: Effects

    def perform(self, trajectory: Trajectory, rng: np.random.Generator, warmth: float | None = None) -> Recording:
        """One run at RATE: channels 'position' (rad) and 'torque' (N m, from motor currents, geared to the joints).

        `warmth` -1 (cold) ... 1; a new one for each run unless it is given.
        """
        warm = rng.uniform(-1.0, 1.0) if warmth is None else warmth
        torque = self.torque(trajectory.q, trajectory.qd, trajectory.qdd, warm)
        torque = torque + self.effects.noise * 0.01 * NOMINAL * rng.normal(size=torque.shape)
        step = 2.0 * np.pi / 4096.0 / RATIOS
        position = np.round(trajectory.q / step) * step if self.effects.noise else trajectory.q
        channels = {
            "position": Channel("position", trajectory.joints, "rad", trajectory.time, position),
            "torque": Channel("torque", trajectory.joints, "N m", trajectory.time, torque),
        }
        return Recording(trajectory.name, channels, {})

    def torque(self, q: Array, qd: Array, qdd: Array, warmth: float = 0.0) -> Array:
        """(S, 6) torque of the drives seen from the joints along a motion of the motors, without noise."""
        kind = self.effects
        bent = self._bending(qdd) if kind.elastic else np.zeros((3, *q.shape))
        carried = inverse_dynamics(
            self.tree, self.tree.weighed(), *(x + d for x, d in zip((q, qd, qdd), bent, strict=True))
        )
        C = np.eye(6) + kind.coupling * (_COUPLED - np.eye(6))
        angle, speed, push = (x @ C.T for x in (q, qd, qdd))
        through = carried @ np.asarray(np.linalg.inv(C), dtype=np.float64)  # what each gear carries
        if kind.foreign:
            rubbing = kind.foreign * foreign_friction(np.arange(len(q)) / RATE, angle, speed, through, warmth)
        else:
            rubbing = self.friction(speed, through, warmth)
        return carried + (ROTORS * push + rubbing + self._ripple(angle)) @ C

    def _bending(self, qdd: Array) -> Array:
        """(3, S, 6) link minus motor: position, speed, acceleration. Each joint a resonance that its acceleration drives.

        e'' + 2 z w e' + w^2 e = -qdd, from the bend that the first acceleration holds.
        """
        bend = np.zeros((3, *qdd.shape))
        for k, each in enumerate(_resonances()):
            for j, (b, a, start) in enumerate(each):
                bend[k, :, j] = lfilter(b, a, qdd[:, j], zi=start * qdd[0, j])[0]
        return self.effects.elastic * bend

    def friction(self, speed: Array, through: Array, warmth: float) -> Array:
        """(S, 6) friction of the drives at speeds (S, 6) while their gears carry torques `through` (S, 6)."""
        kind, sign = self.effects, np.tanh(speed / _STICK)
        size = COULOMB * (
            1.0 + 0.3 * kind.stribeck * np.exp(-((speed / _STRIBECK) ** 2)) + 0.08 * kind.asymmetric * sign
        )
        size = size + 0.05 * kind.load * np.abs(through) + QUADRATIC * speed**2
        return (1.0 - 0.2 * kind.temperature * warmth) * (size * sign + VISCOUS * speed)

    def _ripple(self, angle: Array) -> Array:
        motor = RATIOS * angle
        return self.effects.ripple * 0.01 * NOMINAL * (0.6 * np.sin(motor) + 0.4 * np.sin(2.0 * motor + 1.0))


@cache
def _resonances() -> tuple[tuple[tuple[Array, Array, Array], ...], ...]:
    """Filters (b, a, state at rest) from a joint's acceleration to its bend and that one's first two derivatives."""
    found = []
    for numerator in ([-1.0], [-1.0, 0.0], [-1.0, 0.0, 0.0]):
        filters = [
            bilinear(numerator, [1.0, 2.0 * _DAMPING * w, w * w], RATE) for w in (2.0 * np.pi * _RESONANCE).tolist()
        ]
        found.append(tuple((b, a, lfilter_zi(b, a)) for b, a in filters))
    return tuple(found)
