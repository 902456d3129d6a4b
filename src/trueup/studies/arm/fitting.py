# SPDX-License-Identifier: Apache-2.0
"""Two fits to the same runs: the papers' 58 parameters, and what `trueup identify` gives by default."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from trueup.arrays import Array, Integers
from trueup.excitation.trajectories import Trajectory
from trueup.identification.dynamic_model import DynamicModel
from trueup.identification.estimation.identify import identify
from trueup.identification.estimation.moments import moments_of, weighted_fit
from trueup.identification.rows import Rows
from trueup.identification.torque_model import TorqueModel
from trueup.studies.arm.hidden import HiddenArm
from trueup.studies.arm.measuring import PAPERS, Run
from trueup.studies.arm.robot import NOMINAL, ns16

_SATURATING = ("saturating",)


class Fitted(Protocol):
    """A fitted model of the arm."""

    def torque(self, q: Array, qd: Array, qdd: Array) -> Array:
        """(S, n) N m along a motion (S, n)."""
        ...

    def predict(self, made: Run, rows: Rows) -> Array:
        """(S', n) torque along a run, filtered as what is measured; `rows` are the run's."""
        ...

    def as_papers(self) -> Array:
        """(84,) links, rotors, Coulomb, viscous and quadratic friction."""
        ...


@dataclass(frozen=True, eq=False)
class PapersFit:
    """The parameters of the papers' model."""

    model: DynamicModel
    parameters: Array

    def torque(self, q: Array, qd: Array, qdd: Array) -> Array:
        """See Fitted."""
        return self.model.rows(np.arange(float(len(q))), q, qd, qdd).predict(self.parameters)

    def predict(self, made: Run, rows: Rows) -> Array:
        """See Fitted."""
        del made
        return rows.predict(self.parameters)

    def as_papers(self) -> Array:
        """See Fitted."""
        return self.parameters


@dataclass(frozen=True, eq=False)
class OurFit:
    """What `trueup identify` found."""

    model: TorqueModel

    def torque(self, q: Array, qd: Array, qdd: Array) -> Array:
        """See Fitted."""
        return self.model.torque(q, qd, qdd)

    def predict(self, made: Run, rows: Rows) -> Array:
        """See Fitted."""
        del rows
        return made.passed(self.model.torque(*made.measured))

    def as_papers(self) -> Array:
        """See Fitted; friction that saturates over a range of speeds is counted as Coulomb's, other friction is left out."""
        friction = np.zeros((len(PAPERS), len(NOMINAL)))
        for d, effect, value in self.model.terms:
            kind = "coulomb" if effect.kind in _SATURATING else effect.kind
            if kind in PAPERS:
                friction[PAPERS.index(kind), d] += value
        return np.concatenate([self.model.links.ravel(), friction.ravel()])


def papers_fit(model: DynamicModel, rows: Sequence[Rows], columns: Integers) -> PapersFit:
    """Weighted least squares of the 58 parameters: local identification, section III-B."""
    moments = moments_of(rows)
    scaled, _ = weighted_fit(moments, columns, np.zeros(len(moments.scale)), variance=NOMINAL**2)
    return PapersFit(model, moments.parameters(scaled))


def our_fit(made: Sequence[Run], arm: HiddenArm, rng: np.random.Generator, warmth: float) -> OurFit:
    """The command's defaults, for recordings of these runs; of the arm nothing but lengths and axes is known."""
    tree = ns16()
    bare = tree.replace(inertial=np.full((tree.n, 10), np.nan), armature=np.zeros(tree.n))
    motions = joined([one.trajectory for one in made])
    return OurFit(identify(bare, [arm.perform(motion, rng, warmth) for motion in motions]).model)


def joined(motions: Sequence[Trajectory]) -> list[Trajectory]:
    """Motions that begin where and as fast as the one before ended, as one: a short one that is repeated is no recording."""
    chains: list[list[Trajectory]] = []
    for motion in motions:
        last = chains[-1][-1] if chains else motion
        begins = chains and np.allclose(motion.q[0], last.q[-1]) and np.allclose(motion.qd[0], last.qd[-1])
        if begins:
            chains[-1].append(motion)
        else:
            chains.append([motion])
    return [_chained(chain) for chain in chains]


def _chained(chain: Sequence[Trajectory]) -> Trajectory:
    first, step = chain[0], chain[0].time[1] - chain[0].time[0]
    q, qd, qdd = (
        np.concatenate([getattr(t, name)[k > 0 :] for k, t in enumerate(chain)]) for name in ("q", "qd", "qdd")
    )
    return Trajectory(first.name, first.joints, first.time[0] + step * np.arange(len(q)), q, qd, qdd)
