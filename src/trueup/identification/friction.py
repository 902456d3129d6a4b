# SPDX-License-Identifier: Apache-2.0
"""Friction and drive terms of a joint, each a column that is linear in its coefficient."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from trueup.errors import ParameterError, unknown_name

Array = NDArray[np.float64]


def _forward(value: Array) -> Array:
    return np.maximum(value, 0.0)


def _backward(value: Array) -> Array:
    return np.minimum(value, 0.0)


# kind -> symbol of its coefficient, power of speed in its unit, column from (speed, its sign, speed of the term)
_Column = Callable[[Array, Array, float], Array]
_KINDS: Mapping[str, tuple[str, int, _Column]] = MappingProxyType(
    {
        "coulomb": ("f0", 0, lambda v, s, v0: s),
        "viscous": ("f1", 1, lambda v, s, v0: v),
        "quadratic": ("f2", 2, lambda v, s, v0: s * v * v),
        "offset": ("fo", 0, lambda v, s, v0: np.ones_like(v)),
        "coulomb_forward": ("f0+", 0, lambda v, s, v0: _forward(s)),
        "coulomb_backward": ("f0-", 0, lambda v, s, v0: _backward(s)),
        "viscous_forward": ("f1+", 1, lambda v, s, v0: _forward(v)),
        "viscous_backward": ("f1-", 1, lambda v, s, v0: _backward(v)),
        "cubic": ("f3", 3, lambda v, s, v0: v**3),
        "stribeck": ("fs", 0, lambda v, s, v0: s * np.exp(-((v / v0) ** 2))),
        "saturating": ("ft", 0, lambda v, s, v0: np.tanh(v / v0)),
    }
)
_NEEDS_SPEED = ("stribeck", "saturating")


@dataclass(frozen=True)
class Term:
    """One friction term; `speed` in rad/s (m/s) is where a Stribeck term decays, or a saturating one saturates.

    The papers' model (evolved trajectories, eq. 2) is coulomb, viscous, quadratic:
    f0 sign(qd) + f1 qd + f2 sign(qd) qd^2. Raises UnknownNameError, or ParameterError without a speed where one is needed.
    """

    kind: str
    speed: float = float("nan")

    def __post_init__(self) -> None:
        """Checks kind and speed."""
        if self.kind not in _KINDS:
            raise unknown_name("friction term", self.kind, _KINDS, "the list")
        if self.kind in _NEEDS_SPEED and not self.speed > 0.0:
            raise ParameterError(f"friction term '{self.kind}' needs a speed above 0 rad/s, got {self.speed}")

    @property
    def symbol(self) -> str:
        """The name of its coefficient: f0, f1, f2, ..."""
        return _KINDS[self.kind][0]

    @property
    def code(self) -> int:
        """The number by which the compiled loops know it, from 1."""
        return list(_KINDS).index(self.kind) + 1

    def unit(self, prismatic: bool) -> str:
        """The unit of its coefficient."""
        power, force, speed = _KINDS[self.kind][1], "N" if prismatic else "N m", "m" if prismatic else "rad"
        exponent = "" if power == 1 else f"^{power}"
        return force if power == 0 else f"{force} s{exponent}/{speed}{exponent}"

    def column(self, speed: Array, rest: float = 0.0) -> Array:
        """The torque that a coefficient of one gives at `speed` (...); below `rest` the sign fades linearly to zero."""
        sign = np.clip(speed / rest, -1.0, 1.0) if rest > 0.0 else np.sign(speed)
        return _KINDS[self.kind][2](speed, sign, self.speed)


def stribeck_speed(
    speed: Array, torque: Array, others: Array, low: float = 1e-3, high: float = 1.0
) -> tuple[float, float]:
    """The speed v0 at which a Stribeck term explains most of one joint's torque beyond other columns, and its share.

    The second, nonlinear step after a linear fit: for each v0 in [low, high] rad/s the best coefficients follow by
    linear least squares (variable projection, Golub & Pereyra 1973), so only v0 is searched. speed, torque (S,);
    others (S, k) all other columns of this joint, the Coulomb and viscous ones among them. The share is of the squared
    residual that is left without the term: near 0 the data show no Stribeck effect, and v0 means nothing.
    """
    basis = np.linalg.qr(others)[0]
    left = torque - basis @ (basis.T @ torque)

    def explained(log_v0: float) -> float:
        column = Term("stribeck", float(np.exp(log_v0))).column(speed)
        column = column - basis @ (basis.T @ column)
        length = column @ column
        return float((column @ left) ** 2 / length) if length > 1e-12 * len(speed) else 0.0

    grid = np.linspace(np.log(low), np.log(high), 40)
    best = int(np.argmax([explained(x) for x in grid]))
    ends = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    from scipy.optimize import minimize_scalar  # half a second to load, and rarely needed

    found = minimize_scalar(lambda x: -explained(x), bounds=ends, method="bounded")
    return float(np.exp(found.x)), explained(float(found.x)) / max(float(left @ left), np.finfo(float).tiny)


PAPER = (Term("coulomb"), Term("viscous"), Term("quadratic"))
COMMON = (Term("coulomb"), Term("viscous"), Term("offset"))


@dataclass(frozen=True)
class Coupling:
    """A drive that turns with two joints: drive `drive` moves with q[drive] + ratio q[joint], as in many wrists.

    Its rotor inertia and friction then load both joints (by `ratio` the second one).
    """

    drive: int
    joint: int
    ratio: float = 1.0
