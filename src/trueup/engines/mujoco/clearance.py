# SPDX-License-Identifier: Apache-2.0
"""How far the parts of an arm are from each other, from what stands around it and from the floor.

Shapes are those of the model file. Where a link has none (its meshes are missing), a capsule from joint to joint, as
thick as its mass would make it, stands in; which links these are is said.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from trueup.arrays import Array, Integers
from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.shapes import box, capsule, solid, with_capsules, with_floor

_SLIDE = int(mujoco.mjtJoint.mjJNT_SLIDE)
_NEAR = (0.025, 0.05)
"""m, for small and large arms; parts that are never further apart are held so by a joint: their distance says nothing.
Without the larger one a pair of an industrial arm's is left out, and its motions tell less (`strange_arms`: 1.14 % for 0.91).
"""


@dataclass(frozen=True, eq=False)
class MujocoClearance:
    """Distances between all parts that can move against each other, except neighbours and those that always overlap."""

    compiled: mujoco.MjModel
    joints: tuple[str, ...]
    pairs: Integers
    """(k, 2) geoms."""
    parts: tuple[str, ...]
    """(ngeom,) name of the part that each geom belongs to."""
    notes: tuple[str, ...] = ()
    data: mujoco.MjData = field(init=False, repr=False)
    """Scratch."""

    def __post_init__(self) -> None:
        """Makes the scratch."""
        object.__setattr__(self, "data", mujoco.MjData(self.compiled))

    @classmethod
    def of(
        cls, model: Model, joints: Sequence[str], *, floor: float | str | None = "auto", seed: int = 0
    ) -> MujocoClearance:
        """For postures of `joints` (names in the order of q); other joints stay where the model has them.

        `floor`: its height in m in the model's frame, None for no floor, 'auto' for the underside of what stands fixed
        (or the base's own height). Raises UnknownNameError for a joint that is not there.
        """
        for name in joints:
            model.index("joint", name)
        spec, notes = model.spec.copy(), []
        notes += with_capsules(spec, model.compiled)
        notes += with_floor(spec, model.compiled, floor)
        compiled = spec.compile()
        parts = tuple(_part(compiled, g) for g in range(compiled.ngeom))
        pairs = np.array(_candidates(compiled), dtype=np.int64).reshape(-1, 2)
        made = cls(compiled, tuple(joints), pairs, parts)
        kept, more = made._without_overlaps(np.random.default_rng(seed))
        if not len(kept):
            more.append(f"no part of '{model.name}' can come near another: nothing is checked for collision")
        return cls(compiled, tuple(joints), kept, parts, (*notes, *more))

    def distances(self, q: Array) -> tuple[Array, tuple[str, ...]]:
        """(S,) least distance [m] at postures q (S, n), negative where parts overlap; and which two parts they are."""
        if not len(self.pairs):
            return np.full(len(q), np.inf), ("",) * len(q)
        data, address = self.data, self._address()
        least, between = np.empty(len(q)), []
        for s, posture in enumerate(q):
            data.qpos[address] = posture
            mujoco.mj_kinematics(self.compiled, data)
            least[s], k = self._least(data)
            between.append(self._name(k))
        return least, tuple(between)

    def _least(self, data: mujoco.MjData) -> tuple[float, int]:
        """The least distance of any pair: those whose bounding spheres are nearest first, until none can be nearer."""
        first, second = self.pairs.T
        apart = np.linalg.norm(data.geom_xpos[first] - data.geom_xpos[second], axis=1)
        endless = self.compiled.geom_type == int(mujoco.mjtGeom.mjGEOM_PLANE)  # MuJoCo gives planes a radius of 0
        radius = np.where(endless, np.inf, self.compiled.geom_rbound)
        bound = apart - radius[first] - radius[second]
        best, at, segment = 10.0, 0, np.empty(6)
        for k in np.argsort(bound):
            if bound[k] >= best:
                break
            far = mujoco.mj_geomDistance(self.compiled, data, int(first[k]), int(second[k]), best, segment)
            if far < best:
                best, at = float(far), int(k)
        return best, at

    def shapes(self) -> tuple[NDArray[Any], ...]:
        """All that can meet as capsules, and as boxes where it stands fixed, in the world with all joints at 0.

        In this order: joint (c,) that carries a capsule (-1: fixed), start (c, 3), end (c, 3), radius (c,), centre (k, 3),
        rotation (k, 3, 3) and half sides (k, 3) of boxes, pairs of capsules (m, 2), pairs of capsule and box (l, 2).
        """
        model, data = self.compiled, self.data
        data.qpos[:] = model.qpos0
        data.qpos[self._address()] = 0.0
        mujoco.mj_kinematics(model, data)
        used = sorted({int(g) for g in self.pairs.ravel()})
        fixed = [g for g in used if model.body_weldid[model.geom_bodyid[g]] == 0]
        moving = [g for g in used if g not in fixed]
        ends = [capsule(model, data, g) for g in moving]
        walls = [box(model, data, g) for g in fixed]
        pairs = [(moving.index(a), moving.index(b)) for a, b in self.pairs.tolist() if a in moving and b in moving]
        mixed = [(a, b) if b in fixed else (b, a) for a, b in self.pairs.tolist() if a in fixed or b in fixed]
        return (
            np.array([self._carrier(g) for g in moving], dtype=np.int64), np.array([e[0] for e in ends]).reshape(-1, 3),
            np.array([e[1] for e in ends]).reshape(-1, 3), np.array([e[2] for e in ends]),
            np.array([w[0] for w in walls]).reshape(-1, 3), np.array([w[1] for w in walls]).reshape(-1, 3, 3),
            np.array([w[2] for w in walls]).reshape(-1, 3), np.array(pairs, dtype=np.int64).reshape(-1, 2),
            np.array([(moving.index(a), fixed.index(b)) for a, b in mixed], dtype=np.int64).reshape(-1, 2),
        )  # fmt: skip

    def _carrier(self, geom: int) -> int:
        """Which of the joints carries a geom; -1 for none of them."""
        model, body = self.compiled, int(self.compiled.geom_bodyid[geom])
        known = {int(model.jnt_bodyid[self._joint(name)]): k for k, name in enumerate(self.joints)}
        while body and body not in known:
            body = int(model.body_parentid[body])
        return known.get(body, -1)

    def reach(self) -> Array:
        """(n,) by how many m any two parts may come nearer when a joint moves by one rad (or one m)."""
        model = self.compiled
        far = np.zeros(model.nbody)
        for body in range(model.nbody - 1, 0, -1):  # children come after their parents
            own = [g for g in range(model.ngeom) if model.geom_bodyid[g] == body]
            sizes = [float(np.linalg.norm(model.geom_pos[g]) + model.geom_rbound[g]) for g in own]
            far[body] = max([far[body], *sizes])
            slides = [k for k in range(model.njnt) if model.jnt_bodyid[k] == body and model.jnt_type[k] == _SLIDE]
            way = float(np.linalg.norm(model.body_pos[body]) + sum(np.abs(model.jnt_range[k]).max() for k in slides))
            parent = int(model.body_parentid[body])
            far[parent] = max(far[parent], far[body] + way)
        joints = [self._joint(name) for name in self.joints]
        slide = [model.jnt_type[k] == _SLIDE for k in joints]
        arms = [far[model.jnt_bodyid[k]] + float(np.linalg.norm(model.jnt_pos[k])) for k in joints]
        return np.where(slide, 1.0, arms)

    def _without_overlaps(self, rng: np.random.Generator) -> tuple[Integers, list[str]]:
        """The pairs that do not overlap as modelled, and whose distance changes at all; what was left out, in words."""
        at_random = 200
        data, address = self.data, self._address()
        own = self.compiled.qpos0[address]
        ranges = self.compiled.jnt_range[[self._joint(name) for name in self.joints]]
        wide = np.where((ranges[:, 1] > ranges[:, 0])[:, None], ranges, [-np.pi, np.pi])
        far, segment = np.zeros((at_random + 1, len(self.pairs))), np.empty(6)
        for s in range(at_random + 1):
            data.qpos[address] = np.clip(own, wide[:, 0], wide[:, 1]) if s == 0 else rng.uniform(wide[:, 0], wide[:, 1])
            mujoco.mj_kinematics(self.compiled, data)
            for k, (a, b) in enumerate(self.pairs.tolist()):
                far[s, k] = mujoco.mj_geomDistance(self.compiled, data, a, b, 10.0, segment)
        share = (far[1:] <= 0.0).mean(axis=0)
        # The model's own posture may fold the arm into itself; a pair that is mostly apart is a collision there.
        always = ((far[0] <= 0.0) & (share > 0.3)) | (share > 0.9)
        held = float(np.clip(0.04 * self.reach().max(), *_NEAR))
        near = ~always & ((far.max(axis=0) < held) | (np.ptp(far, axis=0) < 0.01))
        said = []
        for which, why in ((always, "they overlap as modelled"), (near, "the joint between keeps them that near")):
            if which.any():
                named = sorted({self._name(int(k)) for k in np.flatnonzero(which)})
                said.append(f"not checked, since {why}: {'; '.join(named)}")
        return self.pairs[~always & ~near], said

    def _address(self) -> Integers:
        return np.array([self.compiled.jnt_qposadr[self._joint(name)] for name in self.joints], dtype=np.int64)

    def _joint(self, name: str) -> int:
        return int(mujoco.mj_name2id(self.compiled, mujoco.mjtObj.mjOBJ_JOINT, name))

    def _name(self, pair: int) -> str:
        first, second = self.pairs[pair]
        return " and ".join(sorted((self.parts[first], self.parts[second])))


def _candidates(compiled: mujoco.MjModel) -> list[tuple[int, int]]:
    """Pairs of geoms of parts that move against each other and are not joined by a joint."""
    roots, parent = compiled.body_weldid, compiled.body_parentid
    touching = solid(compiled)
    pairs = []
    for i, a in enumerate(touching):
        for b in touching[i + 1 :]:
            one, other = int(roots[compiled.geom_bodyid[a]]), int(roots[compiled.geom_bodyid[b]])
            joined = one == other or int(roots[parent[one]]) == other or int(roots[parent[other]]) == one
            fixed = {one, other} & {0}
            # A link may well meet the floor or a wall though its joint stands on them: only the base is its neighbour.
            if joined and (one == other or not fixed or _is_base(compiled, a, b)):
                continue
            pairs.append((a, b))
    return pairs


def _is_base(compiled: mujoco.MjModel, a: int, b: int) -> bool:
    """Whether the fixed one of two geoms belongs to a body that carries a joint's body directly: an arm's own base."""
    for g in (a, b):
        body = int(compiled.geom_bodyid[g])
        if compiled.body_weldid[body] == 0:
            return body != 0 and any(
                compiled.body_parentid[c] == body and compiled.body_weldid[c] != 0 for c in range(compiled.nbody)
            )
    return False


def _part(compiled: mujoco.MjModel, geom: int) -> str:
    """The name of a geom's body; of what is fixed to the world the geom's own, where it has one."""
    body = int(compiled.geom_bodyid[geom])
    return compiled.geom(geom).name or "surroundings" if body == 0 else compiled.body(body).name or f"body {body}"
