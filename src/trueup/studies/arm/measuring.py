# SPDX-License-Identifier: Apache-2.0
"""From runs of the arm to filtered samples: the papers' filter on position and torque alike, regressor with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueup.arrays import Array, Integers
from trueup.excitation.trajectories import Trajectory
from trueup.identification.dynamic_model import DynamicModel
from trueup.identification.effects import Effect
from trueup.identification.estimation.filtering import Lowpass, derivative
from trueup.identification.rows import Rows
from trueup.studies.arm.hidden import RATE, HiddenArm
from trueup.studies.arm.robot import NOMINAL, RATIOS, ns16

CUTOFF = 30.0
"""Hz: a Butterworth low-pass of order 8, sub-workspace evolved trajectories, section III-B."""
_AHEAD = 120.0  # Hz: keeps differences of positions finite; far above what is compared
_EVERY = 5  # 100 of 500 samples a second are kept
_TRIM = 10  # samples at both ends, where a filter has no past or no future

PAPERS = ("rotor", "coulomb", "viscous", "quadratic")
FURTHER = (
    Effect("offset"), Effect("stribeck", 0.02), Effect("stribeck", 0.06), Effect("asymmetric"),
    Effect("saturating", 0.002), Effect("saturating", 0.01), Effect("saturating", 0.05),
)  # fmt: skip
"""What our fit may use beyond them. No friction jumps at standstill: what saturates over a range of speeds goes there."""


def torque_model() -> DynamicModel:
    """The papers' columns (10 a link, rotor, three of friction a joint), then further friction that may be of use."""
    tree = ns16()
    effects = [(j, Effect(kind)) for kind in PAPERS for j in range(tree.n)]
    effects += [(j, effect) for effect in FURTHER for j in range(tree.n)]
    return DynamicModel.of(tree, effects)


def papers_columns(model: DynamicModel) -> Integers:
    """Indices of the 58 parameters: 40 base parameters and 18 of friction."""
    papers = model.only([k for k, (_, e) in enumerate(model.effects) if e.kind in PAPERS])
    return papers.base().independent


@dataclass(frozen=True, eq=False)
class Run:
    """One motion that the arm was asked to make, with the regressor along its measured positions."""

    trajectory: Trajectory
    measured: Array
    """(3, S, n) position, speed, acceleration at RATE, before the papers' filter."""
    rows: Rows
    """Filtered; without torque."""

    def torque(self, arm: HiddenArm, rng: np.random.Generator, warmth: float) -> Rows:
        """The rows with the torque that this arm shows, filtered as the regressor is."""
        t = self.trajectory
        raw = arm.torque(t.q, t.qd, t.qdd, warmth)
        raw = raw + arm.effects.noise * 0.01 * NOMINAL * rng.normal(size=raw.shape)
        kept = Lowpass(RATE, CUTOFF)(Lowpass(RATE, _AHEAD)(raw))[::_EVERY][_TRIM:-_TRIM]
        return replace(self.rows, torque=kept)

    def with_drives(self, model: DynamicModel, rows: Rows, drives: Array) -> Rows:
        """`rows` with the columns of those drives anew that turn with several joints, `drives` (n, n) saying how."""
        n = model.tree.n
        coupled = [d for d in range(n) if np.count_nonzero(drives[d]) > 1]
        if not coupled:
            return rows
        new = [(10 * n + k, d, effect) for k, (d, effect) in enumerate(model.effects) if d in coupled]
        gone = np.array([k for k, _, _ in new])
        columns, values = [], []
        for c, v in zip(rows.columns, rows.values, strict=True):
            stays = ~np.isin(c, gone)
            columns.append(list(c[stays]))
            values.append([v[stays]])
        q, v, a = (x @ drives.T for x in self.measured)
        own = np.array([effect.column(q[:, d], v[:, d], a[:, d]) for _, d, effect in new])
        own = Lowpass(RATE, CUTOFF)(own, axis=1)[:, ::_EVERY][:, _TRIM:-_TRIM]
        for (k, d, _), column in zip(new, own, strict=True):
            for j in np.flatnonzero(drives[d]):
                columns[j].append(k)
                values[j].append(drives[d, j] * column[None])
        return replace(rows, columns=tuple(map(np.array, columns)), values=tuple(map(np.concatenate, values)))


def run(model: DynamicModel, trajectory: Trajectory) -> Run:
    """The regressor along a motion at RATE, from positions in steps of the encoder, filtered and decimated."""
    step = 2.0 * np.pi / 4096.0 / RATIOS
    q = Lowpass(RATE, _AHEAD)(np.round(trajectory.q / step) * step)
    v = derivative(q, RATE)
    a = derivative(v, RATE)
    filtered = model.rows(trajectory.time, q, v, a).filtered(Lowpass(RATE, CUTOFF), _EVERY)
    return Run(trajectory, np.array([q, v, a]), filtered.part(slice(_TRIM, -_TRIM)))


def runs(model: DynamicModel, trajectories: Sequence[Trajectory]) -> list[Run]:
    """The regressors along several motions."""
    return [run(model, t) for t in trajectories]


def session(arm: HiddenArm, made: Sequence[Run], rng: np.random.Generator) -> list[Rows]:
    """All runs performed one after another at one temperature."""
    warmth = float(rng.uniform(-1.0, 1.0))
    return [one.torque(arm, rng, warmth) for one in made]


def separate(arm: HiddenArm, made: Sequence[Run], rng: np.random.Generator) -> list[Rows]:
    """Runs performed on different days, each at a temperature of its own."""
    return [one.torque(arm, rng, float(rng.uniform(-1.0, 1.0))) for one in made]
