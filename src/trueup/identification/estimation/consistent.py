# SPDX-License-Identifier: Apache-2.0
"""The best fit among bodies that can exist: each link a mass distribution without negative mass, by a conic solver."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import clarabel
import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from trueup.errors import IdentificationError
from trueup.identification.estimation.torque_model import TorqueModel
from trueup.identification.inertial import pseudo_inertia

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

_MARGIN = 1e-4
"""The least second moment, as a share of a link's natural size: simulators want inertias above zero."""
_BOUNDARY = 3.0
"""Times the margin below which a link counts as on the boundary."""
PULL = 1e-6
"""Towards the model file, as a share of the mean curvature: decides what torque cannot tell."""
_TOLERANCES = (1e-9, 1e-8, 1e-6)
_ROOT2 = np.sqrt(2.0)


@dataclass(frozen=True, eq=False)
class ConsistentFit:
    """Parameters (p,) of possible bodies, and the links (indices) that stopped at the edge of what is possible."""

    parameters: Array
    boundary: tuple[int, ...]
    lagging: tuple[int, ...] = ()
    """Drives whose torque was allowed to fall with acceleration."""


def consistent_fit(
    model: TorqueModel, gram: Array, cross: Array, active: Integers, prior: Array, *, pull: float = PULL,
    lagging: Collection[int] = (), exact: bool = True,
) -> ConsistentFit:  # fmt: skip
    """Minimises the weighted squares over all inertial parameters and the `active` effects, with each link possible.

    `gram` (p, p) and `cross` (p,) are the weighted normal equations of all columns; `prior` (p,) stands for what they
    cannot tell. Constraints: pseudo-inertia >= 0 for each link, rotor inertias >= 0. Wensing, Kim & Slotine, "Linear
    matrix inequalities for physically consistent inertial parameter identification", IEEE RA-L 3(1), 2018, eq. 15.
    The torque of drives in `lagging` may fall with acceleration: what is below zero is their effect "lag", which is no
    rotor. `exact` asks for the last digits. Raises IdentificationError where the solver fails.
    """
    n = model.tree.n
    # Rotors count even where torque cannot tell them from a link: a link cannot be as slender as a rotor is.
    rotors = columns_of(model, "rotor")
    bodies = np.concatenate([np.arange(10 * n), rotors])
    free = np.concatenate([bodies, np.setdiff1d(active, bodies)])
    sizes = _natural(model, prior)
    natural = sizes[free]
    P = gram[np.ix_(free, free)]
    size = float(np.mean(np.diag(P) * natural**2)) or 1.0
    ridge = np.where(free < 10 * n, pull, 1e-9) * size / natural**2
    P, q = P + np.diag(ridge), -cross[free] - ridge * prior[free]
    # All variables alike for the solver: weights of joints make their columns differ by orders of magnitude.
    scale = 1.0 / np.sqrt(np.diag(P))
    P, q = P * scale[:, None] * scale, q * scale
    held = [int(k) for k in rotors if model.effects[int(k) - 10 * n][0] not in lagging]
    A, b, cones = _constraints(model, bodies, held, sizes[bodies], scale[: len(bodies)])
    x = _eliminated(P, q, len(bodies), lambda P, q: _solved(P, q, A, b, cones, _TOLERANCES[0 if exact else 1 :]))
    parameters = np.zeros(model.p)
    parameters[free] = x * scale
    for k in (int(k) for k in columns_of(model, "lag")):
        drive = model.effects[k - 10 * n][0]
        if drive in lagging:
            own = next(int(r) for r in rotors if model.effects[int(r) - 10 * n][0] == drive)
            parameters[k], parameters[own] = min(parameters[own], 0.0), max(parameters[own], 0.0)
    return ConsistentFit(parameters, tuple(_at_boundary(model, parameters, sizes)), tuple(sorted(lagging)))


def columns_of(model: TorqueModel, *kinds: str) -> Integers:
    """The columns of effects of these kinds."""
    found = [10 * model.tree.n + k for k, (_, effect) in enumerate(model.effects) if effect.kind in kinds]
    return np.array(found, dtype=np.int64)


def _eliminated(P: Array, q: Array, m: int, solver: Callable[[Array, Array], Array]) -> Array:
    """The minimiser of x P x / 2 + q x where constraints hold the first `m` variables only: the rest is solved for first.

    The solver's work grows with the cube of what is left. The first m see the Schur complement of the rest.
    """
    if m == len(q):
        return solver(P, q)
    factor = np.linalg.cholesky(P[m:, m:])
    mixed = np.linalg.solve(factor, np.column_stack([P[m:, :m], q[m:]]))
    first = solver(P[:m, :m] - mixed[:, :m].T @ mixed[:, :m], q[:m] - mixed[:, :m].T @ mixed[:, m])
    rest = np.linalg.solve(factor.T, -mixed[:, m] - mixed[:, :m] @ first)
    return np.concatenate([first, np.asarray(rest, dtype=np.float64)])


def _solved(
    P: Array, q: Array, A: sparse.csc_matrix, b: Array, cones: list[object], tolerances: Sequence[float]
) -> Array:  # fmt: skip
    """The solution, as exact as the solver can make it. Raises IdentificationError where it finds none."""
    status, upper = "", sparse.csc_matrix(np.triu(P))
    for tolerance in tolerances:
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.equilibrate_enable = False  # it is done: steps are fewer so  # pyright: ignore[reportAttributeAccessIssue]
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
        solution = clarabel.DefaultSolver(upper, q, A, b, cones, settings).solve()
        status = str(solution.status)
        if status in ("Solved", "AlmostSolved"):
            return np.asarray(solution.x, dtype=np.float64)
    raise IdentificationError(f"no physically consistent model was found: the conic solver says {status}")


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
    model: TorqueModel, bodies: Integers, held: Sequence[int], natural: Array, scale: Array
) -> tuple[sparse.csc_matrix, Array, list[object]]:
    """A x + s = b with s in the cones: one 4 x 4 matrix a link, one number a rotor in `held`; parameters are `scale` x."""
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
        rows = np.zeros((10, len(bodies)))
        for r, (i, k) in enumerate(upper):
            rows[r, 10 * j : 10 * j + 10] = -turned[:, i, k] * weights[i, k]
        blocks.append(rows)
        sides.append(np.array([-_MARGIN if i == k else 0.0 for i, k in upper]))
        cones.append(clarabel.PSDTriangleConeT(4))
    if held:
        rows = np.zeros((len(held), len(bodies)))
        rows[np.arange(len(held)), np.searchsorted(bodies, held)] = -1.0
        blocks.append(rows)
        sides.append(np.zeros(len(held)))
        cones.append(clarabel.NonnegativeConeT(len(held)))
    return sparse.csc_matrix(np.concatenate(blocks)), np.concatenate(sides), cones


def _at_boundary(model: TorqueModel, parameters: Array, sizes: Array) -> list[int]:
    found = []
    for j in range(model.tree.n):
        own, link = parameters[10 * j : 10 * j + 10], sizes[10 * j : 10 * j + 10]
        units = np.array([*[link[4] / link[0]] * 3, 1.0]) ** -0.5 / np.sqrt(link[0])
        if np.linalg.eigvalsh(pseudo_inertia(own) * units[:, None] * units)[0] < _BOUNDARY * _MARGIN:
            found.append(j)
    return found
