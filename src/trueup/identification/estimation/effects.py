# SPDX-License-Identifier: Apache-2.0
"""What a drive adds to the torque of rigid links: rotor, friction, offset, cable spring, hysteresis; linear each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from trueup.errors import ParameterError, unknown_name
from trueup.identification.friction import Term

Array = NDArray[np.float64]

_TERMS = ("coulomb", "viscous", "quadratic", "offset", "cubic", "saturating", "stribeck")
_OWN = {
    "rotor": "I{}m",
    "root": "fr_{}",
    "asymmetric": "fa_{}",
    "spring": "k_{}",
    "hysteresis": "fh_{}",
    "load": "fl_{}",
    "gain": "g_{}",
    "lag": "I{}lag",
}
_NEEDS_SCALE = ("saturating", "stribeck", "hysteresis")
OF_LOAD = ("load", "gain")
"""Effects of the torque that a gear carries: their columns need a first fit, see torque_model.loaded."""
_SHRINK = 1e-3
_GROWTH = {"rotor": 0.0, "lag": 0.0, "asymmetric": 4.0, "spring": 10.0, "quadratic": 20.0}
"""Times that, for effects that grow where the log ends: their square at about twice the speed, thrice the travel."""
_SHORT = {
    "rotor": "rotor inertia", "coulomb": "Coulomb", "saturating": "Coulomb that sets in with speed", "viscous": "viscous",
    "quadratic": "quadratic", "cubic": "cubic", "root": "root of speed", "asymmetric": "asymmetric", "stribeck": "Stribeck",
    "offset": "offset", "spring": "spring", "hysteresis": "hysteresis",
    "load": "with load", "gain": "own gain", "lag": "torque that falls with acceleration",
}  # fmt: skip
_MEANING = {
    "rotor": "inertia of the rotor, seen from the joint",
    "coulomb": "Coulomb friction",
    "saturating": "Coulomb friction that sets in over a range of speeds",
    "viscous": "viscous friction",
    "quadratic": "friction with the square of speed",
    "cubic": "friction with the cube of speed",
    "root": "friction with the square root of speed",
    "asymmetric": "friction that differs between both directions",
    "stribeck": "extra friction near standstill",
    "offset": "constant torque: sensor or current offset",
    "spring": "torque that grows with position: cables, a spring, a sensor that drifts with load",
    "hysteresis": "friction that builds up over a travel after each reversal",
    "load": "friction as a share of the torque that the gear carries",
    "gain": "torque out of scale with the other joints, or a gear that loses more when the load drives it",
    "lag": "torque that falls with acceleration, as no rotor's does: friction that comes behind its speed, or a late log",
}


@dataclass(frozen=True)
class Effect:
    """One effect; `scale` is the speed in rad/s (m/s) at which it saturates, or the travel in rad (m) of a hysteresis.

    Raises UnknownNameError, or ParameterError where a scale is missing.
    """

    kind: str
    scale: float = float("nan")

    def __post_init__(self) -> None:
        """Checks kind and scale."""
        if self.kind not in _MEANING:
            raise unknown_name("effect", self.kind, _MEANING, "the list")
        if self.kind in _NEEDS_SCALE and not self.scale > 0.0:
            raise ParameterError(f"effect '{self.kind}' needs a scale above 0, got {self.scale}")

    @property
    def meaning(self) -> str:
        """What it stands for, in words."""
        return _MEANING[self.kind]

    @property
    def short(self) -> str:
        """Its name in a list."""
        return _SHORT[self.kind]

    @property
    def is_friction(self) -> bool:
        """Whether it always brakes, so that its coefficient should be positive."""
        return self.kind in ("coulomb", "saturating", "viscous", "root", "hysteresis", "load")

    @property
    def shrink(self) -> float:
        """Share of its column's squares that draws its coefficient towards zero: effects that are nearly alike in the log,
        and far from it in other motion, share what they explain instead of growing against each other.
        """
        return _SHRINK * _GROWTH.get(self.kind, 1.0)

    def name(self, number: int) -> str:
        """Its coefficient's name at drive `number` (from 1): f1_2, I3m, ft0.05_1."""
        scale = f"{self.scale:.3g}" if self.kind in _NEEDS_SCALE else ""
        if self.kind in _OWN:
            base = _OWN[self.kind].format(number)
            return base.replace("_", f"{scale}_", 1) if scale else base
        return f"{Term(self.kind, self.scale).symbol}{scale}_{number}"

    def unit(self, prismatic: bool) -> str:
        """The unit of its coefficient."""
        force, travel = ("N", "m") if prismatic else ("N m", "rad")
        rotor = "kg" if prismatic else "kg m^2"
        own = {
            "rotor": rotor, "lag": rotor, "root": f"{force} s^.5/{travel}^.5",
            "asymmetric": f"{force} s/{travel}", "spring": f"{force}/{travel}", "hysteresis": force, "load": "", "gain": "",
        }  # fmt: skip
        return own[self.kind] if self.kind in own else Term(self.kind, self.scale).unit(prismatic)

    def column(self, q: Array, v: Array, a: Array) -> Array:
        """(S,) torque for a coefficient of one, along a motion of the drive: position, speed, acceleration (S,).

        Zero for effects of the load, which the motion of one drive does not tell.
        """
        match self.kind:
            case "rotor" | "lag":
                return a
            case "root":
                return np.sign(v) * np.sqrt(np.abs(v))
            case "asymmetric":
                return np.abs(v)
            case "spring":
                return q
            case "hysteresis":
                return stop_operator(q, self.scale)
            case "load" | "gain":
                return np.zeros_like(v)
            case _:
                return Term(self.kind, self.scale).column(v)


def stop_operator(q: Array, travel: float) -> Array:
    """(S,) rate-independent friction in -1...1 that builds up over `travel` after a reversal, at rest at first.

    The elastic-plastic (Prandtl) element: Brokate & Sprekels, "Hysteresis and Phase Transitions", 1996, section 2.3.
    """
    return _stopped(np.ascontiguousarray(q), travel)


@njit(cache=True)
def _stopped(q: Array, travel: float) -> Array:
    states = np.zeros(len(q))
    for i in range(1, len(q)):
        states[i] = min(max(states[i - 1] + (q[i] - q[i - 1]) / travel, -1.0), 1.0)
    return states
