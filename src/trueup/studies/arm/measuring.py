# SPDX-License-Identifier: Apache-2.0
"""From runs of the arm to filtered samples: the papers' filter on position and torque alike, regressor with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueup.arrays import Array, Integers
from trueup.excitation.trajectories import Trajectory
from trueup.identification.dynamic_model import DynamicModel
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


def torque_model() -> DynamicModel:
    """The papers' columns: 10 a link, rotor, three of friction a joint."""
    return DynamicModel.with_friction(ns16())


def papers_columns(model: DynamicModel) -> Integers:
    """Indices of the 58 parameters: 40 base parameters and 18 of friction."""
    return model.base().independent


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
        return replace(self.rows, torque=self.passed(Lowpass(RATE, _AHEAD)(raw)))

    def passed(self, torque: Array) -> Array:
        """(S', n) of torque (S, n) at RATE, through the papers' filter, thinned out as the rows are."""
        return Lowpass(RATE, CUTOFF)(torque)[::_EVERY][_TRIM:-_TRIM]


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


def separate(arm: HiddenArm, made: Sequence[Run], rng: np.random.Generator) -> list[Rows]:
    """Runs performed on different days, each at a temperature of its own."""
    return [one.torque(arm, rng, float(rng.uniform(-1.0, 1.0))) for one in made]
