# SPDX-License-Identifier: Apache-2.0
"""The rigidly aligned discrepancy: blind to the start pose, and to nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from trueup.discrepancies.rigid import RigidlyAligned
from trueup.discrepancies.weighted import Weighted
from trueup.engines.simulator import Rollout
from trueup.recording import Channel, Recording
from trueup.trial import Trial

TIME = np.arange(120) / 20.0
MEASURE = RigidlyAligned(Weighted({"position": {"x": 0.01, "y": 0.01}, "heading": {"heading": 0.01}}))


def drive(
    turn: float = 0.0, shift: tuple[float, float] = (0.0, 0.0), bend: float = 0.3
) -> tuple[np.ndarray, np.ndarray]:
    heading = bend * TIME + turn
    xy = np.cumsum(0.05 * np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0) + shift
    return xy, heading[:, None]


def residuals(*simulated: tuple[np.ndarray, np.ndarray], seen: bool = True) -> np.ndarray:
    xy, heading = drive()
    xy = xy if seen else np.full_like(xy, np.nan)
    real = Recording("real", {
        "position": Channel("position", ("x", "y"), "m", TIME, xy),
        "heading": Channel("heading", ("heading",), "rad", TIME, heading),
    })  # fmt: skip
    channels = {"position": np.stack([s[0] for s in simulated]), "heading": np.stack([s[1] for s in simulated])}
    return MEASURE.residual(real, Rollout(Trial.of(real), channels, {}))


def test_a_start_that_is_turned_and_shifted_leaves_no_residual() -> None:
    found = residuals(drive(0.05, (0.3, -0.2)), drive(-0.1, (5.0, 1.0)), drive())
    assert np.abs(found).max() < 1e-4


@pytest.mark.filterwarnings("error")
def test_where_no_position_was_seen_headings_alone_say_how_it_was_turned() -> None:
    found = residuals(drive(0.05), drive(0.05, bend=0.33), seen=False)
    assert np.nanmax(np.abs(found[0])) < 1e-4
    assert np.nanmax(np.abs(found[1])) > 1.0


def test_another_shape_shows_in_every_row_alone() -> None:
    both = residuals(drive(0.05, (0.3, -0.2)), drive(0.05, (0.3, -0.2), bend=0.33))
    assert np.abs(both[0]).max() < 1e-4
    assert np.sqrt(np.mean(both[1] ** 2)) > 1.0
    np.testing.assert_allclose(both[1], residuals(drive(0.05, (0.3, -0.2), bend=0.33))[0], atol=1e-9)
