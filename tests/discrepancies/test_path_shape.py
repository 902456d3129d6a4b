# SPDX-License-Identifier: Apache-2.0
"""The readings of eq. (8) differ as documented, and their residuals add up to them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.discrepancies.path_shape import READINGS, PathShape, mean_distance, path_loss, resample_by_arc
from trueup.discrepancies.plain import Plain
from trueup.engines.simulator import Rollout
from trueup.errors import UnknownNameError
from trueup.recording import Channel, Recording
from trueup.trial import Trial

Array = NDArray[np.float64]


def corner(cut: float) -> Array:
    """(n, 2) along x, then along y, with a corner that is cut off."""
    return np.array([[0, 0], [5 - cut, 0], [5, cut], [5, 5]], dtype=float)


def driven(path: Array, seconds: float = 20.0, samples: int = 400) -> Recording:
    """A recording of a path driven at constant speed."""
    dense = resample_by_arc(path, 0.001)
    values = dense[np.linspace(0, len(dense) - 1, samples).astype(int)]
    time = np.linspace(0.0, seconds, samples)
    return Recording("run", {"position": Channel("position", ("x", "y"), "m", time, values)})


def simulated(real: Recording, *paths: Array) -> Rollout:
    values = np.array([driven(p, samples=len(real.time)).channel("position").values for p in paths])
    return Rollout(Trial.of(real), {"position": values}, {})


def test_resampled_points_are_equally_spaced_and_keep_the_ends() -> None:
    points = resample_by_arc(corner(1.0), 0.1)
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert steps.max() < 0.101
    assert np.allclose(points[[0, -1]], [[0, 0], [5, 5]])
    assert np.median(steps) == pytest.approx(0.1, rel=0.01)


def test_noise_while_standing_is_no_path() -> None:
    rng = np.random.default_rng(0)
    standing = np.concatenate([rng.normal(0, 0.005, (5000, 2)), corner(1.0)[1:]])
    length = np.linalg.norm(np.diff(resample_by_arc(standing, 0.1), axis=0), axis=1).sum()
    assert length == pytest.approx(8 + np.sqrt(2), rel=0.02)


def test_a_pause_costs_nothing() -> None:
    path = resample_by_arc(corner(1.0), 0.01)
    paused = np.concatenate([path[:300], np.repeat(path[300:301], 2000, axis=0), path[300:]])
    assert path_loss(path, paused) < 1e-12


@pytest.mark.parametrize("reading", READINGS)
def test_a_shift_across_the_path_is_measured(reading: str) -> None:
    straight = np.array([[0.0, 0.0], [10.0, 0.0]])
    loss = path_loss(straight, straight + np.array([0.0, 0.2]), reading=reading)
    expected = {"joint": 0.04, "separate": 0.02, "accumulated": 0.2 * 101}[reading]
    assert loss == pytest.approx(expected, rel=1e-9)
    assert mean_distance(straight, straight + np.array([0.0, 0.2])) == pytest.approx(0.2)


def test_warping_each_coordinate_on_its_own_hides_a_cut_corner() -> None:
    losses = {r: path_loss(corner(0.0), corner(1.0), reading=r, spacing=0.05) for r in ("joint", "separate")}
    assert losses["separate"] < 0.1 * losses["joint"]


@pytest.mark.parametrize("reading", READINGS)
def test_residuals_add_up_to_the_loss(reading: str) -> None:
    real = driven(corner(0.0))
    shape = PathShape(reading=reading, unit=0.02)
    rollout = simulated(real, corner(1.0), corner(0.3))
    residuals = shape.residual(real, rollout)
    measured = real.channel("position").values
    points = len(resample_by_arc(measured, 0.1))
    losses = [path_loss(measured, values, reading=reading) for values in rollout.channels["position"]]
    assert residuals.shape == (2, 800)
    assert np.allclose((residuals**2).sum(axis=1) / points * 0.02**2, losses, rtol=1e-9)
    assert np.allclose(shape.losses(measured, rollout.channels["position"]), losses)
    assert losses[0] > losses[1] > 0.0


def test_a_failed_simulation_stays_nan() -> None:
    real = driven(corner(0.0))
    rollout = simulated(real, corner(1.0), corner(0.3))
    rollout.channels["position"][1, 200:] = np.nan
    for measure in (PathShape(), Plain()):
        residuals = measure.residual(real, rollout)
        assert np.isfinite(residuals[0]).all()
        assert np.isnan(residuals[1]).any()


def test_plain_differences_are_in_the_channels_unit() -> None:
    real = driven(corner(0.0))
    rollout = simulated(real, corner(0.0) + np.array([0.3, 0.4]))
    residuals = Plain({"position": 0.1}).residual(real, rollout).reshape(400, 2)
    assert np.allclose(residuals, [3.0, 4.0], atol=0.02)


def test_unknown_words_are_named() -> None:
    with pytest.raises(UnknownNameError, match="readings are: accumulated, joint, separate"):
        PathShape(reading="R4")
