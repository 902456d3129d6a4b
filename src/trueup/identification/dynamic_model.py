# SPDX-License-Identifier: Apache-2.0
"""Torque as columns: ten inertial parameters a link and the effects of each drive.

Compiled and batched where the state is all, as for the design of motions; as sparse rows along a log, where effects may
depend on the path (hysteresis), and, once a first fit tells what gears carry, on the load.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from trueup.arrays import Array, Integers, Mask
from trueup.errors import ModelError, ParameterError
from trueup.identification import regressors
from trueup.identification.base_parameters import BaseParameters, base_parameters
from trueup.identification.blocks import Layout, layout
from trueup.identification.effects import PAPER, Effect
from trueup.identification.inertial import NAMES, UNITS, link_names
from trueup.identification.information import information
from trueup.identification.kinematic_tree import KinematicTree
from trueup.identification.rows import Rows


@dataclass(frozen=True, eq=False)
class DynamicModel:
    """torque (S, n) = regressor (S, n, p) @ parameters (p,); drives turn with joints as `drives` says."""

    tree: KinematicTree
    effects: tuple[tuple[int, Effect], ...]
    """(drive, effect), in the order of their columns behind the 10 n inertial ones."""
    drives: Array
    """(n, n) speeds of the drives, geared to their joints, for speeds of the joints; the identity without couplings."""
    rest: float = 0.0
    """Below this speed (rad/s, m/s) the sign of a velocity fades linearly to zero."""

    @classmethod
    def of(
        cls, tree: KinematicTree, effects: Sequence[tuple[int, Effect]], drives: Array | None = None, rest: float = 0.0
    ) -> DynamicModel:  # fmt: skip
        """The model with these effects; `drives` defaults to one drive a joint."""
        return cls(tree, tuple(effects), np.eye(tree.n) if drives is None else np.asarray(drives, dtype=float), rest)

    @classmethod
    def with_friction(
        cls, tree: KinematicTree, friction: Sequence[str | Effect] | Sequence[Sequence[str | Effect]] = PAPER, *,
        rotors: bool | Sequence[bool] = True, drives: Array | None = None, rest: float = 0.0,
    ) -> DynamicModel:  # fmt: skip
        """The model with rotors and the same friction in all drives, or a list of it for each; term by term.

        Raises ParameterError where lists do not fit, UnknownNameError for a friction that is not known.
        """
        terms = _per_joint(friction, tree.n, tree.joints)
        turning = np.broadcast_to(np.asarray(rotors, dtype=bool), (tree.n,)).tolist()
        effects = [(j, Effect("rotor")) for j in range(tree.n) if turning[j]]
        for term in dict.fromkeys(term for each in terms for term in each):
            effects += [(j, term) for j in range(tree.n) if term in terms[j]]
        return cls.of(tree, effects, drives, rest)

    @property
    def p(self) -> int:
        """The number of columns."""
        return 10 * self.tree.n + len(self.effects)

    @property
    def names(self) -> tuple[str, ...]:
        """m1, mc1x, ..., I1xx, ..., then I1m, f1_1, ..."""
        return (*link_names(self.tree.n), *(effect.name(d + 1) for d, effect in self.effects))

    @property
    def units(self) -> tuple[str, ...]:
        """The unit of each column's parameter."""
        drives = [effect.unit(bool(self.tree.prismatic[d])) for d, effect in self.effects]
        return (*(UNITS * self.tree.n), *drives)

    @property
    def shrink(self) -> Array:
        """(p,) what draws each parameter towards zero: nothing for bodies and rotors, a little for effects."""
        return np.array([0.0] * (10 * self.tree.n) + [effect.shrink for _, effect in self.effects])

    def effect(self, column: int) -> tuple[int, Effect | None]:
        """Drive and effect of a column; link and None for an inertial one."""
        behind = column - 10 * self.tree.n
        return self.effects[behind] if behind >= 0 else (column // 10, None)

    def columns_of(self, *kinds: str) -> Integers:
        """The columns of effects of these kinds."""
        found = [10 * self.tree.n + k for k, (_, effect) in enumerate(self.effects) if effect.kind in kinds]
        return np.array(found, dtype=np.int64)

    @cached_property
    def friction(self) -> Mask:
        """(p,) which columns are effects other than rotors."""
        rotors = np.array([effect.kind != "rotor" for _, effect in self.effects], dtype=bool)
        return np.concatenate([np.zeros(10 * self.tree.n, dtype=bool), rotors])

    def only(self, keep: Sequence[int]) -> DynamicModel:
        """With these of the effects only (indices into `effects`)."""
        return replace(self, effects=tuple(self.effects[k] for k in keep))

    def regressor(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> Array:
        """(S, n, p) at joint positions, velocities, accelerations (S, n); memory runs along the samples."""
        q_, qd_, qdd_ = regressors.samples(self.tree, q, qd, qdd)
        return regressors.filled(self.layout, q_, qd_, qdd_)

    def information(
        self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike, weights: ArrayLike, columns: ArrayLike | None = None, *,
        threads: int = 1,
    ) -> Array:  # fmt: skip
        """(B, c, c) sum_i weights[i]^2 Y_i^t Y_i of motions (B, S, n), without the regressor Y itself.

        `weights` (n,) multiply the rows of the joints; `columns` (c,) picks some (base: `base().independent`). Raises
        ModelError where shapes do not fit.
        """
        batch = [np.ascontiguousarray(np.asarray(x, dtype=float)) for x in (q, qd, qdd)]
        chosen = np.arange(self.p) if columns is None else np.asarray(columns, dtype=np.int64)
        if any(x.ndim != 3 or x.shape != batch[0].shape or x.shape[2] != self.tree.n for x in batch):
            shapes = ", ".join(str(x.shape) for x in batch)
            raise ModelError(
                f"motions of '{self.tree.name}' must be (individuals, samples, {self.tree.n}), got {shapes}"
            )
        squared = np.asarray(weights, dtype=float) ** 2
        return information(self.layout, self.acts[:, chosen], chosen, squared, batch, threads)

    @cached_property
    def layout(self) -> Layout:
        """The model as the compiled loops want it."""
        return layout(self.tree, tuple((e.code, d, e.scale) for d, e in self.effects), self.drives, self.rest)

    @cached_property
    def acts(self) -> Mask:
        """(n, p) whether the torque of a joint may depend on a column at all."""
        links = np.repeat(self.tree.carries(), len(NAMES), axis=1)
        turned = self.drives[[d for d, _ in self.effects]].T.reshape(self.tree.n, -1) != 0.0
        return np.hstack([links, turned])

    def rows(self, time: Array, q: Array, v: Array, a: Array, torque: Array | None = None) -> Rows:
        """The regressor along a motion (S, n) of the joints; not filtered."""
        n = self.tree.n
        rigid = np.moveaxis(regressors.regressor(self.tree, q, v, a), 0, -1)  # (n, 10 n, S)
        carried = np.repeat(self.tree.carries(), len(NAMES), axis=1)
        columns: list[list[int]] = [np.flatnonzero(carried[j]).tolist() for j in range(n)]
        values = [[rigid[j, columns[j]]] for j in range(n)]
        drive_q, drive_v, drive_a = (x @ self.drives.T for x in (q, v, a))
        for k, (d, effect) in enumerate(self.effects):
            own = effect.column(drive_q[:, d], drive_v[:, d], drive_a[:, d], self.rest)
            for j in np.flatnonzero(self.drives[d]):
                columns[int(j)].append(10 * n + k)
                values[j].append(self.drives[d, j] * own[None])
        return Rows(
            tuple(np.array(c) for c in columns), tuple(np.concatenate(x) for x in values),
            np.full(q.shape, np.nan) if torque is None else torque, time, self.p, self.shrink,
        )  # fmt: skip

    def carried(self, inertial: Array, q: Array, v: Array, a: Array) -> Array:
        """(S, n) torque that the gear of each drive carries with links `inertial` (n, 10), along a motion (S, n)."""
        torque = regressors.inverse_dynamics(self.tree, inertial, q, v, a)
        return torque @ np.linalg.inv(self.drives)

    def nominal(self) -> Array:
        """(p,) the file's inertial parameters and rotor inertias, zero for the rest. Raises ModelError for a link without."""
        rotors = [self.tree.armature[d] if e.kind == "rotor" else 0.0 for d, e in self.effects]
        return np.concatenate([self.tree.weighed().ravel(), rotors])

    def base(self, preference: ArrayLike | None = None, seed: int = 0) -> BaseParameters:
        """The combinations that torque can tell, from random states; checked to give the same torque in others.

        `preference` (p,): a higher value makes a parameter stand for its group. Effects of the path are independent of all
        that depends on the state, and are not asked. Raises ModelError where the rank is not clear, ParameterError for them.
        """
        rng = np.random.default_rng(seed)
        base = base_parameters(self._excited(rng), self.names, preference)
        fresh, values = self._excited(rng), rng.normal(size=self.p)
        torque, reduced = fresh @ values, base.reduce(fresh) @ base.of(values)
        if (error := np.abs(torque - reduced).max() / np.abs(torque).max()) > 1e-2:
            raise ModelError(f"base parameters of '{self.tree.name}' change its torque by {error:.1e}")
        return base

    def _excited(self, rng: np.random.Generator) -> Array:
        """(count n, p) regressor at random states, six rows a column or more: accelerations as large as squares of speeds."""
        count = max(40, 6 * self.p // self.tree.n)
        states = (rng.uniform(-size, size, (count, self.tree.n)) for size in (np.pi, np.pi, np.pi**2))
        return self.regressor(*states).reshape(-1, self.p)


def _per_joint(friction: Sequence[object], n: int, joints: tuple[str, ...]) -> list[tuple[Effect, ...]]:
    """Friction of each joint, from one list for all or a list of lists."""
    if all(isinstance(t, str | Effect) for t in friction):
        friction = [friction] * n
    if len(friction) != n:
        raise ParameterError(f"friction is given for {len(friction)} joints; there are {n}: {', '.join(joints)}")
    return [tuple(Effect(t) if isinstance(t, str) else t for t in each) for each in friction]  # type: ignore[union-attr]
