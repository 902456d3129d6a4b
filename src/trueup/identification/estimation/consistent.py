# SPDX-License-Identifier: Apache-2.0
"""The best fit among bodies that can exist: each link a mass distribution without negative mass (interior points)."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array, Integers, Mask
from trueup.errors import IdentificationError
from trueup.identification.dynamic_model import DynamicModel
from trueup.identification.estimation.moments import Normal
from trueup.identification.inertial import NAMES, about_com, from_pseudo_inertia, pseudo_inertia
from trueup.rounding import NEGLIGIBLE, PRINTED, ROUNDED

_MARGIN = 1e-4
"""The least second moment, as a share of a link's natural size: simulators want inertias above zero."""
_THIN = 0.01
"""The least second moment of a link in the model file, likewise: files give bodies without extent."""
PULL = 1e-4
"""Towards the model file: its weight, as a share of the squared error that is left without constraints."""
NEAREST = 100.0 * PULL
"""The strongest that fits try: it stays where no weaker one is clearly better, as where the file is off by a fifth."""
_FIRST, _NEAR, _COOLING, _ROUGH, _EXACT = 0.1, 1e-3, 0.1, 0.3, 1e-3
_ROTOR = 10.0
"""Times a link's mass times its squared length: how large rotors may be, seen from the joint, where the file has none."""
_BASIS = pseudo_inertia(np.eye(len(NAMES)))  # (10, 4, 4)


@dataclass(frozen=True, eq=False)
class ConsistentFit:
    """Parameters (p,) of possible bodies, and the links (indices) that stopped at the edge of what is possible."""

    parameters: Array
    boundary: tuple[int, ...]
    lagging: tuple[int, ...] = ()
    """Drives whose torque was allowed to fall with acceleration."""


def consistent_fit(
    model: DynamicModel, normal: Normal, active: Integers, prior: Array, *, pull: float = PULL,
    lagging: Collection[int] = (), near: ConsistentFit | None = None, positive: Integers | None = None,
) -> ConsistentFit:  # fmt: skip
    """Minimises the weighted squares over all inertial parameters and the `active` effects, with each link possible.

    `normal` are the weighted normal equations, `prior` (p,) is the model file. Pseudo-inertias S of links stay above zero
    (Wensing, Kim & Slotine, "Linear matrix inequalities for physically consistent inertial parameter identification",
    IEEE RA-L 3(1), 2018, eq. 15), rotor inertias too. `pull` weighs the distance tr(S0^-1 S) - log det S to the file's
    bodies S0, the same in any unit and frame (Lee, Wensing & Park, "Geometric robot dynamic identification: a convex
    programming approach", IEEE T-RO 36(2), 2020, section IV): it decides what torque cannot tell, and is the barrier of
    the interior-point method as well.
    The torque of drives in `lagging` may fall with acceleration: what is below zero is their effect "lag", which is no
    rotor. `near` is a fit of a similar problem to start from. Effects `positive` (columns) stay above zero, as friction does
    in simulators; `prior` has their sizes. Raises IdentificationError where no minimum is found.
    """
    n = model.tree.n
    # Rotors count even where torque cannot tell them from a link: a link cannot be as slender as a rotor is.
    rotors = model.columns_of("rotor")
    more = np.concatenate([rotors, np.zeros(0, dtype=np.int64) if positive is None else positive])
    bodies = np.concatenate([np.arange(10 * n), more])
    rest = np.setdiff1d(active, bodies)
    problem = _Squares.of(normal, bodies, rest)
    drives = [model.effect(int(k))[0] for k in rotors]
    held = np.ones(len(more), dtype=bool)
    held[: len(rotors)] = [d not in lagging for d in drives]
    barrier = _Barrier.of(model, prior, held, more)
    # Exact logs have no error left to compare with.
    least = max(problem.least(), PRINTED * float(normal.square))
    starts = [(barrier.start, _FIRST)]
    if near is not None:
        starts.insert(0, (barrier.inside(_joined(model, near.parameters)[bodies]), _NEAR))
    ends = (_followed(problem, barrier, x, first * (problem.at(x) - least), pull * least) for x, first in starts)
    x = next((end for end in ends if end is not None), None)
    if x is None:
        raise IdentificationError("no physically consistent model was found: is the model file that of this arm?")
    parameters = np.zeros(model.p)
    parameters[bodies], parameters[rest] = x, problem.back @ np.append(x, 1.0)
    for k in (int(k) for k in model.columns_of("lag")):
        drive = model.effect(k)[0]
        if drive in lagging:
            own = int(rotors[drives.index(drive)])
            parameters[k], parameters[own] = min(parameters[own], 0.0), max(parameters[own], 0.0)
    return ConsistentFit(parameters, tuple(barrier.boundary(x)), tuple(sorted(lagging)))


