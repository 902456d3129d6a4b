# SPDX-License-Identifier: Apache-2.0
"""What is believed of the simulator's parameters: values, how sure they are, and samples of what they may be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.arrays import Array, Mask
from trueup.calibration import Calibration, Nuisance
from trueup.errors import ParameterError
from trueup.parameters import ParameterSpace
from trueup.verdicts import PRIOR

UNSEEN = 0.1
"""Standard deviation, as a share of its range, of a parameter that the recordings could not tell."""
_BLIND = ("not identified", "no effect")


@dataclass(frozen=True, eq=False)
class _Owing:
    """Moves of parameters that nobody asked for, with what the fitted ones do then to replay the recordings as well."""

    places: NDArray[np.intp]
    """(k,) which these are."""
    spreads: Array
    """(c, k) a standard deviation of each independent combination of them, in their units."""
    trade: Array
    """(k, n) by how much the fitted ones change for one unit more of each."""
    lower: Array
    """(n,) bounds of all parameters, in their units."""
    upper: Array

    @classmethod
    def of(cls, space: ParameterSpace, fitted: Mask, nuisance: Nuisance) -> _Owing:
        """From what a calibration says of these."""
        trade = np.zeros((len(nuisance.names), len(space)))
        trade[:, fitted] = nuisance.trade.T
        variances, axes = np.linalg.eigh(nuisance.covariance)
        bounds = np.array([(p.lower, p.upper) for p in space.parameters]).T
        places = np.array([space.names.index(name) for name in nuisance.names])
        return cls(places, (axes * np.sqrt(np.maximum(variances, 0.0))).T, trade, bounds[0], bounds[1])

    def move(self, rows: Array, rng: np.random.Generator, widen: float) -> None:
        """Moves all of `rows` (b, n) but the first: each of these up to its bounds, and all of them less where a fitted one
        would be led past its own, for sums of both are what the recordings tell.
        """
        half = widen * rng.standard_normal((len(rows) // 2, len(self.spreads))) @ self.spreads
        shifts = np.stack([half, -half], axis=1).reshape(-1, len(self.places))[: len(rows) - 1]
        for row, shift in zip(rows[1:], shifts, strict=False):
            low, high = np.minimum(self.lower, row), np.maximum(self.upper, row)
            moved = np.clip(shift, (low - row)[self.places], (high - row)[self.places])
            owed = moved @ self.trade
            room, led = np.where(owed > 0.0, high - row, row - low), owed != 0.0
            share = min(1.0, float(np.min(room[led] / np.abs(owed[led]), initial=1.0)))
            owed[self.places] += moved
            row[:] = np.clip(row + share * owed, low, high)


@dataclass(frozen=True, eq=False)
class Belief:
    """Values (n,) of a simulator's parameters and a covariance of those that are unsure, all in the unit box."""

    space: ParameterSpace
    """All parameters, in the simulator's order."""
    values: Array
    """(n,) in the parameters' units."""
    unsure: NDArray[np.intp]
    """(f,) indices of the parameters that samples differ in."""
    covariance: Array
    """(f, f) in the unit box of each parameter's range (logarithmic where its scale is)."""
    owing: _Owing | None = None
    """What nobody asked for, and what others owe to it; samples differ in that, too."""

    @classmethod
    def of(cls, calibration: Calibration, space: ParameterSpace) -> Belief:
        """What a calibration leaves: its covariance, and some doubt about what the recordings could not tell.

        Raises ParameterError where the calibration is of other parameters.
        """
        return cls.estimated(
            space, calibration.values, np.array([e.fitted for e in calibration.estimates]), calibration.covariance,
            tuple(e.verdict for e in calibration.estimates), calibration.nuisance,
        )  # fmt: skip

    @classmethod
    def estimated(
        cls,
        space: ParameterSpace,
        values: Array,
        fitted: Mask,
        covariance: Array,
        verdicts: tuple[str, ...],
        nuisance: Nuisance | None = None,
    ) -> Belief:
        """The same from its parts: `fitted` (n,), `covariance` of the fitted ones in their units, `verdicts` (n,), and what
        nobody asked for, which moves the fitted ones with it.

        Of the fitted ones it is the posterior of a normal likelihood and a normal prior as wide as their ranges: where one
        short recording leaves a combination open, samples cut at the bounds would be none that replay it.
        Raises ParameterError where they are not of these parameters.
        """
        if len(values) != len(space) or len(covariance) != int(np.sum(fitted)):
            raise ParameterError(f"a calibration of {len(values)} parameters is no belief about these {len(space)}")
        blind = np.array([v in _BLIND for v in verdicts], dtype=bool) & ~fitted & space.free
        unsure = np.flatnonzero(fitted | blind)
        whole = np.zeros((len(space), len(space)))
        slope = _slopes(space, values)[fitted]
        told = np.asarray(covariance).reshape(len(slope), -1) / np.outer(slope, slope)
        whole[np.ix_(fitted, fitted)] = told - told @ np.linalg.solve(told + np.eye(len(told)) / PRIOR, told)
        whole[blind, blind] = UNSEEN**2
        owing = None if nuisance is None else _Owing.of(space, fitted, nuisance)
        return cls(space, np.asarray(values, dtype=np.float64), unsure, whole[np.ix_(unsure, unsure)], owing)

    @classmethod
    def prior(cls, space: ParameterSpace) -> Belief:
        """Before any recording: the nominal values, and each free parameter as unsure as anywhere in its range."""
        unsure = np.flatnonzero(space.free)
        return cls(space, space.nominal, unsure, np.eye(len(unsure)) / PRIOR)

    @classmethod
    def certain(cls, space: ParameterSpace, values: Array) -> Belief:
        """These values and no others."""
        return cls(space, np.asarray(values, dtype=np.float64), np.zeros(0, dtype=np.intp), np.zeros((0, 0)))

    def sample(self, count: int, rng: np.random.Generator, *, widen: float = 1.0) -> Array:
        """(count, n) values: the best first, then normal ones in pairs about it, cut at the bounds.

        `widen` is a factor on the standard deviations. Pairs (antithetic) have the belief's mean, however few they are.
        """
        rows = np.repeat(self.values[None], count, axis=0)
        if count == 1:
            return rows
        if len(self.unsure):
            self._spread(rows, rng, widen)
        if self.owing is not None:
            self.owing.move(rows, rng, widen)
        return rows

    def _spread(self, rows: Array, rng: np.random.Generator, widen: float) -> None:
        count = len(rows)
        variances, axes = np.linalg.eigh(self.covariance)
        root = axes * (widen * np.sqrt(np.maximum(variances, 0.0)))
        half = rng.standard_normal((count // 2, len(self.unsure))) @ root.T
        shifts = np.stack([half, -half], axis=1).reshape(-1, len(self.unsure))[: count - 1]
        rows[1 : 1 + len(shifts), self.unsure] = self._shifted(shifts)

    def moved(self, step: float) -> Array:
        """(f, n) values with one unsure parameter moved by `step` of its range in each row, inward at its upper bound."""
        centre = self._centre()
        rows = np.repeat(self.values[None], len(self.unsure), axis=0)
        rows[:, self.unsure] = self._shifted(np.diag(np.where(centre + step > 1.0, -step, step)))
        return rows

    def _shifted(self, shifts: Array) -> Array:
        return self._unlocked().from_unit(np.clip(self._centre() + shifts, 0.0, 1.0))

    def _centre(self) -> Array:
        return np.clip(self._unlocked().to_unit(self.values[self.unsure]), 0.0, 1.0)

    def _unlocked(self) -> ParameterSpace:
        """The unsure parameters alone, none of them frozen."""
        few = (self.space.parameters[i] for i in self.unsure)
        return ParameterSpace(tuple(p.replace(frozen=False, nominal=0.5 * (p.lower + p.upper)) for p in few))


def _slopes(space: ParameterSpace, values: Array) -> Array:
    """(n,) d value / d unit, frozen parameters included."""
    rows = []
    for p, value in zip(space.parameters, values, strict=True):
        rows.append(value * np.log(p.upper / p.lower) if p.scale == "log" else p.upper - p.lower)
    return np.array(rows, dtype=np.float64)
