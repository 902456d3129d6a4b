# SPDX-License-Identifier: Apache-2.0
"""The best fit among bodies that can exist: each link a mass distribution without negative mass, by a conic solver."""

from __future__ import annotations

from dataclasses import dataclass

import clarabel
import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from trueup.errors import IdentificationError
from trueup.identification.estimation.moments import Moments
from trueup.identification.estimation.selection import loss_of
from trueup.identification.estimation.torque_model import TorqueModel
from trueup.identification.inertial import pseudo_inertia

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

_MARGIN = 1e-4
"""The least second moment, as a share of a link's natural size: simulators want inertias above zero."""
_BOUNDARY = 3.0
"""Times the margin below which a link counts as on the boundary."""
_PULL = 1e-6
"""Towards the model file, as a share of the mean curvature: decides what torque cannot tell."""
_PULLS = (1e-5, 1e-4, 1e-3)
_TOLERANCES = (1e-9, 1e-8, 1e-6)
_ROOT2 = np.sqrt(2.0)
_SMOOTH = ("viscous", "quadratic", "root", "offset", "gain")


@dataclass(frozen=True, eq=False)
class ConsistentFit:
    """Parameters (p,) of possible bodies, and the links (indices) that stopped at the edge of what is possible."""

    parameters: Array
    boundary: tuple[int, ...]


def consistent_fit(
    model: TorqueModel, gram: Array, cross: Array, active: Integers, prior: Array, *, pull: float = _PULL
) -> ConsistentFit:  # fmt: skip
    """Minimises the weighted squares over all inertial parameters and the `active` effects, with each link possible.

    `gram` (p, p) and `cross` (p,) are the weighted normal equations of all columns; `prior` (p,) stands for what they
    cannot tell. Constraints: pseudo-inertia >= 0 for each link, rotor inertias >= 0. Wensing, Kim & Slotine, "Linear
    matrix inequalities for physically consistent inertial parameter identification", IEEE RA-L 3(1), 2018, eq. 15.
    Raises IdentificationError where the solver fails.
    """
    n = model.tree.n
    # Rotors count even where torque cannot tell them from a link: a link cannot be as slender as a rotor is.
    rotors = [10 * n + k for k, (_, effect) in enumerate(model.effects) if effect.kind == "rotor"]
    free = np.union1d(np.arange(10 * n), np.union1d(active, rotors)).astype(np.int64)
    natural = _natural(model, prior)[free]
    P = gram[np.ix_(free, free)]
    size = float(np.mean(np.diag(P) * natural**2)) or 1.0
    ridge = np.where(free < 10 * n, pull, 1e-9) * size / natural**2
    P, q = P + np.diag(ridge), -cross[free] - ridge * prior[free]
    # All variables alike for the solver: weights of joints make their columns differ by orders of magnitude.
    scale = 1.0 / np.sqrt(np.diag(P))
    P, q = P * scale[:, None] * scale, q * scale
    A, b, cones = _constraints(model, free, natural, scale)
    x = _solved(sparse.csc_matrix(np.triu(P)), q, A, b, cones)
    parameters = np.zeros(model.p)
    parameters[free] = x * scale
    return ConsistentFit(parameters, tuple(_at_boundary(model, parameters, _natural(model, prior))))


def _solved(P: sparse.csc_matrix, q: Array, A: sparse.csc_matrix, b: Array, cones: list[object]) -> Array:
    """The solution, as exact as the solver can make it. Raises IdentificationError where it finds none."""
    status = ""
    for tolerance in _TOLERANCES:
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
        solution = clarabel.DefaultSolver(P, q, A, b, cones, settings).solve()
        status = str(solution.status)
        if status in ("Solved", "AlmostSolved"):
            return np.asarray(solution.x, dtype=np.float64)
    raise IdentificationError(f"no physically consistent model was found: the conic solver says {status}")


def cross_validated_fit(
    model: TorqueModel, moments: Moments, weights: Array, active: Integers, prior: Array
) -> tuple[ConsistentFit, float]:  # fmt: skip
    """The consistent fit with the pull towards the model file that predicts best what is left out, and that pull.

    Possible bodies bend less than free combinations of parameters: smooth friction of all drives, and gains, join the
    `active` effects where what is left out is predicted better with them.
    """
    K = len(moments.count)
    gram, cross = moments.weighted(weights)
    gram, cross = gram * moments.scale[:, None] * moments.scale, cross * moments.scale
    whole = gram.sum(axis=0), cross.sum(axis=0)

    def loss(columns: Integers, pull: float) -> float:
        errors = np.ones((K, model.tree.n))
        for k in range(K if K > 1 else 0):
            fit = consistent_fit(model, whole[0] - gram[k], whole[1] - cross[k], columns, prior, pull=pull)
            errors[k] = moments.take([k]).errors(fit.parameters * moments.scale)[0]
        return loss_of(errors)

    losses = [loss(active, pull) for pull in _PULLS]
    best = _PULLS[int(np.argmin(losses))]
    smooth = [10 * model.tree.n + k for k, (_, effect) in enumerate(model.effects) if effect.kind in _SMOOTH]
    wide = np.union1d(active, smooth).astype(np.int64)
    chosen = wide if K > 1 and loss(wide, best) < min(losses) else active
    return consistent_fit(model, *whole, chosen, prior, pull=best), best


