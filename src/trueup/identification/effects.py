# SPDX-License-Identifier: Apache-2.0
"""What a drive adds to the torque of rigid links: rotor, friction, offset, cable spring, hysteresis; linear each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from trueup.arrays import Array
from trueup.compiled import njit
from trueup.errors import ParameterError, unknown_name


class _Kind(NamedTuple):
    """One form of effect."""

    symbol: str
    """Of its coefficient; {} is the drive's number, behind an underscore where there is none."""
    unit: str
    """Of its coefficient: F a torque or force, L rad or m, I an inertia."""
    short: str
    """Its name in a list."""
    formula: str
    """For a coefficient of one, alike in C and Python: drive position q, speed v, acceleration a, scale s, load L."""
    growth: float = 1.0
    """Times that it is drawn to zero where it grows beyond the log: by its square at twice the speed, thrice the travel."""
    power: int = 0
    """Of speed that it grows with."""
    scaled: bool = False
    """Whether it has a scale."""


_KINDS: Mapping[str, _Kind] = MappingProxyType({
    "rotor": _Kind("I{}m", "I", "rotor inertia", "a", 0.0),
    "coulomb": _Kind("f0", "F", "Coulomb", "sign(v)"),
    "viscous": _Kind("f1", "F s/L", "viscous", "v", power=1),
    "quadratic": _Kind("f2", "F s^2/L^2", "quadratic", "v*fabs(v)", 20.0, 2),
    "offset": _Kind("fo", "F", "offset", "1.0"),  # of a sensor or a current
    "saturating": _Kind("ft", "F", "Coulomb that sets in with speed", "tanh(v/s)", scaled=True),
    "root": _Kind("fr", "F s^.5/L^.5", "root of speed", "sign(v)*sqrt(fabs(v))"),
    # friction that differs between both directions
    "asymmetric": _Kind("fa", "F s/L", "asymmetric", "fabs(v)", 4.0, 1),
    "spring": _Kind("k", "F/L", "spring", "q", 10.0),  # cables, a spring, a sensor that drifts with load
    # friction behind its speed, or a late log
    "lag": _Kind("I{}lag", "I", "torque that falls with acceleration", "a", 0.0),
    # builds up over a travel after each reversal
    "hysteresis": _Kind("fh", "F", "hysteresis", "stop(q, s)", scaled=True),
    # friction as a share of the torque that the gear carries
    "load": _Kind("fl", "", "with load", "fabs(L)*tanh(v/s)", scaled=True),
    # out of scale with other joints, or a gear that loses more when the load drives it
    "gain": _Kind("g", "", "own gain", "L"),
    # what balances a joint, where it is known to be there: nothing draws it to zero
    "torsion": _Kind("kt", "F/L", "torsion spring", "q", 0.0),
    "sine": _Kind("ks", "F", "sine of a strut", "sin(q)", 0.0),
    "cosine": _Kind("kc", "F", "cosine of a strut", "cos(q)", 0.0),  # of a force along a line between two points
})  # fmt: skip
WAVES = ("sine", "cosine")
"""Torque of a spring without free length between two points, as weight makes it."""
SPRINGS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"none": (), "torsion": ("torsion",), "strut": ("torsion", *WAVES)}
)
"""What balances a joint, by name, as effects beside an offset. Within 60 degrees of either side of zero these are within
0.8 % of the torque of coil springs and gas struts that pull along a line between two points; the waves alone within 10 %, a
torsion spring within 26 %.
"""
OF_LOAD = ("load", "gain")
"""Effects of the torque that a gear carries: their columns need a first fit, see `Effect.column`."""
_OF_PATH = ("hysteresis", *OF_LOAD)
_SHRINK = 1e-3
"""Of its own squares draws an effect to zero. Chosen on 48 simulated arms by the errors on motion of another kind."""


