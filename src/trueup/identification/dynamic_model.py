# SPDX-License-Identifier: Apache-2.0
"""A robot's dynamic model: torque as columns of inertia, rotors, friction and couplings, with names and units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trueup.errors import ParameterError
from trueup.identification import regressors
from trueup.identification.base_parameters import BaseParameters, base_parameters
from trueup.identification.friction import PAPER, Coupling, Term
from trueup.identification.inertial import UNITS
from trueup.identification.kinematic_tree import KinematicTree

Array = NDArray[np.float64]

_INERTIAL = ("m{}", "mc{}x", "mc{}y", "mc{}z", "I{}xx", "I{}xy", "I{}yy", "I{}xz", "I{}yz", "I{}zz")


@dataclass(frozen=True)
class Column:
    """One parameter: `kind` is 'inertial', 'rotor', 'friction' or 'coupling'; `joint` the index that it belongs to."""

    name: str
    unit: str
    kind: str
    joint: int
    term: Term | None = None
    coupling: Coupling | None = None


@dataclass(frozen=True, eq=False)
class DynamicModel:
    """torque (S, n) = regressor (S, n, p) @ parameters (p,), for a tree with drives and friction."""

    tree: KinematicTree
    columns: tuple[Column, ...]
    rest: float = 0.0
    """Below this speed (rad/s, m/s) the sign of a velocity fades linearly to zero."""

    @classmethod
    def of(
        cls, tree: KinematicTree, friction: Sequence[str | Term] | Sequence[Sequence[str | Term]] = PAPER, *,
        rotors: bool | Sequence[bool] = True, couplings: Sequence[Coupling] = (), rest: float = 0.0,
    ) -> DynamicModel:  # fmt: skip
        """The model of a tree with the same friction terms for all joints, or a list of them for each.

        Columns: ten a link, link by link; rotor inertias; friction term by term, joint by joint; for each coupling a
        rotor inertia and friction that act on both of its joints. Raises ParameterError where lists do not fit.
        """
        n = tree.n
        terms = _per_joint(friction, n, tree.joints)
        with_rotor = np.broadcast_to(np.asarray(rotors, dtype=bool), (n,))
        columns = [
            Column(name.format(j + 1), unit, "inertial", j)
            for j in range(n) for name, unit in zip(_INERTIAL, UNITS, strict=True)
        ]  # fmt: skip
        columns += [Column(f"I{j + 1}m", _inertia_unit(tree, j), "rotor", j) for j in range(n) if with_rotor[j]]
        for term in dict.fromkeys(term for each in terms for term in each):
            columns += [
                Column(f"{term.symbol}_{j + 1}", term.unit(bool(tree.prismatic[j])), "friction", j, term)
                for j in range(n) if term in terms[j]
            ]  # fmt: skip
        for c in couplings:
            label, slides = f"{c.drive + 1}{c.joint + 1}", bool(tree.prismatic[c.drive])
            columns.append(Column(f"I{label}m", _inertia_unit(tree, c.drive), "coupling", c.drive, None, c))
            for term in terms[c.drive]:
                if term.kind != "offset":
                    columns.append(Column(f"{term.symbol}_{label}", term.unit(slides), "coupling", c.drive, term, c))
        return cls(tree, tuple(columns), rest)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the p parameters: m1, mc1x, ..., I1xx, ..., I1m, ..., f0_1, ..."""
        return tuple(c.name for c in self.columns)

    @property
    def p(self) -> int:
        """The number of parameters."""
        return len(self.columns)

    def index(self, name: str) -> int:
        """The place of a parameter."""
        return self.names.index(name)

    def regressor(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> Array:
        """(S, n, p) at joint positions, velocities, accelerations (S, n); memory runs along the samples."""
        rigid = regressors.regressor(self.tree, q, qd, qdd)
        v, a = np.atleast_2d(np.asarray(qd, dtype=float)), np.atleast_2d(np.asarray(qdd, dtype=float))
        S, n = v.shape
        full = np.zeros((n, self.p, S))
        full[:, : 10 * n] = np.moveaxis(rigid, 0, -1)
        for k, c in enumerate(self.columns[10 * n :], 10 * n):
            if c.coupling is None:
                full[c.joint, k] = a[:, c.joint] if c.term is None else c.term.column(v[:, c.joint], self.rest)
                continue
            d, j, ratio = c.coupling.drive, c.coupling.joint, c.coupling.ratio
            both = a[:, d] + ratio * a[:, j] if c.term is None else c.term.column(v[:, d] + ratio * v[:, j], self.rest)
            full[d, k], full[j, k] = both, ratio * both
        return np.moveaxis(full, -1, 0)

    def grams(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike, columns: ArrayLike | None = None) -> Array:
        """(B, n, p, p) one Gram matrix for each joint and individual, from motions (B, S, n); `columns` picks some."""
        batches = [np.asarray(x, dtype=float) for x in (q, qd, qdd)]
        chosen = np.arange(self.p) if columns is None else np.asarray(columns)
        grams = np.empty((len(batches[0]), self.tree.n, len(chosen), len(chosen)))
        for b, one in enumerate(zip(*batches, strict=True)):
            Y = np.moveaxis(self.regressor(*one), 0, -1)[:, chosen]
            grams[b] = Y @ np.swapaxes(Y, -1, -2)
        return grams

    def nominal(self) -> Array:
        """(p,) the file's inertial parameters and rotor inertias, zero friction. Raises ModelError for unweighed links."""
        rotors = [self.tree.armature[c.joint] if c.kind == "rotor" else 0.0 for c in self.columns[10 * self.tree.n :]]
        return np.concatenate([self.tree.weighed().ravel(), rotors])

    def base(self, seed: int = 0, samples: int = 0, preference: Array | None = None) -> BaseParameters:
        """The combinations that torque can tell, from random states over the joint ranges."""
        rng, n = np.random.default_rng(seed), self.tree.n
        count = samples or 20 * self.p // n
        q = rng.uniform(-np.pi, np.pi, (count, n))
        qd, qdd = rng.uniform(-2.0, 2.0, (count, n)), rng.uniform(-5.0, 5.0, (count, n))
        return base_parameters(self.regressor(q, qd, qdd).reshape(-1, self.p), self.names, preference)


def _inertia_unit(tree: KinematicTree, j: int) -> str:
    return "kg" if tree.prismatic[j] else "kg m^2"


def _per_joint(friction: Sequence[object], n: int, joints: tuple[str, ...]) -> list[tuple[Term, ...]]:
    """Terms of each joint, from one list for all or a list of lists."""
    if all(isinstance(t, str | Term) for t in friction):
        friction = [friction] * n
    if len(friction) != n:
        raise ParameterError(f"friction is given for {len(friction)} joints; there are {n}: {', '.join(joints)}")
    return [tuple(Term(t) if isinstance(t, str) else t for t in each) for each in friction]  # type: ignore[union-attr]
