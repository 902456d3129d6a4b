# SPDX-License-Identifier: Apache-2.0
"""Kinematic trees that feel nothing of one another: rows of a batch that differ in several of them are simulated as one.

Legs of a robot whose base is held, or two arms on a table, move each as if alone while nothing touches. The columns of a
Jacobian that act on different ones then have no residual in common and are told from one simulation (A. R. Curtis,
M. J. D. Powell, J. K. Reid, On the estimation of sparse Jacobian matrices, J. Inst. Maths Applics 13, 1974).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from trueup.arrays import Array, Integers
from trueup.articulated.assignments import Assignment
from trueup.engines.mujoco.attributes import OBJECTS
from trueup.engines.mujoco.wiring import JOINT_CHANNELS
from trueup.engines.simulator import Rollout
from trueup.trial import Trial


@dataclass(frozen=True, eq=False)
class Trees:
    """Which tree each parameter acts on."""

    count: int
    joints: Mapping[str, int]
    """Joint to its tree."""
    owners: Integers
    """(n,) the tree of each parameter, `count` of those that act on several, or on all."""

    @classmethod
    def of(cls, compiled: mujoco.MjModel, quantities: Sequence[Assignment], parameters: int) -> Trees | None:
        """None where there is one tree, or what joins them: constraints between bodies, tendons."""
        if compiled.ntree < 2 or compiled.neq or compiled.ntendon or compiled.nflex:
            return None
        names = [compiled.joint(j).name for j in range(compiled.njnt)]
        trees = compiled.body_treeid[compiled.jnt_bodyid]
        count = int(compiled.ntree)
        owners = np.full(parameters, count)
        for i, assignment in enumerate(quantities):
            found = {_tree(compiled, assignment.quantity.family, target) for target in assignment.targets}
            owners[i] = found.pop() if len(found) == 1 and found <= set(range(count)) else count
        return cls(count, dict(zip(names, trees.tolist(), strict=True)), owners)

    def alone(self, trial: Trial) -> bool:
        """Whether all that a trial observes is of single joints, and nothing else acts in it than its command."""
        if trial.controller is not None or trial.ends or trial.disturbances or trial.sensing:
            return False
        return all(name in JOINT_CHANNELS and set(o.labels) <= self.joints.keys() for name, o in trial.observed.items())

    def packed(self, values: Array) -> tuple[Array, Integers]:
        """(p, n) rows to be simulated, and (count, b) in which of them each tree moves as in each row of values (b, n)."""
        where, rows = np.empty((self.count, len(values)), dtype=np.int64), list[Array]()
        groups = _alike(values[:, self.owners == self.count])[1]
        for g in range(int(groups.max()) + 1):
            own = np.flatnonzero(groups == g)
            firsts = []
            for tree in range(self.count):
                first, again = _alike(values[np.ix_(own, self.owners == tree)])
                firsts.append(own[first])
                where[tree, own] = len(rows) + again
            for r in range(max(map(len, firsts))):
                row = np.array(values[own[0]])
                for tree, first in enumerate(firsts):
                    mine = self.owners == tree
                    row[mine] = values[first[min(r, len(first) - 1)], mine]
                rows.append(row)
        return np.array(rows), where

    def unpacked(self, done: Rollout, where: Integers) -> Rollout:
        """A rollout of packed rows as one of the rows (b,) that they stand for; a row fails where one of its trees may."""
        channels = {}
        for name, values in done.channels.items():
            labels = done.trial.observed[name].labels
            parts = [values[where[self.joints[label]], :, j] for j, label in enumerate(labels)]
            channels[name] = np.stack(parts, axis=-1)
        failed = {int(k): done.failures[r] for r in done.failures for k in np.flatnonzero((where == r).any(axis=0))}
        return replace(done, channels=channels, failures=failed)


def _alike(rows: Array) -> tuple[Integers, Integers]:
    """The first of each kind of row, and (b,) of which kind each is."""
    if not rows.shape[1]:
        return np.zeros(1, dtype=np.int64), np.zeros(len(rows), dtype=np.int64)
    _, first, again = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    return first, again.reshape(-1)


def _tree(compiled: mujoco.MjModel, family: str, target: str) -> int:
    """The tree of a named element; -1 of what is in none, or in no family of elements."""
    number = int(mujoco.mj_name2id(compiled, OBJECTS[family], target)) if family in OBJECTS else -1
    if number < 0:
        return -1
    if family == "actuator":
        kinds = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
        if int(compiled.actuator_trntype[number]) not in kinds:
            return -1
        family, number = "joint", int(compiled.actuator_trnid[number, 0])
    bodies = {"joint": compiled.jnt_bodyid, "geom": compiled.geom_bodyid}
    body = int(bodies[family][number]) if family in bodies else number
    return int(compiled.body_treeid[body])
