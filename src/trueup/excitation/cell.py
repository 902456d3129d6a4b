# SPDX-License-Identifier: Apache-2.0
"""An arm in its cell: the region, the posture that its inverse kinematics stays near, and straight moves in it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from trueup.arrays import Array, Integers
from trueup.cores import in_threads
from trueup.errors import ModelError
from trueup.excitation.chain import Chain
from trueup.excitation.following import NO_MOTION, tool_programs
from trueup.excitation.inverse_kinematics import REACHED, REASONS, Equations, InverseKinematics
from trueup.excitation.limits import JointLimits
from trueup.excitation.regions import Region
from trueup.excitation.trajectories import Motions

if TYPE_CHECKING:
    from trueup.identification.kinematic_tree import KinematicTree


Apart = Callable[[Array], tuple[Array, tuple[str, ...]]]
"""Least distance (S,) [m] of parts at postures (S, n), and which two they are: `Clearance.distances`."""

_WHY = (*REASONS, "its via points are all the same")


@dataclass(frozen=True)
class Settings:
    """What a robot program sets once: speeds, how abruptly they are reached, how via points are passed."""

    speed: float = 1.0
    """m/s of the tool on straight moves."""
    turn: float = 2.0
    """rad/s of the tool's orientation."""
    joint_share: float = 1.0
    """Share of each joint's speed limit in joint moves."""
    ramp: float = 0.25
    """s from rest to full speed; 0.1 is abrupt, 0.5 gentle."""
    rounding: float = 0.1
    """s in which acceleration builds up (limited jerk); 0 gives trapezoidal speed profiles."""
    fly: float = 1.0
    """Fly-by: share of a ramp that is blended into the next move; 0 stops at each via point."""
    zone: float = np.inf
    """m: blending begins no further than this from a via point."""
    override: float = 1.0
    """Speed override as on a teach pendant: the whole program in 1 / override of its time, on the same path."""

    def __post_init__(self) -> None:
        """Raises ModelError for a value that cannot be."""
        for name in ("speed", "turn", "joint_share", "ramp", "override", "zone"):
            if not getattr(self, name) > 0.0:
                raise ModelError(f"{name} of the motion planner is {getattr(self, name)!r}; it must be above 0")
        if self.rounding < 0.0 or not 0.0 <= self.fly <= 1.0 or self.override > 1.0:
            raise ModelError(
                f"the motion planner needs rounding >= 0, fly in 0 ... 1 and override <= 1; got {self.rounding!r}, "
                f"{self.fly!r}, {self.override!r}"
            )

    def scaled(self, speed: float, turn: float) -> Settings:
        """With both speeds of the tool times these factors."""
        return replace(self, speed=self.speed * speed, turn=self.turn * turn)


@dataclass(frozen=True, eq=False)
class Cell:
    """An arm in a region: its chain to the tool, its limits, and the posture in the middle of the box."""

    region: Region
    chain: Chain
    limits: JointLimits
    kinematics: InverseKinematics
    posture: Array
    """(n,) with the tool in the middle of the box; it decides the branch of the inverse kinematics."""
    orientation: Array
    """(3, 3) middle of the cone."""
    notes: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, tree: KinematicTree, region: Region, limits: JointLimits | None = None, *, seed: int = 0,
        free_orientation: bool = False, apart: Apart | None = None, margin: float = 0.0,
    ) -> Cell:  # fmt: skip
        """Finds the posture: from the region's own, else the least singular of many that keep `margin` m apart.

        Raises ModelError where the box is out of reach, or each posture there collides.
        """
        known = JointLimits.of(tree) if limits is None else limits
        chain = Chain.of(tree, region.link, tool=region.tool)
        near = 0.5 * (known.lower + known.upper)
        for name, value in region.posture.items():
            near[tree.index(name)] = value
        kinematics = InverseKinematics.at(chain, known, _awake(near), free_orientation=free_orientation)
        if region.posture:
            turn = chain.poses(near)[0] if region.orientation is None else region.orientation
            q, ended = kinematics.solve(turn, region.centre, near)
            if ended != REACHED:
                raise ModelError(
                    f"from the posture of the region the middle of its box {shown(region.centre)} is {REASONS[ended]}; "
                    "give another posture, or none"
                )
            note = ""
        else:
            q, turn = _posture(chain, kinematics, region, np.random.default_rng(seed), apart, margin)
            note = "posture found by search: " + ", ".join(f"{j} {v:.2f}" for j, v in zip(tree.joints, q, strict=True))
        kinematics = InverseKinematics.at(chain, known, q, free_orientation=free_orientation)
        return cls(region, chain, known, kinematics, q, turn, (note,) if note else ())

    @property
    def genes(self) -> int:
        """Genes of one via point: six, and one for each joint that is asked for by value."""
        return (3 if self.kinematics.equations.rows == 3 else 6) + len(self.kinematics.equations.prescribed)

    def via_points(self, genes: Array) -> tuple[Array, Array, Array]:
        """Positions (..., 3), orientations (..., 3, 3) and own joint values (..., own) of genes (..., genes)."""
        rows, joint = self.kinematics.equations.rows, self.chain.arrays.joint
        positions = self.region.positions(genes[..., :3])
        if rows == 6:
            turns = self.region.orientations(genes[..., 3:6], self.orientation)
        else:
            turns = np.broadcast_to(self.orientation, (*genes.shape[:-1], 3, 3)).copy()
        at = joint[self.kinematics.equations.prescribed]
        # Joints asked for by value move like the orientation: as far about the posture as the tool may spin.
        span = np.minimum(
            self.region.spin,
            np.minimum(self.limits.upper[at] - self.posture[at], self.posture[at] - self.limits.lower[at]),
        )
        own = self.posture[at] + np.maximum(span, 0.0) * (2.0 * genes[..., rows:] - 1.0)
        return positions, turns, own

    def straight(
        self, positions: Array, turns: Array, own: Array, settings: Sequence[Settings], samples: int, *, threads: int = 1
    ) -> Motions:  # fmt: skip
        """Straight tool moves through via points (B, K, ...), one setting for each of the B programs, S = `samples`."""
        B, n = len(positions), self.chain.tree.n
        pace = np.array([[s.speed, s.turn, s.ramp, s.rounding, s.fly, s.zone] for s in settings])
        time, ended = np.zeros((B, samples)), np.zeros(B, dtype=np.int64)
        q, qd, qdd = (np.zeros((B, samples, n)) for _ in range(3))
        P, R, X = (np.ascontiguousarray(x) for x in (positions, turns, own))
        limits = (self.limits.speed, self.limits.acceleration)

        def some(rows: slice) -> None:
            look = 160  # Samples of a program on which it is judged where joints must be slowed
            tool_programs(
                self.chain.arrays, self.kinematics.equations, P[rows], R[rows], X[rows], pace[rows], limits, self.posture,
                look, time[rows], q[rows], qd[rows], qdd[rows], ended[rows],
            )  # fmt: skip

        in_threads(some, B, threads)
        return overridden(Motions(time, q, qd, qdd, failures(ended)), settings)


