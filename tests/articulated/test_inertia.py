# SPDX-License-Identifier: Apache-2.0
"""Log-Cholesky coordinates: every ten numbers are a body that can exist, and every such body has its ten numbers."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from trueup.articulated.inertia import from_log_cholesky, log_cholesky, principal
from trueup.identification.inertial import from_com, pseudo_inertia

anything = arrays(np.float64, 10, elements=st.floats(-2.0, 2.0))


@given(anything)
def test_every_ten_numbers_are_a_physical_body(theta: np.ndarray) -> None:
    mass, com, inertia = from_log_cholesky(theta)
    assert mass > 0
    a, b, c = np.sort(np.linalg.eigvalsh(inertia))
    assert a > 0
    assert c <= (a + b) * (1 + 1e-9)  # the triangle inequality of principal moments
    eigenvalues = np.linalg.eigvalsh(pseudo_inertia(from_com(float(mass), com, inertia)))
    assert eigenvalues.min() > -1e-9 * eigenvalues.max()


@given(anything)
def test_coordinates_and_bodies_correspond(theta: np.ndarray) -> None:
    mass, com, inertia = from_log_cholesky(theta)
    back = from_log_cholesky(log_cholesky(float(mass), com, inertia))
    assert np.isclose(back[0], mass)
    assert np.allclose(back[1], com)
    # A plate's missing thickness is filled up by a millionth.
    assert np.allclose(back[2], inertia, atol=1e-5 * np.trace(inertia))


@given(anything)
def test_principal_moments_and_axes_are_those_of_the_inertia(theta: np.ndarray) -> None:
    inertia = from_log_cholesky(theta)[2]
    moments, (w, x, y, z) = principal(inertia)
    turn = np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip
    assert np.allclose(turn @ np.diag(moments) @ turn.T, inertia, atol=1e-9 * np.trace(inertia))
