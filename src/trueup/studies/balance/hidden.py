# SPDX-License-Identifier: Apache-2.0
"""What a stand-in humanoid hides: masses, servos, contacts, cable, clocks that no file knows, drawn from a generator.

Sizes: the balancing paper reports 40 % between the CAD model's mass and the scales; resolution, dead band, punch and
torque are those of the maker's data sheets for AX-12A and AX-18A; all else are ordinary values of hobby servos.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueup.arrays import Array

ENCODER = float(np.deg2rad(300.0 / 1024.0))
"""rad between two positions that a servo can tell."""


@dataclass(frozen=True, eq=False)
class Servos:
    """The drives, (k,) each, in the order of the joints."""

    stiffness: Array
    """N m/rad at nominal voltage."""
    stall: Array
    """N m at nominal voltage."""
    damping: Array
    """N m s/rad, back-EMF and viscous friction."""
    coulomb: Array
    """N m."""
    breakaway: Array
    """N m above Coulomb friction, faded at some 0.1 rad/s."""
    rotor: Array
    """kg m2 at the output shaft."""
    backlash: Array
    """rad, end to end."""
    zero: Array
    """rad by which the horn was put on askew: the servo believes itself there."""
    margin: float = ENCODER
    """rad of error that it does not heed (compliance margin of one step)."""
    punch: float = 32.0 / 1023.0
    """Share of full torque with which it answers the smallest error beyond."""


@dataclass(frozen=True, eq=False)
class Truth:
    """One stand-in: how it differs from the model file, and how it is measured."""

    mass: Mapping[str, float]
    """Body to factor."""
    com: Mapping[str, Array]
    """Body to what is added to its centre of mass (3,), in m."""
    servos: Servos
    friction: float
    """Factor on that of all contacts."""
    delay: float
    """From command to servo, in s."""
    sag: float
    """Share of the voltage lost for each N m that the servos make together."""
    cable: float
    """N/m with which the cable resists being pressed on the floor (handstand)."""
    clock: float
    """s by which the motion capture's clock is ahead of the servos'."""
    drift: float
    """How much faster it runs, as a share."""

    def repeat(self, rng: np.random.Generator) -> Truth:
        """The same robot the next time: its battery a little lower, its gears warmer, its horns as they were."""
        s, weaker = self.servos, rng.uniform(0.985, 1.0)
        warm = rng.normal(1.0, 0.03)
        again = replace(
            s,
            stiffness=weaker * s.stiffness,
            stall=weaker * s.stall,
            coulomb=warm * s.coulomb,
            damping=warm * s.damping,
        )
        return replace(
            self, servos=again, delay=max(0.0, self.delay + rng.normal(0.0, 0.001)),
            friction=self.friction * rng.normal(1.0, 0.02), cable=self.cable * rng.uniform(0.7, 1.3),
        )  # fmt: skip


def random_truth(
    rng: np.random.Generator, bodies: Sequence[str], joints: Sequence[str], limits: Array, gap: float = 1.0
) -> Truth:
    """A truth for a robot whose names begin with 'l_' and 'r_' on its sides; `limits` (k,) torques by the data sheet, N m.

    `gap` scales all that differs from the model; 0 is a robot that is its model, but for its contacts and its noise.
    """
    heavier = float(np.exp(gap * rng.uniform(np.log(0.85), np.log(1.4))))
    parts = _sided(rng, bodies, 0.10 * gap)
    shifts = {name[2:] if name[:2] in ("l_", "r_") else name: rng.normal(0.0, 0.003 * gap, 3) for name in bodies}
    shifts["torso"] = gap * np.array([rng.normal(0.0, 0.006), rng.normal(0.0, 0.001), rng.normal(0.0, 0.006)])
    com = {n: shifts.get(n, shifts.get(n[2:], np.zeros(3))) * _mirror(n) for n in bodies}
    k = len(joints)

    def factors(spread: float, shared: float = 0.0) -> Array:
        sides = _sided(rng, joints, spread * gap)
        return np.exp(rng.normal(0.0, shared * gap)) * np.array([sides[j] for j in joints])

    servos = Servos(
        stiffness=9.272 * factors(0.10, 0.15), stall=limits * np.minimum(1.05, 0.95 * factors(0.05)),
        damping=0.3069 * factors(0.12, 0.15), coulomb=0.03 * factors(0.25, 0.3), breakaway=0.015 * gap * factors(0.3),
        rotor=0.002 * factors(0.10, 0.2), backlash=gap * rng.uniform(0.003, 0.012, k),
        zero=gap * rng.normal(0.0, 0.008, k),
    )  # fmt: skip
    return Truth(
        mass={n: heavier * parts[n] for n in bodies}, com=com, servos=servos,
        friction=float(np.exp(gap * rng.uniform(np.log(0.7), np.log(1.2)))), delay=gap * rng.uniform(0.005, 0.025),
        sag=gap * rng.uniform(0.005, 0.02), cable=gap * rng.uniform(4.0, 12.0),
        clock=rng.uniform(-0.03, 0.03), drift=rng.normal(0.0, 1e-4),
    )  # fmt: skip


def _sided(rng: np.random.Generator, names: Sequence[str], spread: float) -> dict[str, float]:
    """Name to factor: both sides nearly alike."""
    shared: dict[str, float] = {}
    found = {}
    for name in names:
        both = name[2:] if name[:2] in ("l_", "r_") else name
        if both not in shared:
            shared[both] = float(rng.normal(0.0, spread))
        found[name] = float(np.exp(shared[both] + rng.normal(0.0, 0.2 * spread)))
    return found


def _mirror(name: str) -> Array:
    return np.array([1.0, -1.0 if name.startswith("r_") else 1.0, 1.0])
