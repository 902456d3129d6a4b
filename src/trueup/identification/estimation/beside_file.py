# SPDX-License-Identifier: Apache-2.0
"""Torque beside what the model file gives its links: a weight that is not there, and joints told in another size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.errors import ModelError, listed
from trueup.evidence import STANDARD_ERRORS, jackknife, without_each
from trueup.identification.effects import Effect
from trueup.identification.estimation.filtering import slow_cutoff
from trueup.identification.estimation.missing import clear_of
from trueup.identification.estimation.motion import Log
from trueup.identification.estimation.pool import BASIC
from trueup.identification.estimation.selection import TIME_BLOCKS
from trueup.identification.kinematic_tree import KinematicTree
from trueup.identification.regressors import inverse_dynamics
from trueup.instant import HARDLY
from trueup.rounding import TINY
from trueup.samples import MOST, rms
from trueup.units import AS_FAR

_WEIGHT, _INERTIA, _LINKS = range(3)


@dataclass(frozen=True, eq=False)
class _Beside:
    """How many times what the file says a joint's torque is: of weight, of inertia, of both together (3,)."""

    values: Array
    each: Array
    """(K, 3) the same without one stretch of time each."""
    sizes: Array
    """(3,) what the file says of each, as a share of the joint's torque."""

    def counts(self, what: int) -> bool:
        """Whether it makes a part of the torque that counts, by file or logs: of less friction decides what it seems."""
        return bool(self.sizes[what] * max(1.0, abs(self.values[what])) > HARDLY)

    def surely(self, combination: Sequence[float], beyond: float = 0.0) -> bool:
        """Whether this combination of the three is above a number."""
        doubt = STANDARD_ERRORS * jackknife(self.each @ np.array(combination))
        return bool(self.values @ combination - beyond > doubt)

    @property
    def weightless(self) -> bool | None:
        """Whether most of the weight is missing that inertia lets expect, or turned round; None where neither is certain.

        Files err in weight and inertia alike, as both follow from the same masses (UR10: weight 0.9 to 1.1 times the file's,
        inertia 1.0 to 1.3 times; Panda: 0.64 to 0.92, 0.25 to 0.77).
        """
        if not self.counts(_WEIGHT):
            return None
        if self.counts(_INERTIA) and self.surely((0.0, 1.0, 0.0)):
            light, there = self.surely((-1.0, MOST, 0.0)), self.surely((1.0, -MOST, 0.0))
        else:  # small weight may be small torque, too
            light, there = self.surely((-1.0, 0.0, 0.0)), self.surely((1.0, 0.0, 0.0), MOST)
        return light if light or there else None

    @property
    def apart(self) -> bool:
        """Whether the links take much more, or much less, than the file says."""
        beyond = self.surely((0.0, 0.0, 1.0), AS_FAR) or self.surely((0.0, 0.0, -1.0), -1.0 / AS_FAR)
        return self.counts(_LINKS) and beyond


def beside_file(logs: Sequence[Log], tree: KinematicTree) -> list[str]:
    """What to mind where the torque of joints is not about what the file's links make along the logs; [] without masses.

    A fit of its own masses can take these mistakes up: links that weigh nothing, or a tenth, explain torque as well.
    """
    try:
        tree.weighed()
    except ModelError:
        return []
    known = [j for j in range(tree.n) if all(log.units[j].startswith("N") for log in logs)]
    compared = {tree.joints[j]: each for j, each in _compared(logs, tree).items()}
    light = {joint: x.weightless for joint, x in compared.items() if x.weightless is not None}
    if light and all(light.values()):
        return [_weightless({joint: compared[joint] for joint in light}, tree)]
    apart = {j: compared[j] for j in (tree.joints[k] for k in known) if compared[j].apart}
    if not apart:
        return []
    return [
        f"the torque that links ask of {listed(list(apart))} is {_times(apart, _LINKS)} times what the model file says: is "
        "the gear ratio, the torque constant or the unit there another one, does the arm carry what the file lacks, or does "
        "a counterweight or a spring carry the arm? If the file's masses are made up, nothing is wrong"
    ]


def _weightless(light: dict[str, _Beside], tree: KinematicTree) -> str:
    down = all(x.values[_WEIGHT] < -MOST for x in light.values())
    x, y, z = (-float(g) + 0.0 for g in tree.gravity)
    way = (
        f"the arm seems to hang upside down: identify with --gravity {x:g} {y:g} {z:g}"
        if down
        else "a controller may take weight out of what is logged (then identify with --gravity 0 0 0), or the arm is mounted "
        "otherwise than the file says (--gravity X Y Z)"
    )
    return (
        f"the torque of {listed(list(light))} holds {_times(light, _WEIGHT)} times the weight that the model file gives the "
        f"links, and {_times(light, _INERTIA)} times their inertia: {way}"
    )


def _times(joints: dict[str, _Beside], what: int) -> str:
    return listed([f"{x.values[what]:.{3 if abs(x.values[what]) > 10.0 else 2}g}" for x in joints.values()])


def _compared(logs: Sequence[Log], tree: KinematicTree) -> dict[int, _Beside]:
    """Each joint's torque as multiples of what the file says of weight and of inertia, beside a rotor and friction."""
    motions = [log.motion(slow_cutoff(log.rate), measured_speed=False) for log in logs]
    q, v, a, torque = (
        np.concatenate([getattr(m, x)[clear_of(m.gaps, m.time)] for m in motions]) for x in ("q", "v", "a", "torque")
    )
    links = inverse_dynamics(tree, tree.inertial, q, v, a)
    weight = inverse_dynamics(tree, tree.inertial, q, np.zeros_like(v), np.zeros_like(a))
    found = {}
    for j in range(tree.n):
        top = float(np.quantile(np.abs(v[:, j]), 0.99))
        drive = [Effect(name.split()[0], top * float((name.split()[1:] or ["nan"])[0])) for name in BASIC]
        beside = [effect.column(q[:, j], v[:, j], a[:, j], 0.0) for effect in drive]
        columns = np.column_stack([weight[:, j], links[:, j] - weight[:, j], *beside])
        parts = [_multiples(x, torque[:, j]) for x in (columns, np.column_stack([links[:, j], *beside]))]
        (both, each), (one, each_one) = parts
        size = max(float(rms(torque[:, j])), TINY)
        spread = np.std(np.column_stack([columns[:, :2], links[:, j]]), axis=0)  # what is constant an offset takes up
        found[j] = _Beside(np.append(both[:2], one[0]), np.column_stack([each[:, :2], each_one[:, 0]]), spread / size)
    return found


def _multiples(columns: Array, torque: Array) -> tuple[Array, Array]:
    """(k,) multiples of columns (S, k) that come nearest to a torque (S,), and (K, k) the same without one stretch each."""
    scale = np.maximum(rms(columns), TINY)
    parts = list(zip(np.array_split(columns / scale, TIME_BLOCKS), np.array_split(torque, TIME_BLOCKS), strict=True))
    gram, cross = np.array([x.T @ x for x, _ in parts]), np.array([x.T @ y for x, y in parts])
    whole, less = (gram.sum(axis=0), cross.sum(axis=0)), (without_each(gram), without_each(cross))

    def solved(left: Array, right: Array) -> Array:
        return (np.linalg.pinv(left, rcond=1e-10, hermitian=True) @ right[..., None])[..., 0] / scale

    return solved(*whole), solved(*less)
