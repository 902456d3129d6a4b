# SPDX-License-Identifier: Apache-2.0
"""Models one column larger have the errors that solving them anew gives; one stretch of time decides nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from trueup.identification.estimation.moments import Moments
from trueup.identification.estimation.selection import Choice, clearly_smaller, cross_validated, errors_beside


def test_borders_give_the_errors_of_new_solutions() -> None:
    rng = np.random.default_rng(0)
    K, n, p, S = 4, 3, 9, 40
    columns, torque = rng.normal(size=(K, n, p, S)), rng.normal(size=(K, n, S))
    shrink = np.where(np.arange(p) < 4, 0.0, 1e-3)
    gram, cross = columns @ columns.swapaxes(2, 3), (columns @ torque[..., None])[..., 0]
    moments = Moments(gram, cross, np.sum(torque**2, axis=2), np.full(K, float(S)), np.ones(p), shrink)
    active = np.array([True] * 5 + [False, True, False, False])
    choice, prior = Choice(active, 1e-4, np.array([1.0, 2.0, 0.5])), rng.normal(size=p) * (shrink == 0.0)
    for error, column in zip(errors_beside(moments, prior, choice, np.array([5, 8])), (5, 8), strict=True):
        mask = active.copy()
        mask[column] = True
        anew = cross_validated(moments, prior, replace(choice, active=mask))[0].errors
        assert anew is not None
        np.testing.assert_allclose(error, anew, rtol=1e-4)


def test_a_gain_in_a_single_stretch_of_time_is_not_sure() -> None:
    old = np.full((8, 3), 2.0)
    once, always = old.copy(), old - 0.2
    once[0] -= 1.9
    assert clearly_smaller(always, old)
    assert not clearly_smaller(once, old)
