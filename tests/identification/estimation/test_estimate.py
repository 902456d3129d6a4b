# SPDX-License-Identifier: Apache-2.0
"""Least squares in its variants: recovery, honest standard deviations, outliers, noise in the regressor."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from trueup.errors import IdentificationError
from trueup.identification.dynamic_model import DynamicModel
from trueup.identification.effects import Effect
from trueup.identification.estimation.estimate import (
    Robust,
    instrumental,
    lasting_density,
    least_squares,
    weighted_least_squares,
    with_missed_form,
)
from trueup.identification.estimation.moments import RIDGE
from trueup.identification.rows import Rows

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


@pytest.fixture(scope="module")
def motion(arms: SimpleNamespace) -> tuple[DynamicModel, Integers, Array, Rows]:
    """A model with friction, its independent columns, their true values, and noiseless rows of a motion."""
    tree, rng = arms.arm(), np.random.default_rng(1)
    effects = [(d, Effect(kind)) for kind in ("rotor", "viscous", "coulomb") for d in range(tree.n)]
    model = DynamicModel.of(tree, effects)
    base = model.base()
    truth = np.zeros(model.p)
    full = np.concatenate([np.asarray(tree.inertial).ravel(), rng.uniform(0.2, 2.0, len(effects))])
    truth[base.independent] = base.of(full)
    time = np.arange(1500) / 50.0
    rows = model.rows(time, *arms.sines(rng, time, tree.n))
    return model, base.independent, truth, Rows(rows.columns, rows.values, rows.predict(truth), time, rows.p)


def _noisy(rows: Rows, noise: Array) -> Rows:
    return Rows(rows.columns, rows.values, rows.torque + noise, rows.time, rows.p)


def test_exact_torque_gives_the_exact_parameters(motion: tuple[DynamicModel, Integers, Array, Rows]) -> None:
    _, active, truth, rows = motion
    found = least_squares([rows], active)
    predicted = rows.predict(found.parameters)
    assert np.abs(predicted - rows.torque).max() < 1e-5
    assert np.allclose(found.parameters, truth, atol=1e-3)


@pytest.mark.parametrize("memory", [0.0, 0.9])
def test_two_standard_deviations_hold_the_truth_as_often_as_they_should(
    motion: tuple[DynamicModel, Integers, Array, Rows], memory: float
) -> None:
    _, active, truth, rows = motion
    inside = []
    for seed in range(8):
        white = np.random.default_rng(seed).normal(size=rows.torque.shape)
        noise = np.zeros_like(white)
        for i in range(len(noise)):
            noise[i] = memory * noise[i - 1] + white[i] if i else white[i]
        found = least_squares([_noisy(rows, noise)], active)
        inside.append(np.abs(found.parameters - truth)[active] < 2.0 * found.deviations[active])
    assert 0.85 <= np.mean(inside) <= 0.995


def test_deviations_that_ignore_the_errors_memory_would_be_far_too_small(
    motion: tuple[DynamicModel, Integers, Array, Rows],
) -> None:
    _, active, _, rows = motion
    slow = np.cumsum(np.random.default_rng(0).normal(size=rows.torque.shape), axis=0) * 0.05
    found = least_squares([_noisy(rows, slow - slow.mean(axis=0))], active)
    dense = rows.dense()[:, :, active].reshape(-1, len(active))
    naive = np.sqrt(np.diag(np.linalg.pinv(dense.T @ dense))) * found.noise.mean()
    assert np.median(found.deviations[active] / naive) > 2.0


def test_weights_by_noise_beat_equal_ones(motion: tuple[DynamicModel, Integers, Array, Rows]) -> None:
    _, active, truth, rows = motion
    rng, level, errors = np.random.default_rng(3), np.array([20.0, 20.0, 0.5, 0.1]), []
    for _ in range(8):
        logged = [_noisy(rows, level * rng.normal(size=rows.torque.shape))]
        plain, weighted = (f(logged, active) for f in (least_squares, weighted_least_squares))
        errors.append([(x.parameters - truth)[active] for x in (plain, weighted)])
        assert np.allclose(weighted.noise, [20.0, 20.0, 0.5, 0.1], rtol=0.1)
    size = np.sqrt(np.mean(np.square(errors), axis=0))  # (2, parameters)
    assert np.median(size[1] / size[0]) < 0.7
    assert np.linalg.norm(size[1]) < np.linalg.norm(size[0])


def test_spikes_in_the_torque_are_weighed_down_unasked(motion: tuple[DynamicModel, Integers, Array, Rows]) -> None:
    _, active, truth, rows = motion
    rng = np.random.default_rng(4)
    noise = 0.2 * rng.normal(size=rows.torque.shape)
    noise[rng.integers(0, len(noise), 30)] += 100.0
    plain = least_squares([_noisy(rows, noise)], active)
    robust = least_squares([_noisy(rows, noise)], active, robust="tukey")
    error = [np.linalg.norm((x.parameters - truth)[active]) for x in (plain, robust)]
    assert error[1] < 0.3 * error[0]


@pytest.mark.parametrize("robust", ["huber", "tukey"])
def test_a_robust_fit_of_normal_errors_is_no_surer_than_least_squares(
    motion: tuple[DynamicModel, Integers, Array, Rows], robust: Robust
) -> None:
    _, active, _, rows = motion
    logged = _noisy(rows, np.random.default_rng(7).normal(size=rows.torque.shape))
    plain, other = (least_squares([logged], active, robust=r).deviations[active] for r in (None, robust))
    # Both are 95 % efficient: nothing is won by not listening to errors that are chance.
    assert np.median(other / plain) == pytest.approx(0.95**-0.5, abs=0.025)


def test_where_errors_are_chance_nothing_is_added_for_a_form_that_is_missed(
    motion: tuple[DynamicModel, Integers, Array, Rows],
) -> None:
    _, active, _, rows = motion
    logged = [_noisy(rows, np.random.default_rng(8).normal(size=rows.torque.shape))]
    found = least_squares(logged, active, robust="huber")
    wide = with_missed_form(found, logged, np.zeros(rows.p), RIDGE)
    assert np.median(wide.deviations[active] / found.deviations[active]) < 1.05


def test_instruments_take_away_the_bias_of_noisy_accelerations(
    motion: tuple[DynamicModel, Integers, Array, Rows], arms: SimpleNamespace
) -> None:
    model, active, _, _ = motion
    rng, time = np.random.default_rng(5), np.arange(4000) / 50.0
    q, v, a = arms.sines(rng, time, model.tree.n)
    full = np.concatenate([np.asarray(model.tree.inertial).ravel(), np.ones(len(model.effects))])
    exact = model.rows(time, q, v, a)
    torque = exact.predict(full)
    first, second = (model.rows(time, q, v, a + 2.0 * rng.normal(size=a.shape), torque) for _ in range(2))
    plain = least_squares([first], active).parameters
    found = instrumental([first], [second], active)
    bias = [np.abs(exact.predict(x) - torque).mean() for x in (plain, found)]
    assert bias[1] < 0.3 * bias[0]


def test_more_parameters_than_samples_are_refused(motion: tuple[DynamicModel, Integers, Array, Rows]) -> None:
    _, active, _, rows = motion
    with pytest.raises(IdentificationError, match="too few"):
        least_squares([rows.part(slice(0, 5))], active)


def test_the_density_of_errors_at_low_frequencies_counts_their_memory() -> None:
    rng, rate, S = np.random.default_rng(0), 50.0, 200_000
    noise = rng.normal(size=(S, 2)) * [1.0, 3.0]
    lasting = np.asarray(lfilter([1.0], [1.0, -0.8], noise, axis=0))
    np.testing.assert_allclose(lasting_density([noise], rate), np.array([1.0, 9.0]) / rate, rtol=0.05)
    # 1 / (1 - 0.8)^2 times that of the noise, of which the Bartlett window of this memory sees 18 / 25
    np.testing.assert_allclose(lasting_density([lasting], rate), np.array([18.0, 162.0]) / rate, rtol=0.1)


@pytest.mark.parametrize("alike", [0.01, 0.05])
def test_what_draws_effects_to_zero_does_not_make_them_certain(alike: float) -> None:
    rng = np.random.default_rng(4)
    friction = np.sign(np.sin(np.arange(4000) / 50.0))
    load = friction * (1.0 + alike * rng.standard_normal(4000))  # an axis that hardly ever carries another weight
    torque = (6.0 * friction + 0.5 * rng.standard_normal(4000))[:, None]
    rows = Rows((np.arange(2),), (np.stack([friction, load]),), torque, np.arange(4000) / 100.0, 2, np.full(2, 1e-3))
    found = least_squares([rows], np.arange(2))
    assert found.parameters[1] > 1.0, "they share what one of them explains"
    assert np.all(np.abs(found.parameters - [6.0, 0.0]) < 2.0 * found.deviations)


def test_columns_that_are_one_but_for_rounding_have_no_variance_below_zero() -> None:
    rng = np.random.default_rng(1)
    each = rng.standard_normal((12, 4000))
    alike = np.vstack([each, each.sum(axis=0) + 1e-9 * rng.standard_normal(4000)])
    torque = (each.sum(axis=0) + 0.1 * rng.standard_normal(4000))[:, None]
    found = least_squares([Rows((np.arange(13),), (alike,), torque, np.arange(4000) / 100.0, 13)], np.arange(13))
    assert np.linalg.eigvalsh(found.covariance)[0] > 0.0
