# SPDX-License-Identifier: Apache-2.0
"""Two fits to the same recordings: the papers' 58 parameters, and one that finds the drives' structure in the data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueup.arrays import Array, Integers
from trueup.identification.dynamic_model import DynamicModel
from trueup.identification.effects import Effect
from trueup.identification.estimation.consistent import consistent_fit
from trueup.identification.estimation.moments import RIDGE, Moments, moments_of, weighted_fit
from trueup.identification.estimation.selection import Choice, forward_selected, reweighed
from trueup.identification.inertial import from_com
from trueup.identification.rows import Rows
from trueup.studies.arm.couplings import proposed_couplings
from trueup.studies.arm.measuring import Run
from trueup.studies.arm.robot import NOMINAL

WRIST = ((4, 3), (5, 4), (5, 3))
"""(drive, joint) pairs that may be coupled: drives of a wrist sit behind the joints before them."""


@dataclass(frozen=True, eq=False)
class Fitted:
    """A fitted model: parameters of all columns, the friction that grows with load, the couplings of the drives."""

    parameters: Array
    load: Array
    """(n,) friction as a share of the torque that a gear carries."""
    drives: Array
    """(n, n) speeds of the drives for those of the joints."""

    def predict(self, model: DynamicModel, made: Run, rows: Rows) -> Array:
        """(S, n) torque along a run."""
        own = made.with_drives(model, rows, self.drives)
        torque = own.predict(self.parameters)
        return torque + self.load * load_columns(own, self.parameters) if self.load.any() else torque


def load_columns(rows: Rows, parameters: Array) -> Array:
    """(S, n) the torque that each gear carries times the sign of its speed: what a load-dependent friction multiplies."""
    n = len(rows.values)
    columns = np.zeros((rows.length, n))
    for j, (c, v) in enumerate(zip(rows.columns, rows.values, strict=True)):
        sign = v[int(np.flatnonzero(c == 11 * n + j)[0])]  # the Coulomb column, behind 10 n inertias and n rotors
        columns[:, j] = np.abs(parameters[c[c < 10 * n]] @ v[c < 10 * n]) * sign
    return columns


def papers_fit(rows: Sequence[Rows], columns: Integers) -> Fitted:
    """Weighted least squares of the 58 parameters: local identification, section III-B."""
    n = len(rows[0].values)
    return Fitted(_weighted(moments_of(rows), columns)[0], np.zeros(n), np.eye(n))


def _weighted(moments: Moments, columns: Integers) -> tuple[Array, Array]:
    """(p,) parameters and (n,) the error variance of each joint."""
    scaled, variance = weighted_fit(moments, columns, np.zeros(len(moments.scale)), variance=NOMINAL**2)
    return moments.parameters(scaled), variance


def our_fit(model: DynamicModel, made: Sequence[Run], rows: Sequence[Rows], columns: Integers) -> Fitted:
    """Couplings from the data, friction with what predicts runs left out of its further columns and load, possible bodies."""
    n = model.tree.n

    def driven(C: Array) -> list[Rows]:
        return [one.with_drives(model, r, C) for one, r in zip(made, rows, strict=True)]

    C = proposed_couplings(driven, columns, np.arange(10 * n, 11 * n), WRIST)
    rows = driven(C)
    further = np.concatenate([np.arange(14 * n, model.p), model.p + np.arange(n)])  # the load's columns come last
    active = np.concatenate([columns, further])
    parameters, variance = _weighted(moments_of(rows), active[active < model.p])
    load = np.zeros(n)
    for turn in range(2):  # the load column needs the torque carried, which the last fit gives
        wide = moments_of([_loaded(r, parameters) for r in rows])
        active = active if turn else _useful(wide, columns, further)
        both, variance = _weighted(wide, active)
        parameters, load = both[: model.p], np.maximum(both[model.p :], 0.0)
    rest = moments_of([replace(r, torque=r.torque - load * load_columns(r, parameters)) for r in rows])
    return Fitted(_possible(model, rest, variance, active[active < model.p]), load, C)


def _useful(moments: Moments, columns: Integers, further: Integers) -> Integers:
    """The columns, and those of `further` that clearly help to predict runs that were left out."""
    prior, mask = np.zeros(len(moments.scale)), np.isin(np.arange(len(moments.scale)), columns)
    choice = reweighed(moments, prior, Choice(mask, RIDGE, NOMINAL**2))
    return np.flatnonzero(forward_selected(moments, prior, choice, [[k] for k in further.tolist()]).active)


def _loaded(rows: Rows, parameters: Array) -> Rows:
    extra = load_columns(rows, parameters)
    columns = tuple(np.append(c, rows.p + j) for j, c in enumerate(rows.columns))
    values = tuple(np.vstack([v, extra[:, j]]) for j, v in enumerate(rows.values))
    more = Effect("load", 1.0).shrink * np.ones(extra.shape[1])
    shrink = np.append(np.broadcast_to(rows.shrink, rows.p), more)
    return replace(rows, columns=columns, values=values, p=rows.p + extra.shape[1], shrink=shrink)


def _possible(model: DynamicModel, moments: Moments, variance: Array, active: Integers) -> Array:
    """(p,) the fit among bodies that can exist."""
    n = model.tree.n
    normal = moments.normal(variance.min() / variance).whole()
    effects = np.union1d(np.arange(10 * n, 11 * n), active[active >= 10 * n])
    return consistent_fit(model, normal, effects, _rough_bodies(model)).parameters


def _rough_bodies(model: DynamicModel) -> Array:
    """(p,) bodies without looking: 250 kg shared out by the strength of the drives, each a ball of 0.15 m on its axis."""
    masses = 250.0 * NOMINAL / NOMINAL.sum()
    balls = [from_com(m, np.zeros(3), 0.4 * m * 0.15**2 * np.eye(3)) for m in masses.tolist()]
    return np.concatenate([*balls, np.zeros(model.p - 10 * model.tree.n)])
