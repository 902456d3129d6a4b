# SPDX-License-Identifier: Apache-2.0
"""Bodies that can exist: the fit keeps to the cone, finds a possible truth, and says where the data left it."""

from __future__ import annotations

from types import SimpleNamespace

import clarabel
import numpy as np
import pytest
import scipy.sparse as sparse
from numpy.typing import NDArray

from trueup.identification.dynamic_model import DynamicModel
from trueup.identification.effects import Effect
from trueup.identification.estimation.consistent import ConsistentFit, consistent_fit, violations
from trueup.identification.estimation.identify import Options, identify
from trueup.identification.estimation.moments import moments_of
from trueup.identification.estimation.result import relative_error
from trueup.identification.inertial import pseudo_inertia
from trueup.identification.rows import Rows

Array = NDArray[np.float64]


def _fit(model: DynamicModel, rows: Rows, prior: Array) -> ConsistentFit:
    normal = moments_of([rows]).normal(np.ones(model.tree.n)).whole()
    return consistent_fit(model, normal, np.arange(10 * model.tree.n, model.p), prior)


@pytest.fixture
def made(arms: SimpleNamespace) -> tuple[DynamicModel, Rows, Array]:
    """A model with rotors, rows of a motion with its exact torque, and the truth."""
    tree, rng, time = arms.arm(), np.random.default_rng(0), np.arange(800) / 40.0
    model = DynamicModel.of(tree, [(d, Effect("rotor")) for d in range(tree.n)])
    truth = np.concatenate([np.asarray(tree.inertial).ravel(), arms.rotors])
    rows = model.rows(time, *arms.sines(rng, time, tree.n))
    return model, Rows(rows.columns, rows.values, rows.predict(truth), time, rows.p), truth


def test_a_possible_truth_predicts_exactly_whatever_the_file_says(made: tuple[DynamicModel, Rows, Array]) -> None:
    model, rows, truth = made
    wrong = truth * np.repeat([1.3, 0.7, 1.2, 0.8, 1.0], [10, 10, 10, 10, 4])
    fit = _fit(model, rows, wrong)
    assert np.abs(rows.predict(fit.parameters) - rows.torque).max() < 2e-3 * np.abs(rows.torque).max()
    assert violations(model, fit.parameters) == {}


def test_the_fit_keeps_to_the_cone_where_noise_would_leave_it(made: tuple[DynamicModel, Rows, Array]) -> None:
    model, rows, truth = made
    rng = np.random.default_rng(1)
    noisy = Rows(rows.columns, rows.values, rows.torque + 8.0 * rng.normal(size=rows.torque.shape), rows.time, rows.p)
    fit = _fit(model, noisy, truth)
    for row in fit.parameters[: 10 * model.tree.n].reshape(-1, 10):
        assert np.linalg.eigvalsh(pseudo_inertia(row))[0] > 0.0
    assert fit.parameters[10 * model.tree.n :].min() >= -1e-8


def test_a_body_that_cannot_exist_is_described_and_marked(made: tuple[DynamicModel, Rows, Array]) -> None:
    model, rows, truth = made
    impossible = truth.copy()
    impossible[30 + 9] = -0.4  # Izz of the last link
    assert "moment of inertia" in violations(model, impossible)[3]
    impossible[30] = -1.0
    assert violations(model, impossible)[3] == "mass -1 kg"
    pushed = Rows(rows.columns, rows.values, rows.predict(impossible), rows.time, rows.p)
    assert 3 in _fit(model, pushed, truth).boundary


def test_no_possible_bodies_fit_better_says_a_conic_solver(made: tuple[DynamicModel, Rows, Array]) -> None:
    model, rows, truth = made
    rng, n = np.random.default_rng(2), model.tree.n
    noisy = Rows(rows.columns, rows.values, rows.torque + 8.0 * rng.normal(size=rows.torque.shape), rows.time, rows.p)
    normal = moments_of([noisy]).normal(np.ones(n)).whole()

    def squares(x: Array) -> float:
        return float(x @ normal.gram @ x - 2.0 * normal.cross @ x + normal.square)

    found = consistent_fit(model, normal, np.arange(10 * n, model.p), truth, pull=1e-6)
    best = squares(_conic(normal.gram, normal.cross, n))
    assert squares(found.parameters) < (1.0 + 1e-3) * best


def _conic(gram: Array, cross: Array, n: int) -> Array:
    """The best possible bodies and rotors by an independent solver."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), 1e-9 * np.diag(gram).max()))
    basis, upper = pseudo_inertia(np.eye(10)), [(i, k) for k in range(4) for i in range(k + 1)]
    A = np.zeros((len(cross), len(cross)))
    for j in range(n):
        for r, (i, k) in enumerate(upper):
            own = slice(10 * j, 10 * j + 10)
            A[10 * j + r, own] = -basis[:, i, k] * scale[own] * (1.0 if i == k else np.sqrt(2.0))
    A[10 * n :, 10 * n :] = -np.eye(len(cross) - 10 * n)
    P = gram * scale[:, None] * scale + 1e-10 * np.eye(len(cross))
    cones = [*[clarabel.PSDTriangleConeT(4)] * n, clarabel.NonnegativeConeT(len(cross) - 10 * n)]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    solver = clarabel.DefaultSolver(
        sparse.csc_matrix(np.triu(P)), -cross * scale, sparse.csc_matrix(A), np.zeros(len(cross)), cones, settings
    )
    return np.asarray(solver.solve().x) * scale


def test_bodies_of_the_file_that_cannot_exist_are_named_and_harm_nothing(arms: SimpleNamespace) -> None:
    tree = arms.arm()
    log = arms.recording(tree, np.random.default_rng(1), seconds=12.0)
    file = np.array(tree.inertial)
    file[1, 0], file[2, 4] = -3.0, -0.5
    found = identify(tree.replace(inertial=file), [log], options=Options(hold_out=0.3))
    (said,) = (note for note in found.notes if "cannot exist" in note)
    assert f"{tree.links[1]} (mass -3 kg)" in said
    assert f"{tree.links[2]} (moment of inertia" in said
    assert tree.links[0] not in said
    assert relative_error(found.held_out(), "consistent") < 0.03