def violations(model: TorqueModel, parameters: Array) -> dict[int, str]:
    """Links (by index) that no mass distribution has, with what is wrong; rotors are not looked at."""
    found = {}
    for j, row in enumerate(parameters[: 10 * model.tree.n].reshape(-1, 10)):
        mass, sigma = row[0], pseudo_inertia(row)
        if np.linalg.eigvalsh(sigma)[0] >= -1e-9 * max(abs(sigma).max(), 1e-12):
            continue
        if mass <= 0.0:
            found[j] = f"mass {mass:.3g} kg"
            continue
        com = row[1:4] / mass
        moments = sigma[:3, :3] - mass * np.outer(com, com)
        principal = np.sort(np.linalg.eigvalsh(np.trace(moments) * np.eye(3) - moments))
        if principal[0] < 0.0:
            found[j] = f"moment of inertia {principal[0]:.3g} kg m^2 about its centre of mass"
        else:
            found[j] = (
                f"moments of inertia {', '.join(f'{m:.3g}' for m in principal)} kg m^2 break the triangle inequality"
            )
    return found


def _natural(model: TorqueModel, prior: Array) -> Array:
    """(p,) natural sizes: a link's mass, mass times length, mass times length squared; 1 for effects."""
    sizes = np.ones(model.p)
    reach = np.maximum(np.linalg.norm(model.tree.offset, axis=1), 0.05)
    for j in range(model.tree.n):
        mass = max(float(prior[10 * j]), 0.1)
        sizes[10 * j : 10 * j + 10] = mass * np.array([1.0, *[reach[j]] * 3, *[reach[j] ** 2] * 6])
    return sizes


def _constraints(
    model: TorqueModel, free: Integers, natural: Array, scale: Array
) -> tuple[sparse.csc_matrix, Array, list[object]]:
    """A x + s = b with s in the cones: one 4 x 4 matrix a link, one number a rotor; parameters are `scale` x."""
    n, blocks, sides, cones = model.tree.n, [], [], []
    weights = np.ones((4, 4)) * _ROOT2
    np.fill_diagonal(weights, 1.0)
    upper = [(i, k) for k in range(4) for i in range(k + 1)]  # column by column, as the cone wants it
    basis = pseudo_inertia(np.eye(10))  # (10, 4, 4)
    for j in range(n):
        link, own = natural[10 * j : 10 * j + 10], scale[10 * j : 10 * j + 10]
        # Lengths in units of the link's size, so that the cone's entries are alike.
        units = np.array([*[link[4] / link[0]] * 3, 1.0]) ** -0.5 / np.sqrt(link[0])
        turned = basis * units[:, None] * units * own[:, None, None]
        rows = np.zeros((10, len(free)))
        for r, (i, k) in enumerate(upper):
            rows[r, 10 * j : 10 * j + 10] = -turned[:, i, k] * weights[i, k]
        blocks.append(rows)
        sides.append(np.array([-_MARGIN if i == k else 0.0 for i, k in upper]))
        cones.append(clarabel.PSDTriangleConeT(4))
    rotors = [i for i, k in enumerate(free) if k >= 10 * n and model.effects[int(k) - 10 * n][1].kind == "rotor"]
    if rotors:
        rows = np.zeros((len(rotors), len(free)))
        rows[np.arange(len(rotors)), rotors] = -1.0
        blocks.append(rows)
        sides.append(np.zeros(len(rotors)))
        cones.append(clarabel.NonnegativeConeT(len(rotors)))
    return sparse.csc_matrix(np.concatenate(blocks)), np.concatenate(sides), cones


def _at_boundary(model: TorqueModel, parameters: Array, sizes: Array) -> list[int]:
    found = []
    for j in range(model.tree.n):
        own, link = parameters[10 * j : 10 * j + 10], sizes[10 * j : 10 * j + 10]
        units = np.array([*[link[4] / link[0]] * 3, 1.0]) ** -0.5 / np.sqrt(link[0])
        if np.linalg.eigvalsh(pseudo_inertia(own) * units[:, None] * units)[0] < _BOUNDARY * _MARGIN:
            found.append(j)
    return found