def prior_information(model: DynamicModel, prior: Array) -> Array:
    """(p, p) what one unit of `pull`, for one independent error of one standard deviation, tells of bodies and rotors: the
    curvature at the file of the distance to it, see `consistent_fit`.
    """
    rotors = model.columns_of("rotor")
    barrier = _Barrier.of(model, prior, np.ones(len(rotors), dtype=bool), rotors)
    at, made = np.concatenate([np.arange(10 * model.tree.n), rotors]), np.zeros((model.p, model.p))
    made[np.ix_(at, at)] = 0.5 * barrier._derivatives(barrier.start)[1]
    return made


def _followed(problem: _Squares, barrier: _Barrier, start: Array, weight: float, last: float) -> Array | None:
    """The minimiser at the weight `last`, from a weight at which `start` is good: each is near the next. None: got lost."""
    x: Array | None = start
    while weight > 2.0 * last and x is not None:
        x = barrier.minimised(problem, x, weight, _ROUGH)
        weight = max(_COOLING * weight, last)
    return None if x is None else barrier.minimised(problem, x, last, _EXACT)


def _joined(model: DynamicModel, parameters: Array) -> Array:
    """Parameters with what falls with acceleration counted as rotors again."""
    joined = parameters.copy()
    rotors = {model.effect(int(k))[0]: int(k) for k in model.columns_of("rotor")}
    for k in (int(k) for k in model.columns_of("lag")):
        joined[rotors[model.effect(k)[0]]] += parameters[k]
    return joined


@dataclass(frozen=True, eq=False)
class _Squares:
    """x P x + 2 q x + constant: the weighted squares as a function of the bodies (m,), all else at its best."""

    P: Array
    q: Array
    constant: float
    back: Array
    """The rest is back @ (x, 1)."""

    @classmethod
    def of(cls, normal: Normal, bodies: Integers, rest: Integers) -> _Squares:
        """The rest solved for: the bodies see its Schur complement."""
        gram, cross = normal.gram, normal.cross
        mixed, own = gram[np.ix_(rest, bodies)], gram[np.ix_(rest, rest)]
        back = -_solved(own, np.column_stack([mixed, -cross[rest]]))
        P, q = gram[np.ix_(bodies, bodies)] + mixed.T @ back[:, :-1], mixed.T @ back[:, -1] - cross[bodies]
        return cls(P, q, float(normal.square) - float(cross[rest] @ back[:, -1]), back)

    def at(self, x: Array) -> float:
        """The weighted squares."""
        return float(x @ self.P @ x + 2.0 * self.q @ x) + self.constant

    def least(self) -> float:
        """What is left of them when nothing constrains the bodies."""
        return self.constant - float(self.q @ _solved(self.P, self.q[:, None])[:, 0])


def _solved(gram: Array, right: Array) -> Array:
    """(m, k) solutions, of columns of any size; what cannot be told stays small."""
    scale = np.divide(1.0, np.sqrt(np.diag(gram)), out=np.zeros(len(gram)), where=np.diag(gram) > 0.0)
    full = gram * scale[:, None] * scale + ROUNDED * np.eye(len(gram))
    return np.asarray(np.linalg.solve(full, right * scale[:, None]) * scale[:, None], dtype=np.float64)