@dataclass(frozen=True)
class Effect:
    """One effect; `scale` is the speed in rad/s (m/s) over which it sets in, or the travel in rad (m) of a hysteresis.

    The papers' friction (evolved trajectories, eq. 2) is coulomb, viscous, quadratic:
    f0 sign(qd) + f1 qd + f2 sign(qd) qd^2. Raises UnknownNameError, or ParameterError where a scale is missing.
    """

    kind: str
    scale: float = float("nan")

    def __post_init__(self) -> None:
        """Checks kind and scale."""
        if self.kind not in _KINDS:
            raise unknown_name("effect", self.kind, _KINDS, "the list")
        if _KINDS[self.kind].scaled and not self.scale > 0.0:
            raise ParameterError(f"effect '{self.kind}' needs a scale above 0, got {self.scale}")

    @property
    def short(self) -> str:
        """Its name in a list."""
        return _KINDS[self.kind].short

    @property
    def formula(self) -> str:
        """Its torque for a coefficient of one, see `_Kind.formula`."""
        return _KINDS[self.kind].formula

    @property
    def scaled(self) -> bool:
        """Whether it has a scale."""
        return _KINDS[self.kind].scaled

    @property
    def power(self) -> int:
        """Of speed that it grows with."""
        return _KINDS[self.kind].power

    @property
    def shrink(self) -> float:
        """Share of its column's squares that draws its coefficient towards zero: effects that are nearly alike in the log,
        and far from it in other motion, share what they explain instead of growing against each other.
        """
        return _SHRINK * _KINDS[self.kind].growth

    @property
    def code(self) -> int:
        """The number by which the compiled loops know it. Raises ParameterError for one that a state does not tell."""
        if self.kind in _OF_PATH:
            raise ParameterError(f"effect '{self.kind}' depends on the path or the load, which no state tells")
        return list(_KINDS).index(self.kind)

    def name(self, number: int) -> str:
        """Its coefficient's name at drive `number` (from 1): f1_2, I3m, ft0.05_1."""
        kind = _KINDS[self.kind]
        if "{}" in kind.symbol:
            return kind.symbol.format(number)
        return f"{kind.symbol}{f'{self.scale:.3g}' if kind.scaled and self.kind != 'load' else ''}_{number}"

    def unit(self, prismatic: bool) -> str:
        """The unit of its coefficient."""
        force, travel, inertia = ("N", "m", "kg") if prismatic else ("N m", "rad", "kg m^2")
        words = {"F": force, "L": travel, "I": inertia}
        return "".join(words.get(letter, letter) for letter in _KINDS[self.kind].unit)

    def column(self, q: Array, v: Array, a: Array, rest: float = 0.0, load: Array | None = None) -> Array:
        """(S,) torque for a coefficient of one, along a motion of the drive: position, speed, acceleration (S,).

        Below `rest` the sign of a speed fades linearly to zero. `load` (S,) is what the gear carries; effects of it are zero
        without.
        """
        if self.kind == "hysteresis":
            return stop_operator(q, self.scale)
        if self.kind in OF_LOAD:
            carried = np.zeros_like(v) if load is None else load
            return carried if self.kind == "gain" else np.abs(carried) * np.tanh(v / self.scale)
        column = np.empty(len(v))
        q, v, a = (np.ascontiguousarray(x) for x in (q, v, a))
        _of_states(self.code, q, v, a, self.scale, rest, column)
        return column


PAPER = ("coulomb", "viscous", "quadratic")


@njit(cache=True, nogil=True, fastmath={"contract"})
def of_state(code: int, q: float, v: float, a: float, scale: float, rest: float) -> float:
    """The torque of one unit of an effect at position q, speed v, acceleration a; codes in the order of the kinds."""
    if code in (0, 9):  # rotor, lag
        return a
    if code == 2:  # viscous
        return v
    sign = min(max(v / rest, -1.0), 1.0) if rest > 0.0 else (1.0 if v > 0.0 else (-1.0 if v < 0.0 else 0.0))
    if code == 1:  # coulomb
        return sign
    if code == 3:  # quadratic
        return sign * v * v
    if code == 4:  # offset
        return 1.0
    if code == 5:  # saturating
        return np.tanh(v / scale)
    if code == 6:  # root
        return sign * np.sqrt(abs(v))
    if code == 14:  # sine
        return np.sin(q)
    if code == 15:  # cosine
        return np.cos(q)
    return abs(v) if code == 7 else q  # asymmetric, springs


@njit(cache=True, nogil=True)
def _of_states(code: int, q: Array, v: Array, a: Array, scale: float, rest: float, out: Array) -> None:
    for s in range(len(out)):
        out[s] = of_state(code, q[s], v[s], a[s], scale, rest)


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
