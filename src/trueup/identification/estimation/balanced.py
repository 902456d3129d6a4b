# SPDX-License-Identifier: Apache-2.0
"""A spring that no log tells from weight, as on an arm that is balanced: what the masses of the model file say of it.

Gravity and a strut are sines of the same angle where nothing but weight tells of what a joint lifts. The file's masses are
another measurement of all combinations at once, off by shares that are alike from link to link, as their distance has it
(Lee, Wensing & Park, IEEE T-RO 36(2), 2020). A spring that makes one joint's weight another stands out of these.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri, fdtr

from trueup.arrays import Array, Integers
from trueup.evidence import chance
from trueup.identification.effects import WAVES
from trueup.identification.estimation.consistent import prior_information
from trueup.identification.estimation.estimate import Estimate
from trueup.identification.estimation.moments import RIDGE, Moments
from trueup.identification.estimation.pool import Pool
from trueup.rounding import NEGLIGIBLE, PRINTED, ROUNDED


@dataclass(frozen=True, eq=False)
class Balance:
    """A spring that may stand behind what passes for weight at a joint."""

    joint: str
    torque: Array
    """(2,) N m of the sine and the cosine of the joint's angle that bring weight nearest to the file's."""
    off: float
    """How far links are off the file then, as a share of their size, at most."""
    shares: Array
    """(p,) what it takes part in of each parameter of a fit without it."""

    def __str__(self) -> str:
        """What a user is to do."""
        return (
            f"{self.joint} may be balanced by a spring or a gas strut of some {float(np.hypot(*self.torque)):.2g} N m, which "
            "these logs cannot tell from weight: only with one the links come to about what the model file says. Values "
            f"that hang on it are 'shared'. Say which it is in a drives file (--drives): [joints.{self.joint}] with spring = "
            '"strut", "torsion" (in proportion to the angle), or "none" where there is none and the file is wrong'
        )


def balanced(pool: Pool, estimate: Estimate, moments: Moments, nominal: Array) -> Balance | None:
    """The likeliest spring that nobody declared and no log told, beside what the file says (`nominal`, (p,)); None where the
    file does as well without, or does not weigh all links.
    """
    if not np.isfinite(pool.model.tree.inertial).all():
        return None
    file, found = _File.of(pool, estimate, nominal), list[tuple[float, Balance]]()
    for j, joint in enumerate(pool.model.tree.joints):
        waves = np.array([pool.groups[kind][j] for kind in WAVES])
        if pool.springs[j] or pool.model.tree.prismatic[j] or np.isin(waves, estimate.active).any():
            continue
        shares = _shares(moments, estimate, waves)
        if (fit := file.beside(shares[file.columns])) is not None:
            found.append((fit.certainty, Balance(joint, fit.spring, fit.off, shares @ fit.spring)))
    certainty, best = max(found, key=lambda each: each[0], default=(0.0, None))
    return best if certainty > 1.0 - chance() / max(len(found), 1) else None  # of all joints together (Bonferroni)


@dataclass(frozen=True, eq=False)
class _Fit:
    spring: Array
    """(2,) N m."""
    off: float
    certainty: float
    """Chance that links without a spring are nearer to the file."""


@dataclass(frozen=True, eq=False)
class _File:
    """r combinations of bodies by torque, and what the file says of them."""

    columns: Integers
    difference: Array
    """(r,) by how much more torque says."""
    covariance: Array
    """(r, r) of what torque says."""
    spread: Array
    """(r, r) of what the file says, where all bodies are off by their own size."""
    free: Array
    """(r, m) what else differs: the scale of all masses, rotors, what hangs at the last link."""

    @classmethod
    def of(cls, pool: Pool, estimate: Estimate, nominal: Array) -> _File:
        model, n = pool.model, pool.model.tree.n
        columns = estimate.active[estimate.active < 10 * n]
        G = pool.base.grouping[np.searchsorted(pool.base.independent, columns)]
        rotors = model.columns_of("rotor")
        own = np.concatenate([np.arange(10 * n), rotors])
        known = prior_information(model, nominal)[np.ix_(own, own)]
        said, last = G @ nominal, np.arange(10 * (n - 1), 10 * n)
        free = np.column_stack([said, G[:, rotors], G[:, last]])
        return cls(
            columns, estimate.parameters[columns] - said, estimate.covariance[np.ix_(columns, columns)],
            G[:, own] @ np.linalg.solve(known, G[:, own].T), free[:, (free != 0.0).any(axis=0)],
        )  # fmt: skip

    def beside(self, shares: Array) -> _Fit | None:
        """The spring that explains most of the difference; `shares` (r, 2). None where nothing is left to tell it by.

        Generalised least squares; bodies are as far off the file as is not refuted (the upper limit of W. Viechtbauer,
        "Confidence intervals for the amount of heterogeneity in meta-analysis", Statistics in Medicine 26, 2007).
        """
        Z = np.column_stack([shares, self.free])
        Z = Z / np.maximum(np.linalg.norm(Z, axis=0), NEGLIGIBLE)
        rank = int(np.linalg.matrix_rank(Z, tol=PRINTED))
        rest = len(self.difference) - rank
        if rest < 1 or rank < np.linalg.matrix_rank(Z[:, 2:], tol=PRINTED) + 2:
            return None
        low, high, least = ROUNDED, 1.0 / ROUNDED, float(chdtri(rest, 1.0 - 0.5 * chance()))
        while high > (1.0 + 0.1) * low:
            middle = float(np.sqrt(low * high))
            low, high = (middle, high) if self._solved(Z, middle)[2] > least else (low, middle)
        x, covariance, _ = self._solved(Z, high)
        ratio = float(x[:2] @ np.linalg.solve(covariance[:2, :2], x[:2])) / 2.0
        return _Fit(x[:2] / np.linalg.norm(shares, axis=0), high, float(fdtr(2, rest, ratio)))

    def _solved(self, Z: Array, off: float) -> tuple[Array, Array, float]:
        """Coefficients of Z, their covariance, and what is left of squares, for bodies that are so far off."""
        V = self.covariance + off**2 * self.spread
        deviations = np.maximum(np.sqrt(np.diag(V)), NEGLIGIBLE)
        # What nothing tells has variances so large that rounding leaves others none, or less.
        sizes, axes = np.linalg.eigh(V / deviations[:, None] / deviations)
        whitening = (axes / np.sqrt(np.maximum(sizes, ROUNDED))).T / deviations
        Z, y = whitening @ Z, whitening @ self.difference
        size = np.maximum(np.linalg.norm(Z, axis=0), NEGLIGIBLE)
        back = np.linalg.pinv(Z / size, rcond=ROUNDED) / size[:, None]
        x = back @ y
        return x, back @ back.T, float(np.sum((y - Z @ x) ** 2))


def _shares(moments: Moments, estimate: Estimate, waves: Integers) -> Array:
    """(p, 2) what parameters of a fit without two columns take up of one unit of each."""
    act, scale = estimate.active, moments.scale
    gram = moments.weighted(estimate.weights)[0].sum(axis=0)
    own = gram[np.ix_(act, act)]
    own = own + np.trace(own) / len(act) * RIDGE * np.eye(len(act))
    made = np.zeros((len(scale), 2))
    made[act] = (
        np.linalg.solve(own, gram[np.ix_(act, waves)]) * scale[waves] / np.maximum(scale[act], NEGLIGIBLE)[:, None]
    )
    return made
