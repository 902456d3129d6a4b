# SPDX-License-Identifier: Apache-2.0
"""Torque as columns of a robot's state, known before it moves: what excitations are designed with.

Batched over motions and compiled, as a search wants it. What a log shows beside that, along a path and under load, is
in estimation/torque_model.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trueup.errors import ModelError, ParameterError
from trueup.identification import regressors
from trueup.identification.base_parameters import BaseParameters, base_parameters
from trueup.identification.blocks import Layout, layout
from trueup.identification.friction import PAPER, Coupling, Term
from trueup.identification.grams import structured_grams
from trueup.identification.inertial import UNITS, link_names
from trueup.identification.kinematic_tree import KinematicTree

Array = NDArray[np.float64]


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
            Column(name, unit, "inertial", k // 10)
            for k, (name, unit) in enumerate(zip(link_names(n), UNITS * n, strict=True))
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
        q_, qd_, qdd_ = regressors.samples(self.tree, q, qd, qdd)
        return regressors.filled(self.layout, q_, qd_, qdd_)

    def grams(
        self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike, columns: ArrayLike | None = None, *,
        lengths: ArrayLike | None = None, threads: int = 1,
    ) -> Array:  # fmt: skip
        """(B, n, p, p) Gram matrix of each joint's regressor rows, from motions (B, S, n), without the regressor itself.

        Sums over joints with any weights cost nothing more. `columns` picks some (base: `base().independent`);
        `lengths` (B,) counts the samples of each individual that are used. Raises ModelError where shapes do not fit.
        """
        batch = [np.ascontiguousarray(np.asarray(x, dtype=float)) for x in (q, qd, qdd)]
        chosen = np.arange(self.p) if columns is None else np.asarray(columns, dtype=np.int64)
        if any(x.ndim != 3 or x.shape != batch[0].shape or x.shape[2] != self.tree.n for x in batch):
            shapes = ", ".join(str(x.shape) for x in batch)
            raise ModelError(
                f"motions of '{self.tree.name}' must be (individuals, samples, {self.tree.n}), got {shapes}"
            )
        counts = np.broadcast_to(np.asarray(batch[0].shape[1] if lengths is None else lengths), (len(batch[0]),))
        return structured_grams(
            self.layout, batch[0], batch[1], batch[2], counts, chosen, self.acts[:, chosen], threads
        )

    @cached_property
    def layout(self) -> Layout:
        """The model as the compiled loops want it."""
        further = []
        for c in self.columns[10 * self.tree.n :]:
            code, speed = (c.term.code, c.term.speed) if c.term is not None else (0, 0.0)
            joint, ratio = (c.coupling.joint, c.coupling.ratio) if c.coupling is not None else (-1, 0.0)
            further.append((code, c.joint, joint, ratio, speed))
        return layout(self.tree, tuple(further), self.rest)

    @cached_property
    def acts(self) -> NDArray[np.bool_]:
        """(n, p) whether the torque of a joint may depend on a column at all."""
        acts = np.zeros((self.tree.n, self.p), dtype=bool)
        acts[:, : 10 * self.tree.n] = np.repeat(self.tree.carries(), 10, axis=1)
        for k, c in enumerate(self.columns[10 * self.tree.n :], 10 * self.tree.n):
            acts[c.joint, k] = True
            if c.coupling is not None:
                acts[c.coupling.joint, k] = True
        return acts

    def nominal(self) -> Array:
        """(p,) the file's inertial parameters and rotor inertias, zero friction. Raises ModelError for unweighed links."""
        rotors = [self.tree.armature[c.joint] if c.kind == "rotor" else 0.0 for c in self.columns[10 * self.tree.n :]]
        return np.concatenate([self.tree.weighed().ravel(), rotors])

    def base(self, preference: ArrayLike | None = None, seed: int = 0) -> BaseParameters:
        """The combinations that torque can tell, from random states; checked to give the same torque in others.

        `preference` (p,): a higher value makes a parameter stand for its group. Raises ModelError where the rank is
        not clear.
        """
        rng = np.random.default_rng(seed)
        count = max(40, 6 * self.p // self.tree.n)
        found = base_parameters(self._excited(count, rng), self.names, preference)
        fresh, values = self._excited(count, rng), rng.normal(size=self.p)
        torque, reduced = fresh @ values, found.reduce(fresh) @ found.of(values)
        if (error := np.abs(torque - reduced).max() / np.abs(torque).max()) > 1e-2:
            raise ModelError(f"base parameters of '{self.tree.name}' change its torque by {error:.1e}")
        return found

    def _excited(self, count: int, rng: np.random.Generator) -> Array:
        """(count n, p) regressor at random states, gravity and motion of like weight."""
        q, qd, qdd = (rng.uniform(-size, size, (count, self.tree.n)) for size in (np.pi, 3.0, 10.0))
        return self.regressor(q, qd, qdd).reshape(-1, self.p)


def _inertia_unit(tree: KinematicTree, j: int) -> str:
    return "kg" if tree.prismatic[j] else "kg m^2"


def _per_joint(friction: Sequence[object], n: int, joints: tuple[str, ...]) -> list[tuple[Term, ...]]:
    """Terms of each joint, from one list for all or a list of lists."""
    if all(isinstance(t, str | Term) for t in friction):
        friction = [friction] * n
    if len(friction) != n:
        raise ParameterError(f"friction is given for {len(friction)} joints; there are {n}: {', '.join(joints)}")
    return [tuple(Term(t) if isinstance(t, str) else t for t in each) for each in friction]  # type: ignore[union-attr]