@dataclass(frozen=True, eq=False)
class _Barrier:
    """tr(S0^-1 S) - log det(S - margin) of each link and r / r0 - log r of each rotor, as a function of the bodies (m,)."""

    start: Array
    """(m,) the file's bodies."""
    slope: Array
    """(m,) of the linear terms."""
    margin: Array
    """(n, 4, 4)."""
    held: Mask
    """(m,) rotors and friction that may not be negative."""
    free: Array
    """(m,) curvature for rotors that may: what torque cannot tell of them is zero."""

    @classmethod
    def of(cls, model: DynamicModel, prior: Array, held: Mask, rotors: Integers) -> _Barrier:
        n = model.tree.n
        reach, mass = np.maximum(np.linalg.norm(model.tree.offset, axis=1), 0.05), np.maximum(prior[: 10 * n : 10], 0.1)
        units = np.column_stack([reach, reach, reach, np.ones(n)]) * np.sqrt(mass)[:, None]
        natural = units[:, :, None] * units[:, None, :]
        size, axes = np.linalg.eigh(pseudo_inertia(prior[: 10 * n].reshape(n, 10)) / natural)
        file = (axes * np.maximum(size, _THIN)[:, None]) @ axes.transpose(0, 2, 1) * natural
        usual = _ROTOR * (mass * reach**2)[[model.effect(int(k))[0] for k in rotors]]
        usual = np.where(prior[rotors] > 0.0, prior[rotors], usual)
        slope = np.einsum("jab,iba->ji", np.linalg.inv(file), _BASIS).ravel()
        none = np.zeros(10 * n)
        return cls(
            np.concatenate([from_pseudo_inertia(file).ravel(), usual]), np.concatenate([slope, held / usual]),
            _MARGIN * np.eye(4) * natural, np.concatenate([none, held]) > 0.0, np.concatenate([none, ~held / usual**2]),
        )  # fmt: skip

    def inside(self, x: Array) -> Array:
        """Bodies near `x` that are possible."""
        x = np.where(self.held, np.maximum(x, PRINTED * self.start), x)
        links = self._inner(x)
        bad = np.linalg.eigvalsh(links)[:, 0] <= 0.0
        x[: 10 * len(links)] = np.where(np.repeat(bad, 10), self.start[: 10 * len(links)], x[: 10 * len(links)])
        return x

    def minimised(self, squares: _Squares, x: Array, weight: float, exact: float) -> Array | None:
        """The minimiser of the squares + weight times this, from `x` inside, to `exact` of the weight (Newton).

        Boyd & Vandenberghe, "Convex Optimization", 2004, section 9.5. None where a step is not finite.
        """
        steps = 200
        # Half of all, as derivatives like it.
        half = 0.5 * weight
        P, linear = squares.P + half * np.diag(self.free), squares.q + half * self.slope
        value = self._value(P, linear, x, half)
        for _ in range(steps):
            slope, bend = self._derivatives(x)
            g, H = P @ x + linear + half * slope, P + half * bend
            scale = 1.0 / np.sqrt(np.diag(H))
            step = -scale * np.linalg.solve(H * scale[:, None] * scale, scale * g)
            gain, share = float(-g @ step), 1.0
            if not np.isfinite(gain):
                return None
            if gain < max(exact * half, 1000.0 * np.finfo(float).eps * abs(value)):
                return x
            while (new := self._value(P, linear, x + share * step, half)) > value - 0.1 * share * gain:
                share *= 0.5
                if share < ROUNDED:  # no number is left between here and there
                    return x
            x, value = x + share * step, new
        # Bodies that torque hardly tells of may move on for hundreds of steps; these are possible, and nearly as good.
        return x

    def boundary(self, x: Array) -> list[int]:
        """Links (indices) that are no further from their margin than the margin is from what is impossible."""
        inner = self._inner(x) / np.sqrt(np.einsum("jaa,jbb->jab", self.margin, self.margin))
        return np.flatnonzero(np.linalg.eigvalsh(inner)[:, 0] < 1.0).tolist()

    def _inner(self, x: Array) -> Array:
        n = len(self.margin)
        return np.einsum("ji,iab->jab", x[: 10 * n].reshape(n, 10), _BASIS) - self.margin

    def _value(self, P: Array, linear: Array, x: Array, weight: float) -> float:
        """Infinite outside."""
        if np.any(x[self.held] <= 0.0):
            return np.inf
        try:
            root = np.linalg.cholesky(self._inner(x))
        except np.linalg.LinAlgError:
            return np.inf
        logs = 2.0 * np.log(np.diagonal(root, axis1=1, axis2=2)).sum() + np.log(x[self.held]).sum()
        return float(0.5 * x @ P @ x + linear @ x - weight * logs)

    def _derivatives(self, x: Array) -> tuple[Array, Array]:
        """(m,) and (m, m): first and second derivatives of the logarithms."""
        n = len(self.margin)
        turned = np.linalg.inv(self._inner(x))[:, None] @ _BASIS  # (n, 10, 4, 4)
        slope, bend = np.zeros(len(x)), np.zeros((len(x), len(x)))
        slope[: 10 * n] = -np.trace(turned, axis1=2, axis2=3).ravel()
        each = turned.reshape(n, 10, 16) @ turned.transpose(0, 1, 3, 2).reshape(n, 10, 16).transpose(0, 2, 1)
        for j in range(n):
            bend[10 * j : 10 * j + 10, 10 * j : 10 * j + 10] = each[j]
        slope[self.held], bend[self.held, self.held] = -1.0 / x[self.held], x[self.held] ** -2.0
        return slope, bend


def violations(model: DynamicModel, parameters: Array) -> dict[int, str]:
    """Links (by index) that no mass distribution has, with what is wrong; rotors are not looked at."""
    found = {j: violation(row) for j, row in enumerate(parameters[: 10 * model.tree.n].reshape(-1, 10))}
    return {j: why for j, why in found.items() if why}


def violation(row: Array) -> str:
    """What is wrong with a body (10,) that no mass distribution has; nothing for one that can exist."""
    mass, sigma = row[0], pseudo_inertia(row)
    if np.linalg.eigvalsh(sigma)[0] >= -ROUNDED * max(abs(sigma).max(), NEGLIGIBLE):
        return ""
    if mass <= 0.0:
        return f"mass {mass:.3g} kg"
    principal = np.linalg.eigvalsh(about_com(row)[2])
    if principal[0] < 0.0:
        return f"moment of inertia {principal[0]:.3g} kg m^2 about its centre of mass"
    return f"moments of inertia {', '.join(f'{m:.3g}' for m in principal)} kg m^2 break the triangle inequality"