def failures(ended: Integers) -> tuple[str, ...]:
    """Why each plan failed, in words; '' where it did not."""
    return tuple("" if code == REACHED else _WHY[code if code < NO_MOTION else -1] for code in ended)


def overridden(motions: Motions, settings: Sequence[Settings]) -> Motions:
    """The same paths in 1 / override of the time."""
    share = np.array([s.override for s in settings])
    if np.all(share == 1.0):
        return motions
    k = share[:, None, None]
    return Motions(motions.time / share[:, None], motions.q, motions.qd * k, motions.qdd * k**2, motions.failure)


def _posture(
    chain: Chain, kinematics: InverseKinematics, region: Region, rng: np.random.Generator, apart: Apart | None, margin: float
) -> tuple[Array, Array]:  # fmt: skip
    """A posture with the tool in the middle of the box: clear there and at the corners, and far from singularities.

    Raises ModelError out of reach, or where all collide.
    """
    found = kinematics.search(region.orientation, region.centre, rng, starts=120)
    if not found:
        raise ModelError(
            f"no posture reaches the middle of the box {shown(region.centre)} m with link '{chain.link}'"
            + ("" if region.orientation is None else " in the orientation that the region asks for")
            + "; is the box in the model's base frame?"
        )
    found = [_unwound(q, chain.arrays.joint, kinematics.equations) for q in found[:40]]
    if apart is not None:
        distance, parts = apart(np.array(found))
        if distance.max() < margin:
            raise ModelError(
                f"each posture found with the tool in the middle of the box {shown(region.centre)} m collides "
                f"({parts[int(np.argmax(distance))]}); is the box in the model's base frame, and free?"
            )
        found = [q for q, far in zip(found, distance, strict=True) if far >= margin]
    scores = [_score(chain, kinematics, region, q, apart, margin) for q in found]
    best = found[int(np.argmax(scores))]
    return best, chain.poses(best)[0] if region.orientation is None else region.orientation


def _score(
    chain: Chain, kinematics: InverseKinematics, region: Region, q: Array, apart: Apart | None, margin: float
) -> float:
    """How far from singular the arm is at the corners of the box, on average; 0 where it cannot go there or collides."""
    corners = np.array(np.meshgrid([-0.5, 0.5], [-0.5, 0.5], [-0.5, 0.5])).reshape(3, -1).T * region.size
    turn = chain.poses(q)[0] if region.orientation is None else region.orientation
    solved = [kinematics.solve(turn, region.centre + corner, q) for corner in corners]
    gains = np.array([kinematics.gain(p) if ended == REACHED else 0.0 for p, ended in solved])
    if apart is not None:
        gains[apart(np.array([p for p, _ in solved]))[0] < margin] = 0.0
    # Between equal ones, that nearest to the middle of the ranges: room to move on both sides.
    middle = 0.5 * (kinematics.equations.lower + kinematics.equations.upper)
    span = kinematics.equations.upper - kinematics.equations.lower
    return float(gains.mean()) - 0.05 * float(np.abs((q[chain.arrays.joint] - middle) / span).max())


def _unwound(q: Array, joint: Integers, equations: Equations) -> Array:
    """The same posture with joints that may make more than a turn brought as near as can be to their middle."""
    near = q.copy()
    middle = 0.5 * (equations.lower + equations.upper)
    turns = np.round((q[joint] - middle) / (2.0 * np.pi))
    wide = equations.upper - equations.lower >= 2.0 * np.pi
    near[joint] -= np.where(wide, turns * 2.0 * np.pi, 0.0)
    return near


def _awake(q: Array) -> Array:
    """A posture off the straight ones, in which the choice of joints that follow a pose would be arbitrary."""
    return q + 0.3 * np.cos(1.0 + np.arange(len(q)))


def shown(position: ArrayLike) -> str:
    """A position in m as a message shows it."""
    return "(" + ", ".join(f"{x:.3g}" for x in np.asarray(position)) + ")"
