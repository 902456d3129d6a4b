# SPDX-License-Identifier: Apache-2.0
"""Torque along a log as columns: ten inertial parameters a link and the effects of each drive, sparse, filtered alike.

Effects may depend on the path (hysteresis) and on the load that a first fit finds, which no state tells; where the state
is all, as for the design of motions, dynamic_model.py has it batched.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueup.identification import regressors
from trueup.identification.base_parameters import BaseParameters, base_parameters
from trueup.identification.estimation.effects import OF_LOAD, Effect
from trueup.identification.inertial import NAMES, UNITS, link_names
from trueup.identification.kinematic_tree import KinematicTree

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True)
class Rows:
    """A regressor joint by joint, with the columns only that a joint's torque depends on, and the torque measured."""

    columns: tuple[Integers, ...]
    """For each joint the columns that are not zero."""
    values: tuple[Array, ...]
    """For each joint (p_j, S)."""
    torque: Array
    """(S, n) in N m (N); NaN where there is none."""
    time: Array
    """(S,) in s."""
    p: int
    shrink: Array | float = 0.0
    """(p,) share of its own squares that draws each parameter towards zero, see effects.shrink."""

    @property
    def length(self) -> int:
        """S, the number of samples."""
        return len(self.time)

    def predict(self, parameters: Array) -> Array:
        """(S, n) torque for parameters (p,)."""
        return np.stack([parameters[c] @ v for c, v in zip(self.columns, self.values, strict=True)], axis=1)

    def filtered(self, lowpass: Callable[..., Array], every: int) -> Rows:
        """Each column and the torque through the same filter, then every `every`-th sample of both."""
        values = tuple(np.ascontiguousarray(lowpass(v, axis=1)[:, ::every]) for v in self.values)
        torque = lowpass(self.torque, axis=0)[::every] if np.isfinite(self.torque).all() else self.torque[::every]
        return replace(self, values=values, torque=torque, time=self.time[::every])

    def part(self, keep: slice | Integers | NDArray[np.bool_]) -> Rows:
        """Some of the samples."""
        values = tuple(v[:, keep] for v in self.values)
        return replace(self, values=values, torque=self.torque[keep], time=self.time[keep])

    def loosened(self, share: float) -> Rows:
        """With `share` of what draws parameters towards zero."""
        return replace(self, shrink=share * self.shrink)

    def dense(self) -> Array:
        """(S, n, p) the whole regressor."""
        full = np.zeros((len(self.values), self.p, self.length))
        for j, (c, v) in enumerate(zip(self.columns, self.values, strict=True)):
            full[j, c] = v
        return np.moveaxis(full, -1, 0)


@dataclass(frozen=True, eq=False)
class TorqueModel:
    """torque = inertial columns of the tree + effects of the drives; drives turn with joints as `drives` says."""

    tree: KinematicTree
    effects: tuple[tuple[int, Effect], ...]
    """(drive, effect), in the order of their columns behind the 10 n inertial ones."""
    drives: Array
    """(n, n) speeds of the drives, geared to their joints, for speeds of the joints; the identity without couplings."""

    @classmethod
    def of(cls, tree: KinematicTree, effects: Sequence[tuple[int, Effect]], drives: Array | None = None) -> TorqueModel:
        """The model; `drives` defaults to one drive a joint."""
        return cls(tree, tuple(effects), np.eye(tree.n) if drives is None else drives)

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

    def only(self, keep: Sequence[int]) -> TorqueModel:
        """With these of the effects only (indices into `effects`)."""
        return replace(self, effects=tuple(self.effects[k] for k in keep))

    def rows(self, time: Array, q: Array, v: Array, a: Array, torque: Array | None = None) -> Rows:
        """The regressor along a motion (S, n) of the joints; not filtered."""
        n = self.tree.n
        rigid = np.moveaxis(regressors.regressor(self.tree, q, v, a), 0, -1)  # (n, 10 n, S)
        carried = np.repeat(self.tree.carries(), len(NAMES), axis=1)
        columns: list[list[int]] = [np.flatnonzero(carried[j]).tolist() for j in range(n)]
        values = [[rigid[j, columns[j]]] for j in range(n)]
        drive_q, drive_v, drive_a = (x @ self.drives.T for x in (q, v, a))
        for k, (d, effect) in enumerate(self.effects):
            own = effect.column(drive_q[:, d], drive_v[:, d], drive_a[:, d])
            for j in np.flatnonzero(self.drives[d]):
                columns[int(j)].append(10 * n + k)
                values[j].append(self.drives[d, j] * own[None])
        return Rows(
            tuple(np.array(c) for c in columns), tuple(np.concatenate(x) for x in values),
            np.full(q.shape, np.nan) if torque is None else torque, time, self.p, self.shrink,
        )  # fmt: skip

    def loaded(self, rows: Rows, inertial: Array, direction: Integers) -> Rows:
        """The rows with the columns of OF_LOAD effects, for bodies (10 n,) that a first fit found.

        `direction` (n,): for each drive the column that is its direction of motion, -1 ... 1. Sensors and gears pass a
        filter as slowly as loads change, so filtered rows may be multiplied.
        """
        n, load, sign = self.tree.n, [], []
        for j, (c, v) in enumerate(zip(rows.columns, rows.values, strict=True)):
            load.append(inertial[c[c < 10 * n]] @ v[c < 10 * n])
            sign.append(v[int(np.flatnonzero(c == direction[j])[0])] / self.drives[j, j])
        through = np.asarray(np.linalg.inv(self.drives)).T @ np.array(load)  # what each gear carries
        values = [np.array(v) for v in rows.values]
        for k, (d, effect) in enumerate(self.effects):
            if effect.kind in OF_LOAD:
                own = np.abs(through[d]) * sign[d] if effect.kind == "load" else through[d]
                for j in np.flatnonzero(self.drives[d]):
                    values[j][int(np.flatnonzero(rows.columns[j] == 10 * n + k)[0])] = self.drives[d, j] * own
        return replace(rows, values=tuple(values))

    def base(self, rng: np.random.Generator, preference: Array | None = None) -> BaseParameters:
        """The combinations of rigid links, rotors and friction that torque can tell, from random states.

        Hysteresis is left out: it depends on the path, and is independent of all that depends on the state.
        Raises ModelError where the rank is not clear.
        """
        n, count = self.tree.n, 15 * self.p // self.tree.n
        q, v, a = (rng.uniform(-s, s, (count, n)) for s in (np.pi, 2.0, 5.0))
        rows = self.rows(np.arange(count, dtype=float), q, v, a)
        return base_parameters(rows.dense().reshape(-1, self.p), self.names, preference)

    def nominal(self) -> Array:
        """(p,) what the file says: inertias and rotors; zero for the rest, and for links without inertia."""
        rotors = [self.tree.armature[d] if e.kind == "rotor" else 0.0 for d, e in self.effects]
        return np.concatenate([np.nan_to_num(self.tree.inertial).ravel(), rotors])
